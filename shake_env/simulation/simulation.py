"""A batch of tables in their episodes: what both environments, SB3's VecEnv and roll-outs step."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from shake_env.dynamics.ground import GroundMaps, GroundPeriod
from shake_env.model.inputs import checked_action as checked_action
from shake_env.model.parameters import FloatArray
from shake_env.motion.targets import Motion
from shake_env.numba_support import compiled_module
from shake_env.scenario.limits import OBSERVATION_BOUND
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.excitation import Excitation, control_steps
from shake_env.simulation.fused_layout import LIMIT_COST, REWARD
from shake_env.simulation.memory import check_memory
from shake_env.simulation.plant_batch import Fleet
from shake_env.simulation.sensors import SensorMemory, SensorNoise
from shake_env.simulation.transition import Outcome, TableModel

if TYPE_CHECKING:
    from shake_env.simulation.fused_tables import FusedTables

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


class StepResult:
    """One control period of N tables; what is rarely read is made when asked for."""

    observation: NDArray[np.float32]  # (N, n) what the sensing shows after the period, fresh memory
    reward: FloatArray  # (N,) minus stage cost, minus the cost of a broken limit
    terminated: BoolArray  # (N,) a limit was broken
    truncated: BoolArray  # (N,) the motion ended, and no limit was broken
    limit_cost: FloatArray  # (N,) what a broken limit cost

    def __init__(
        self,
        observation: NDArray[np.float32],
        reward: FloatArray,
        ends: tuple[BoolArray, BoolArray] | BoolArray,
        limit_cost: FloatArray,
        outcome: Callable[[], Outcome],
        ground: Callable[[], GroundPeriod],
        rows: FloatArray | None = None,
    ) -> None:
        self.observation, self.reward, self.limit_cost = observation, reward, limit_cost
        self.terminated, self.truncated = ends
        self._outcome, self._ground, self._rows = outcome, ground, rows

    @property
    def report(self) -> Iterable[FloatArray]:
        """What a step reports, (N,) each, in SI and in the order of `env.INFO_KEYS`."""
        return step_report(self) if self._rows is None else self._rows

    @cached_property
    def outcome(self) -> Outcome:
        """What the period brought."""
        return self._outcome()

    @cached_property
    def ground(self) -> GroundPeriod:
        """The ground, a view of the excitation's buffer: valid until the next step."""
        return self._ground()


