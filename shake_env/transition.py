"""One control period of an episode: action in, next state, response, cost and limits out.

Pure, and written against the array API: the environments run it on numpy arrays, learning through the
plant on torch tensors.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import array_api_compat

from shake_env.dynamics import PeriodResponse, TableDynamics, as_like
from shake_env.excitation import GroundPeriod
from shake_env.limits import Limits
from shake_env.nonlinear_dynamics import NonlinearDynamics
from shake_env.objective import CostTerms, StageCost
from shake_env.scenario import Scenario

Array = Any  # a numpy array or a torch tensor


@dataclass(frozen=True)
class Outcome:
    """What one control period brought."""

    response: PeriodResponse
    current: Array  # (...) [A]
    cost: CostTerms  # each (...)
    broken: Array  # (...) 0, or 1 + index in limits.REASONS


@dataclass(frozen=True)
class TableModel:
    """Everything of a scenario that a step needs, in the library of one array."""

    dynamics: TableDynamics | NonlinearDynamics
    stage_cost: StageCost
    limits: Limits
    current_limit: float  # [A]
    observation_scale: Array  # (n,) SI size of each entry of the full state
    filter_states: int
    controlled: int  # 4 + 2 stories: entries of the state that are the linear plant's

    @classmethod
    def of(cls, scenario: Scenario) -> TableModel:
        """Return the model of a scenario, in numpy."""
        return _model(scenario)

    def like(self, array: Array) -> TableModel:
        """Return this model in the library, precision and device of `array`."""
        return TableModel(
            self.dynamics.like(array),
            self.stage_cost,
            self.limits,
            self.current_limit,
            as_like(self.observation_scale, array),
            self.filter_states,
            self.controlled,
        )

    def transition(self, state: Array, action: Array, ground: GroundPeriod) -> Outcome:
        """Advance the table by one control period.

        Parameters
        ----------
        state
            (..., 4 + 2 stories) [x_A, x_S] in SI.
        action
            (...) current as a fraction of the limit; clipped to [-1, 1].
        ground
            The ground over this period.
        """
        current = self.current_limit * action.clip(-1.0, 1.0)
        response = self.dynamics.control_step(state, current, ground.drive)
        cost = self.stage_cost.terms(
            response.table_acceleration,
            ground.target,
            response.base_shear,
            ground.reference_shear,
            current,
        )
        linear = response.state[..., : self.controlled]
        scale = self.observation_scale[self.filter_states : self.filter_states + self.controlled]
        broken = self.limits.broken(linear / scale, linear, response.table_acceleration)
        return Outcome(response, current, cost, broken)

    def observe(self, state: Array, ground: GroundPeriod) -> Array:
        """Return the full scaled state (..., n), ``[x_W, x_A, x_S, x~_S]`` over its scale.

        What a nonlinear plant adds to the state (slips, the spool's velocity, commands under way) is not
        in it.
        """
        xp = array_api_compat.array_namespace(state)
        full = xp.concat([ground.ground, state[..., : self.controlled], ground.reference], axis=-1)
        return full / self.observation_scale


@lru_cache(maxsize=32)
def _model(scenario: Scenario) -> TableModel:
    layout = scenario.plant.layout
    return TableModel(
        dynamics_of(scenario),
        scenario.stage_cost,
        scenario.limits,
        scenario.current_limit,
        scenario.plant.state_scale,
        layout.filter_states,
        layout.controlled.stop - layout.controlled.start,
    )


def dynamics_of(scenario: Scenario) -> TableDynamics | NonlinearDynamics:
    """Return the update of a scenario's table: the lifted linear one where nothing else is needed."""
    if scenario.nonlinearity.active or scenario.delay or scenario.uncertainty.active:
        return NonlinearDynamics.of(
            scenario.plant,
            scenario.nonlinearity,
            scenario.physics_step,
            scenario.substeps,
            delay=scenario.delay,
            longest_delay=scenario.longest_delay,
        )
    return TableDynamics.of(scenario.discrete)
