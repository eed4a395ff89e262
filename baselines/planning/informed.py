"""Nonlinear predictive control that is told the plant that each episode draws: a teacher, not a rival.

What a scenario draws is not observed, so that no law of a laboratory can be this one. It says what
knowing the plant is worth, and labels the observations of a student with a memory, who learns to tell
plants apart by their responses (learning by cheating: Chen, Zhou, Koltun and Krahenbuhl, CoRL 2019).
State and coming target are estimated from the scenario's signals, as by `nmpc`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.planning.design_of_plant import design_of_plant
from baselines.planning.ekf import TableEstimate, model_error
from baselines.planning.model import PlanningModel
from baselines.planning.nmpc import Design, NMPCSettings, NonlinearPredictiveControl, PlanMemory
from shake_env.errors import ScenarioError
from shake_env.model.parameters import FloatArray
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uncertainty


@dataclass(frozen=True)
class ToldTables:
    """Models and designs of N tables, each of its own plant."""

    models: list[FloatArray]  # each (N, ...), see `PlanningModel.arrays`
    design: Design  # each (N, ...)


class InformedPredictiveControl(NonlinearPredictiveControl):
    """`NonlinearPredictiveControl` on the true plant of each of its tables.

    Parameters
    ----------
    scenario
        Draws the plants.
    plant_of
        Gives the plant that table n has now (`PlantBatch.plant`); asked where an episode begins.
    settings
        Horizon and weights.

    Raises
    ------
    ScenarioError
        If the scenario draws nothing, or its storeys yield.
    """

    def __init__(
        self,
        scenario: Scenario,
        plant_of: Callable[[int], Scenario],
        settings: NMPCSettings | None = None,
    ) -> None:
        if not scenario.uncertainty.active:
            raise ScenarioError("uncertainty", "none", "no parameter is drawn: ask for nmpc")
        if scenario.nonlinearity.yielding.active:
            raise ScenarioError(
                "nonlinearity.yielding", "on", "a drawn plant that yields is not planned on"
            )
        super().__init__(replace(scenario, uncertainty=Uncertainty()), settings)
        self._plant_of = plant_of
        self._error = (
            None if self.filter is None else model_error(scenario, self.settings.model_error_scale)
        )

    def _told(self, table: int) -> tuple[tuple[Any, ...], Design]:
        """Return models and design of the plant that a table has now."""
        plant = replace(self._plant_of(table), uncertainty=Uncertainty())
        own = PlanningModel.of(plant, self._error)
        if own.states != self.model.states:  # a longer delay keeps more commands: the nominal one
            plant = replace(plant, delay=self._scenario.delay)
            own = PlanningModel.of(plant, self._error)
        return own.arrays[:7], design_of_plant(
            plant, own, self.model, self._scenario, self.horizon, self.settings.displacement_tolerance
        )

    def _rest(self, lanes: int) -> PlanMemory:
        stack = [np.concatenate([matrix] * lanes) for matrix in self.model.arrays[:7]]
        designs = Design(*(np.repeat(part[None], lanes, axis=0) for part in self._common.arrays))
        return replace(super()._rest(lanes), tables=ToldTables(stack, designs))

    def _estimate(
        self, last: PlanMemory, given: FloatArray, readings: FloatArray, fresh: NDArray[np.bool_]
    ) -> tuple[TableEstimate, Any]:
        tables: ToldTables = last.tables
        if fresh.any():
            stack, parts = [m.copy() for m in tables.models], [d.copy() for d in tables.design.arrays]
            for n in np.flatnonzero(fresh):
                models, design = self._told(int(n))
                for whole, own in zip((*stack, *parts), (*models, *design.arrays), strict=True):
                    whole[n : n + 1] = own
            tables = ToldTables(stack, Design(*parts))
        if self.filter is None:
            return super()._estimate(last, given, readings, fresh)[0], tables
        models = self._plan_models(tables)
        nothing = np.zeros((len(fresh), 0))
        return self.filter.advance(last.estimate, given, readings, fresh, models, nothing), tables

    def _design(self, tables: Any) -> Design:
        known: ToldTables = tables
        return known.design

    def _plan_models(self, tables: Any) -> tuple[Any, ...]:
        known: ToldTables = tables
        return (*known.models, *self.model.arrays[7:])