class Simulation:
    """N tables, each with its own motion, random stream and place in its episode.

    Parameters
    ----------
    scenario
        What is simulated.
    lanes
        Number of tables N.

    Raises
    ------
    ScenarioError
        If they need more memory than is free.
    NumericalError
        If a parameter combination leaves a matrix without digits.
    """

    def __init__(self, scenario: Scenario, lanes: int) -> None:
        check_memory(scenario, lanes)
        self.scenario = scenario
        self.lanes = lanes
        self.fleet = Fleet(scenario, lanes) if scenario.uncertainty.active else None
        if self.fleet is None:
            self.model = TableModel.of(scenario)
            maps = GroundMaps.of(scenario.discrete, scenario.nonlinearity.yielding)
        else:
            self.model, maps = self.fleet.model, self.fleet.maps
        preview = scenario.sensing.preview_steps(scenario.control_period, scenario.physics_step)
        self.excitation = Excitation(scenario.discrete, lanes, maps, preview)
        self.noise = SensorNoise(scenario.observation, lanes)
        motionless = scenario.stage_cost.motionless(scenario.plant)
        self._limit_rate = scenario.limits.cost_factor * motionless
        horizon = scenario.limits.cost_horizon
        self._limit_steps = None if horizon is None else max(1, round(horizon / scenario.control_period))
        # Without the compiled step, what it would hold.
        self._own_counters = np.zeros((2, lanes), dtype=np.int64)
        self._own_severity = np.ones(lanes)
        self._state = np.zeros((lanes, self.model.dynamics.states))
        self._memory = self.model.measurement.rest(lanes)
        self._fused = self._fuse(preview)

    def _fuse(self, preview: tuple[int, int]) -> FusedTables | None:
        """Return the tables as the compiled step holds them, or None where there is none."""
        engine = compiled_module("shake_env.simulation.fused_tables")
        if engine is None:
            return None
        tables: FusedTables = engine.FusedTables(
            self.model,
            self.lanes,
            limit_rate=self._limit_rate,
            limit_steps=self._limit_steps,
            preview=preview,
        )
        return tables

    @property
    def state(self) -> FloatArray:
        """State of the tables (N, states), SI, [x_A, x_S] first; that of the last step's result."""
        return self._state if self._fused is None else self._fused.state

    @state.setter
    def state(self, state: FloatArray) -> None:
        if self._fused is None:
            self._state = state
        else:
            self._fused.state = state

    @property
    def memory(self) -> SensorMemory:
        """What the sensors remember."""
        return self._memory if self._fused is None else self._fused.memory

    @memory.setter
    def memory(self, memory: SensorMemory) -> None:
        if self._fused is None:
            self._memory = memory
        else:
            self._fused.memory = memory

    @property
    def step_count(self) -> IntArray:
        """Control periods since each lane's start (N,)."""
        counters = self._own_counters if self._fused is None else self._fused.counters
        count: IntArray = counters[0]
        return count

    @property
    def episode_steps(self) -> IntArray:
        """Control periods in each lane's episode (N,)."""
        counters = self._own_counters if self._fused is None else self._fused.counters
        steps: IntArray = counters[1]
        return steps

    @property
    def _severity(self) -> FloatArray:
        """Motionless cost of each lane's motion over the unit target's (N,)."""
        return self._own_severity if self._fused is None else self._fused.own[0]

    @property
    def observation_size(self) -> int:
        """Length n of an observation."""
        return self.scenario.observation.size

    def start(
        self,
        lanes: Sequence[int],
        streams: Sequence[np.random.Generator],
        motions: Sequence[Motion] | None = None,
    ) -> NDArray[np.float32]:
        """Begin an episode in each of `lanes`: table and specimen at rest, a motion from its start.

        Parameters
        ----------
        lanes
            Indices of the tables.
        streams
            One generator a lane, used up by its episode alone.
        motions
            One motion a lane; None takes the scenario's.

        Returns
        -------
        Observations (len(lanes), n).
        """
        given = [self.scenario.motion] * len(lanes) if motions is None else motions
        chosen = [motion.pick(stream) for motion, stream in zip(given, streams, strict=True)]
        period, physics_step = self.scenario.control_period, self.scenario.physics_step
        # First what may be refused: the tables then are what they were.
        steps = [control_steps(motion, period, physics_step) for motion in chosen]
        if self.fleet is not None:
            self.fleet.draw(lanes, streams)
            if self._fused is not None:
                self._fused.redrawn(lanes)
        ground = self.excitation.start(lanes, chosen, streams)
        index = np.asarray(lanes, dtype=int)
        # A new array: the old one is the state of the last step's result, which a caller may hold.
        state = self.state.copy()
        state[index] = 0.0
        self.state = state
        self.step_count[index] = 0
        self.episode_steps[index] = steps
        # A weak motion lowers what standing still costs, but not what braking a fast table does.
        self._severity[index] = [max(1.0, m.amplitude**2) for m in chosen]
        return _observation(self._first_look(index, ground, streams))

    def _first_look(
        self, lanes: NDArray[np.intp], ground: GroundPeriod, streams: Sequence[np.random.Generator]
    ) -> Any:
        """Return the first observation (len(lanes), n) of tables at rest."""
        model, memory = self.model, self.model.measurement.rest(len(lanes))
        bias, noise = self.noise.start(lanes.tolist(), streams)
        if self.scenario.sensing.full_state:
            head = model.full_state(self.state[lanes], ground)
            shown = model.measurement.observation(head, None, ground.preview, memory)
        else:
            memory = replace(memory, bias=bias)
            signals = np.zeros((len(lanes), self.scenario.observation.readings_count))
            readings, memory = model.measurement.read(memory, signals, noise, memory.action)
            shown, memory = model.show(readings, ground, memory)
        kept, now = {}, self.memory
        for field in fields(SensorMemory):
            kept[field.name] = getattr(now, field.name).copy()
            kept[field.name][lanes] = getattr(memory, field.name)
        self.memory = SensorMemory(**kept)
        return shown

    def step(self, action: FloatArray) -> StepResult:
        """Advance every table by one control period under `action` (N,), finite."""
        if self._fused is None:
            return self._reference_step(action)
        fused, excitation = self._fused, self.excitation
        fused.action[:] = action
        store, row = excitation.take()
        noise, sample = self.noise.take()
        seen, block, ends = fused.step(store, noise, row, sample)
        return StepResult(
            seen,
            block[REWARD],
            ends,
            block[LIMIT_COST],
            lambda: fused.outcome(block),
            lambda: excitation.period(store, row),
            block[:REWARD],
        )

    def step_alone(self, action: float) -> tuple[NDArray[np.float32], list[float], int]:
        """Advance the one table.

        Returns
        -------
        observation, report, ends
            (n,); what `step_report` says, then reward and code of a broken limit, as numbers; 1 if the
            episode is terminated, 2 if truncated, else 0.
        """
        if self._fused is None:
            result = self._reference_step(np.array([action]))
            values = (*step_report(result), result.reward, result.outcome.broken)
            ends = 1 if result.terminated[0] else 2 * int(result.truncated[0])
            return result.observation[0], [float(value[0]) for value in values], ends
        self._fused.action[0] = action
        store, row = self.excitation.take()
        noise, sample = self.noise.take()
        return self._fused.step_alone(store, noise, row, sample)

    def _reference_step(self, action: FloatArray) -> StepResult:
        ground = self.excitation.advance()
        outcome = self.model.transition(self._state, action, ground)
        self._state = outcome.response.state
        self.step_count[:] += 1
        terminated = outcome.broken != 0
        truncated = (self.step_count >= self.episode_steps) & ~terminated
        limit_cost = np.zeros(self.lanes)
        if terminated.any():
            limit_cost = np.where(terminated, self.breaking_cost(self.step_count), 0.0)
        observation, self._memory = self.model.observe(
            outcome, ground, action, self._memory, self.noise.advance()
        )
        reward = -(outcome.cost.total + outcome.soft_cost + limit_cost)
        seen, ends = _observation(observation), (terminated, truncated)
        return StepResult(seen, reward, ends, limit_cost, lambda: outcome, lambda: ground)

    def breaking_cost(self, step_count: NDArray[np.int_]) -> FloatArray:
        """Return what breaking a limit costs (N,) in the period that makes `step_count` (N,) of them."""
        remaining = np.maximum(self.episode_steps - step_count, 1)
        if self._limit_steps is not None:
            remaining = np.minimum(remaining, self._limit_steps)
        cost: FloatArray = self._limit_rate * self._severity * remaining
        return cost

    def snapshot(self) -> dict[str, Any]:
        """Return everything that `restore` needs to go on exactly."""
        return {
            "excitation": self.excitation.snapshot(),
            "state": self.state.copy(),
            "step_count": self.step_count.copy(),
            "episode_steps": self.episode_steps.copy(),
            "severity": self._severity.copy(),
            "noise": self.noise.snapshot(),
            "memory": self.memory,  # a copy, or frozen and never changed in place
            "fleet": None if self.fleet is None else self.fleet.snapshot(),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a `snapshot` of a simulation of the same scenario and number of lanes."""
        self.excitation.restore(snapshot["excitation"])
        self.state = snapshot["state"].copy()
        self.step_count[:] = snapshot["step_count"]
        self.episode_steps[:] = snapshot["episode_steps"]
        self._severity[:] = snapshot["severity"]
        self.noise.restore(snapshot["noise"])
        self.memory = snapshot["memory"]
        if self.fleet is not None:
            self.fleet.restore(snapshot["fleet"])
            if self._fused is not None:
                self._fused.redrawn(range(self.lanes))


def step_report(result: StepResult) -> tuple[FloatArray, ...]:
    """Return what a step reports (N,) each, in SI and in the order of :mod:`packing`'s rows."""
    outcome, ground = result.outcome, result.ground
    response, state = outcome.response, outcome.response.state
    return (
        response.table_acceleration[:, -1],
        ground.target[:, -1].copy(),
        response.base_shear[:, -1],
        ground.reference_shear[:, -1].copy(),
        outcome.current,
        state[:, 1].copy(),  # a view would hand out the table's own state
        state[:, 2].copy(),
        state[:, 0].copy(),
        outcome.cost.acceleration,
        outcome.cost.force,
        outcome.cost.current,
        result.limit_cost,
        outcome.soft_cost,
    )


def _observation(scaled: FloatArray) -> NDArray[np.float32]:
    # Only the drifting position, or a table that has just diverged, comes near the bound.
    bounded = np.minimum(np.maximum(scaled, -OBSERVATION_BOUND), OBSERVATION_BOUND)
    if np.isnan(bounded.sum()):
        bounded = np.nan_to_num(bounded)
    observation: NDArray[np.float32] = bounded.astype(np.float32)
    return observation


def episode_stream(generator: np.random.Generator) -> np.random.Generator:
    """Return the stream of a lane's next episode.

    Spawned, so that how far ahead the ground is computed never shows in what comes after.
    """
    return generator.spawn(1)[0]
