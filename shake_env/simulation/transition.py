"""One control period of an episode: action in, next state, response, cost and limits out.

Pure, and written against the array API: the environments run it on numpy arrays, learning through the
plant on torch tensors.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

import array_api_compat
import numpy as np

from shake_env.dynamics.ground import GroundPeriod
from shake_env.dynamics.linear import PeriodResponse, TableDynamics, as_like
from shake_env.dynamics.nonlinear import NonlinearDynamics, apply, floor_rows
from shake_env.model.parameters import FloatArray
from shake_env.scenario.limits import Limits
from shake_env.scenario.objective import CostTerms, StageCost
from shake_env.scenario.observation import FLOOR_ACCELERATIONS
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.sensors import Measurement, SensorMemory

Array = Any  # a numpy array or a torch tensor


@dataclass(frozen=True)
class Outcome:
    """What one control period brought."""

    response: PeriodResponse
    current: Array  # (...) [A]
    cost: CostTerms  # each (...)
    soft_cost: Array  # (...) what soft limits add
    broken: Array  # (...) 0, or 1 + index in limits.REASONS
    floors: Array | None  # (..., stories) absolute accelerations [m/s^2]; None where nothing asks


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
    floor_rows: Array | None  # (..., stories, 2 or 3 stories) see nonlinear_dynamics.floor_rows
    measurement: Measurement

    @classmethod
    def from_scenario(cls, scenario: Scenario) -> TableModel:
        """Return the model of a scenario, in numpy."""
        return _model(scenario)

    def to(self, array: Array) -> TableModel:
        """Return this model in the library, precision and device of `array`."""
        cost = self.stage_cost
        if np.ndim(cost.force):  # one a table
            names = (field.name for field in fields(StageCost))
            cost = StageCost(*(as_like(getattr(cost, name), array) for name in names))
        return TableModel(
            self.dynamics.to(array),
            cost,
            self.limits,
            self.current_limit,
            as_like(self.observation_scale, array),
            self.filter_states,
            self.controlled,
            None if self.floor_rows is None else as_like(self.floor_rows, array),
            self.measurement.to(array),
        )

    def transition(self, state: Array, action: Array, ground: GroundPeriod) -> Outcome:
        """Advance the table by one control period.

        Parameters
        ----------
        state
            (..., states) in SI: [x_A, x_S], then what nonlinear parts and commands under way add.
        action
            (...) current as a fraction of the limit; clipped to [-1, 1].
        ground
            The ground over this period.
        """
        current = self.current_limit * action.clip(-1.0, 1.0)
        return self.judge(self.dynamics.control_step(state, current, ground.drive), current, ground)

    def judge(self, response: PeriodResponse, current: Array, ground: GroundPeriod) -> Outcome:
        """Return what a response costs and which limits it breaks.

        Nothing in it feeds back into the table, so that a whole window of periods, stacked along a
        leading axis, can be judged at once.

        Parameters
        ----------
        response, ground
            Of the period.
        current
            (...) command of the period [A].
        """
        cost = self.stage_cost.terms(
            response.table_acceleration,
            ground.target,
            response.base_shear,
            ground.reference_shear,
            current,
        )
        linear = response.state[..., : self.controlled]
        scale = self.observation_scale[self.filter_states : self.filter_states + self.controlled]
        acceleration = response.table_acceleration
        floors = None if self.floor_rows is None else self.floors(response.state)
        broken = self.limits.broken(linear / scale, linear, acceleration, current, floors)
        soft = self.limits.soft_cost(linear, acceleration, floors)
        return Outcome(response, current, cost, soft, broken, floors)

    def floors(self, state: Array) -> Array:
        """Return the absolute accelerations of the floors (..., stories) [m/s^2]."""
        assert self.floor_rows is not None  # `of` made them where something asks
        return apply(self.floor_rows, state[..., 4 : 4 + self.floor_rows.shape[-1]])

    def full_state(self, state: Array, ground: GroundPeriod) -> Array:
        """Return the full scaled state (..., n), ``[x_W, x_A, x_S, x~_S]`` over its scale.

        What a nonlinear plant adds to the state (slips, the spool's velocity, commands under way) is not
        in it.
        """
        xp = array_api_compat.array_namespace(state)
        full = xp.concat([ground.ground, state[..., : self.controlled], ground.reference], axis=-1)
        return full / self.observation_scale

    def observe(
        self,
        outcome: Outcome,
        ground: GroundPeriod,
        action: Array,
        memory: SensorMemory,
        noise: Array,
    ) -> tuple[Array, SensorMemory]:
        """Return what a controller is shown after a period (..., n), and the sensors' memory.

        Parameters
        ----------
        outcome, ground
            Of the period.
        action
            (...) of the period.
        memory
            The sensors', from the period before.
        noise
            (..., s) of the readings, SI.
        """
        return self.look(outcome.response, outcome.floors, ground, action.clip(-1.0, 1.0), memory, noise)

    def look(
        self,
        response: PeriodResponse,
        floors: Array | None,
        ground: GroundPeriod,
        action: Array,
        memory: SensorMemory,
        noise: Array,
    ) -> tuple[Array, SensorMemory]:
        """Return what `observe` returns, of a response that has not been judged.

        Parameters
        ----------
        floors
            (..., stories) accelerations of the floors [m/s^2]; needed where they are measured.
        action
            (...) of the period, within [-1, 1].
        """
        state = response.state
        if self.measurement.layout.sensing.full_state:
            memory = replace(memory, action=action)
            head = self.full_state(state, ground)
            return self.measurement.observation(head, None, ground.preview, memory), memory
        signals = self.measurement.signals(
            state, response.table_acceleration[..., -1], response.base_shear[..., -1], floors
        )
        readings, memory = self.measurement.read(memory, signals, noise, action)
        return self.show(readings, ground, memory)

    def show(
        self, readings: Array, ground: GroundPeriod, memory: SensorMemory
    ) -> tuple[Array, SensorMemory]:
        """Return the observation that holds `readings` (..., s), and the memory that knows of them."""
        head = ground.ground / self.observation_scale[: self.filter_states]
        shown = self.measurement.observation(head, readings, ground.preview, memory)
        return shown, self.measurement.remember(memory, readings)


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
        floors_of(scenario),
        Measurement.from_scenario(scenario),
    )


def floors_of(scenario: Scenario) -> FloatArray | None:
    """Return the rows of the floors' accelerations, or None where no sensor or limit asks for them."""
    measured = any(s.signal == FLOOR_ACCELERATIONS for s in scenario.sensing.sensors or ())
    if not (measured or scenario.limits.sees_floors):
        return None
    return floor_rows(scenario.plant, scenario.nonlinearity.yielding)


def dynamics_of(scenario: Scenario) -> TableDynamics | NonlinearDynamics:
    """Return the update of a scenario's table: the lifted linear one where nothing else is needed."""
    low_passes = scenario.observation.low_passes
    active = scenario.nonlinearity.active or scenario.uncertainty.active
    if active or scenario.delay or low_passes:
        return NonlinearDynamics.from_plant(
            scenario.plant,
            scenario.parts,
            scenario.physics_step,
            scenario.substeps,
            delay=scenario.delay,
            longest_delay=scenario.longest_delay,
            low_passes=low_passes,
        )
    return TableDynamics.from_plant(scenario.discrete)
