"""Nonlinear predictive control that estimates parameters of table and specimen as states.

What the scenario draws at each reset (its `uncertainty`: specimen mass and frequency, bulk modulus,
friction, ...) is estimated by the extended Kalman filter, each parameter over its nominal value a slow
random walk. Forces and flows are close to linear in them, so that the first readings lead near the
truth. Slopes along a parameter come from models a step up and down. Where an estimate has moved, the
table's models are made anew at it, and the plan's design too: target, reference specimen, weights and
the cost behind the horizon (certainty equivalence); between two renewals the filter goes on with slopes
along the parameters. The loop delay is not estimated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.planning.design_of_plant import design_of_plant
from baselines.planning.ekf import ExtendedKalmanFilter, TableEstimate, model_error
from baselines.planning.model import PlanningModel
from baselines.planning.nmpc import Design, NMPCSettings, NonlinearPredictiveControl, PlanMemory
from shake_env.errors import ScenarioError
from shake_env.model.parameters import FloatArray
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uncertainty, Uniform

# Parameters are over their nominal values.
NOT_ESTIMATED = ("delay", "storey_factor")  # fields of a scenario's uncertainty
STEP = 0.01  # [-] between the models that slopes along a parameter are taken from
WALK = 2e-4  # [-] that a parameter is taken to change by in a period
RENEW_MODEL = 0.008  # [-] by which an estimate moves before the models of the table are made anew
RENEW_DESIGN = 0.004  # [-] before the design is: a lightly damped reference asks for its frequency
PAUSE = 0.1  # [s] at least between two renewals of a table's models, and of its design
HISTORY = 2000  # periods of x_W from which the reference specimen is found anew for other parameters
LEAST = 2e-2  # [-] of the highest value, the least that a parameter whose range begins at 0 is taken for


@dataclass(frozen=True)
class UncertainParameters:
    """What a scenario draws, over nominal values."""

    scenario: Scenario
    names: tuple[str, ...]
    unit: FloatArray  # (p,) nominal values, SI
    low: FloatArray  # (p,) over the unit
    high: FloatArray  # (p,)

    @classmethod
    def from_scenario(cls, scenario: Scenario) -> UncertainParameters:
        """Return the parameters of a scenario's uncertainty.

        Raises
        ------
        ScenarioError
            If nothing is drawn, or the delay and factors of storeys alone.
        """
        drawn = {
            name: each
            for name, each in vars(scenario.uncertainty).items()
            if isinstance(each, Uniform) and name not in NOT_ESTIMATED
        }
        if not drawn:
            others = [name for name in NOT_ESTIMATED if getattr(scenario.uncertainty, name, None)]
            if not others:
                raise ScenarioError("uncertainty", "none", "no parameter is drawn: ask for nmpc")
            names = [f.name for f in fields(Uncertainty) if f.name not in NOT_ESTIMATED]
            remedy = f"is not estimated: draw one of {', '.join(names)}, or ask for nmpc"
            raise ScenarioError("uncertainty", ", ".join(others), remedy)
        own = _nominal_values(scenario)
        low = np.array([max(each.low, LEAST * each.high) for each in drawn.values()])
        high = np.array([each.high for each in drawn.values()])
        # Where the nominal value lies outside of the range, such as no friction: the range's middle.
        values = np.array([own.get(name, 0.0) for name in drawn])
        unit = np.where((values >= low) & (values <= high), values, 0.5 * (low + high))
        plain = replace(scenario, uncertainty=Uncertainty())
        return cls(plain, tuple(drawn), unit, low / unit, high / unit)

    @property
    def nominal(self) -> FloatArray:
        """The parameters (p,) of the nominal plant."""
        return np.ones(len(self.names))

    def plant(self, parameters: FloatArray) -> Scenario:
        """Return the scenario with the plant of some parameters (p,)."""
        values = dict(zip(self.names, (parameters * self.unit).tolist(), strict=True))
        return self.scenario.with_plant(values)

    @cached_property
    def spread(self) -> FloatArray:
        """Standard deviation (p,) of a uniform distribution over the range."""
        spread: FloatArray = np.maximum(self.high - self.low, 1e-6) / np.sqrt(12.0)
        return spread


def _nominal_values(scenario: Scenario) -> Mapping[str, float]:
    values: dict[str, float] = {}
    if any(name in vars(scenario.uncertainty) for name in ("mass_ratio", "storey_frequency")):
        values |= scenario.specimen.uniform_values(scenario.actuator.table_mass)
    values |= {k: v for k, v in vars(scenario.actuator).items() if isinstance(v, int | float)}
    valve = scenario.nonlinearity.valve
    values["coulomb_friction"] = scenario.nonlinearity.friction.coulomb
    values["supply_pressure"] = valve.supply_pressure
    values["valve_natural_frequency"] = valve.natural_frequency or 0.0
    return values


class AdaptivePredictiveControl(NonlinearPredictiveControl):
    """`NonlinearPredictiveControl` with the scenario's uncertain parameters as states.

    Raises
    ------
    ScenarioError
        If the scenario draws no parameter, or its storeys yield.
    """

    def __init__(self, scenario: Scenario, settings: NMPCSettings | None = None) -> None:
        self.parameters = known = UncertainParameters.from_scenario(scenario)
        if scenario.nonlinearity.yielding.active:
            raise ScenarioError(
                "nonlinearity.yielding", "on", "a specimen that yields is not identified"
            )
        # The scenario's own observation and current, and the parameters' nominal plant.
        middle = replace(known.plant(known.nominal), sensing=scenario.sensing)
        super().__init__(middle, settings)
        self._own = scenario
        self._error = model_error(middle, self.settings.model_error_scale)
        if self.filter is None:
            self.filter = ExtendedKalmanFilter.from_scenario(middle, self._error)
            self.model = self.filter.model
        p = len(known.names)
        self.filter = self.filter.with_parameters(
            np.full(p, STEP), known.low, known.high, known.spread, np.full(p, WALK)
        )
        self._to_own = scenario.plant.state_scale / middle.plant.state_scale
        self._first = self._models(known.nominal), self._design_of(known.nominal)

    def _models(self, parameters: FloatArray) -> list[FloatArray]:
        """Return the matrices (2 p + 1, ...) of a table with these parameters and of its neighbours."""
        steps = np.vstack([np.zeros(len(parameters)), np.zeros((2 * len(parameters), len(parameters)))])
        for j in range(len(parameters)):
            steps[1 + 2 * j, j], steps[2 + 2 * j, j] = STEP, -STEP
        made = [PlanningModel.of(self.parameters.plant(parameters + s), self._error) for s in steps]
        return [np.concatenate([each.arrays[i] for each in made]) for i in range(7)]

    def _design_of(self, parameters: FloatArray) -> Design:
        """Return the design for these parameters, in units of the nominal observation and state."""
        plant = self.parameters.plant(parameters)
        own = PlanningModel.of(plant, self._error)
        tolerance = self.settings.displacement_tolerance
        return design_of_plant(plant, own, self.model, self._own, self.horizon, tolerance)

    def _rest(self, lanes: int) -> PlanMemory:
        models, design = self._first
        stack = [np.concatenate([matrix] * lanes) for matrix in models]
        designs = Design(*(np.repeat(part[None], lanes, axis=0) for part in design.arrays))
        at = np.repeat(self.parameters.nominal[None], lanes, axis=0)
        history = np.zeros((lanes, 0, self._layout.filter_states))
        none = np.zeros(lanes, dtype=int)
        fresh = Tables(at, at.copy(), stack, designs, history, none, none.astype(bool), none)
        return replace(super()._rest(lanes), tables=fresh)

    def _estimate(
        self, last: PlanMemory, given: FloatArray, readings: FloatArray, fresh: NDArray[np.bool_]
    ) -> tuple[TableEstimate, Any]:
        assert self.filter is not None and last.tables is not None
        tables: Tables = last.tables
        if fresh.any():
            tables = self._begun(tables, fresh)
        scale = self._to_own[self._layout.controlled]
        if self._scenario.sensing.full_state:
            readings = readings * scale
        models = (*tables.models, *self.model.arrays[7:])
        estimate = self.filter.advance(last.estimate, given, readings, fresh, models, tables.anchor)
        p = len(self.parameters.names)
        return estimate, self._renewed(tables, estimate.rest[:, -p:])

    def _begun(self, tables: Tables, fresh: NDArray[np.bool_]) -> Tables:
        """Return the tables, those that begin at the nominal parameters."""
        models, design = self._first
        stack, arrays = [m.copy() for m in tables.models], [d.copy() for d in tables.design.arrays]
        anchor, designed = tables.anchor.copy(), tables.designed.copy()
        since = np.where(fresh, 0, tables.since)
        v = 2 * len(self.parameters.names) + 1
        for n in np.flatnonzero(fresh):
            for whole, own in zip(stack, models, strict=True):
                whole[n * v : (n + 1) * v] = own
            for whole, own in zip(arrays, design.arrays, strict=True):
                whole[n] = own
            anchor[n] = designed[n] = self.parameters.nominal
        return replace(
            tables, anchor=anchor, designed=designed, models=stack, design=Design(*arrays), since=since
        )

    def _renewed(self, tables: Tables, estimate: FloatArray) -> Tables:
        """Return the tables with models and designs at estimates (N, p) that have moved."""
        moved = np.abs(estimate - tables.anchor).max(axis=1) > RENEW_MODEL
        far = np.abs(estimate - tables.designed).max(axis=1) > RENEW_DESIGN
        due = tables.since * self._scenario.control_period >= PAUSE
        moved, far = moved & due, far & due
        since = np.where(moved | far, 1, tables.since + 1)
        if not (moved.any() or far.any()):
            return replace(tables, renewed=far, since=since)
        v = estimate.shape[1] * 2 + 1
        stack, anchor = [m.copy() for m in tables.models], tables.anchor.copy()
        for n in np.flatnonzero(moved):
            for whole, own in zip(stack, self._models(estimate[n]), strict=True):
                whole[n * v : (n + 1) * v] = own
            anchor[n] = estimate[n]
        arrays, designed = tables.design.arrays, tables.designed.copy()
        if far.any():
            arrays = tuple(part.copy() for part in arrays)
        for n in np.flatnonzero(far):
            for whole, own in zip(arrays, self._design_of(estimate[n]).arrays, strict=True):
                whole[n] = own
            designed[n] = estimate[n]
        return replace(
            tables, anchor=anchor, designed=designed, models=stack, design=Design(*arrays), renewed=far,
            since=since,
        )  # fmt: skip

    def _noted(self, tables: Tables, ground: FloatArray, fresh: NDArray[np.bool_]) -> Tables:
        history = np.concatenate([tables.history[:, -HISTORY + 1 :], ground[:, None]], axis=1)
        age = np.where(fresh, 1, np.minimum(tables.age + 1, history.shape[1]))
        return replace(tables, history=history, age=age)

    def _reference(
        self,
        shown: FloatArray,
        last: PlanMemory,
        ground: FloatArray,
        fresh: NDArray[np.bool_],
        tables: Tables,
    ) -> tuple[FloatArray, FloatArray]:
        """As it is followed; where the parameters are others now, anew from the start for these.

        What another specimen would still be vibrating with decays over seconds.
        """
        reference = super()._reference(shown, last, ground, fresh, tables)[0].copy()
        if not self._scenario.sensing.full_state:
            for n in np.flatnonzero(tables.renewed & ~fresh):
                reference[n] = _followed(tables, int(n))
        return reference, reference

    def _design(self, memory: Any) -> Design:
        tables: Tables = memory
        return tables.design

    def _plan_models(self, memory: Any) -> tuple[Any, ...]:
        tables: Tables = memory
        v = 2 * len(self.parameters.names) + 1
        own = (np.ascontiguousarray(matrix[::v]) for matrix in tables.models)
        return (*own, *self.model.arrays[7:])


@dataclass(frozen=True)
class Tables:
    """Models and designs of N tables, and the parameters that they were made at."""

    anchor: FloatArray  # (N, p) of the models
    designed: FloatArray  # (N, p) of the designs
    models: list[FloatArray]  # each (N (2 p + 1), ...), see `ExtendedKalmanFilter.advance`
    design: Design  # each (N, ...)
    history: FloatArray  # (N, up to HISTORY, w) x_W of the last periods, over its scale
    age: NDArray[np.intp]  # (N,) how many of them are of the present episode
    renewed: NDArray[np.bool_]  # (N,) whether the design was made anew at this instant
    since: NDArray[np.intp]  # (N,) periods since a renewal


def _followed(tables: Tables, n: int) -> FloatArray:
    """Return x~_S (2 stories) of table n, over its scale, from rest through the history."""
    design, history = tables.design, tables.history[n, tables.history.shape[1] - tables.age[n] :]
    pushed = history[:-1] @ design.before[n].T + history[1:] @ design.now[n].T
    state: FloatArray = np.zeros(len(design.follow[n]))
    for push in pushed:
        state = design.follow[n] @ state + push
    return state
