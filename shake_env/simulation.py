"""A batch of tables in their episodes: what both environments, SB3's VecEnv and roll-outs step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shake_env.errors import ActionError
from shake_env.excitation import Excitation, GroundMaps, GroundPeriod, control_steps
from shake_env.fleet import Fleet
from shake_env.limits import OBSERVATION_BOUND
from shake_env.measurement import SensorMemory, SensorNoise
from shake_env.motion import Motion
from shake_env.parameters import FloatArray
from shake_env.scenario import Scenario
from shake_env.transition import Outcome, TableModel

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class StepResult:
    """One control period of N tables."""

    observation: NDArray[np.float32]  # (N, n) what the sensing shows after the period, fresh memory
    reward: FloatArray  # (N,) minus stage cost, minus the cost of a broken limit
    terminated: BoolArray  # (N,) a limit was broken
    truncated: BoolArray  # (N,) the motion ended, and no limit was broken
    outcome: Outcome
    ground: GroundPeriod  # a view of the excitation's buffer: valid until the next step
    limit_cost: FloatArray  # (N,) what a broken limit cost


class Simulation:
    """N tables, each with its own motion, random stream and place in its episode.

    Parameters
    ----------
    scenario
        What is simulated.
    lanes
        Number of tables N.
    """

    def __init__(self, scenario: Scenario, lanes: int) -> None:
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
        self.memory = self.model.measurement.rest(lanes)
        self.state = np.zeros((lanes, self.model.dynamics.states))  # SI, [x_A, x_S] first
        self.step_count = np.zeros(lanes, dtype=int)  # control periods since each lane's start
        self.episode_steps = np.zeros(lanes, dtype=int)
        motionless = scenario.stage_cost.motionless(scenario.plant)
        self._limit_rate = scenario.limits.cost_factor * motionless
        self._severity = np.ones(lanes)  # motionless cost of each lane's motion over the unit target's
        horizon = scenario.limits.cost_horizon
        self._limit_steps = None if horizon is None else max(1, round(horizon / scenario.control_period))

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
        if self.fleet is not None:
            self.fleet.draw(lanes, streams)
        ground = self.excitation.start(lanes, chosen, streams)
        period, physics_step = self.scenario.control_period, self.scenario.physics_step
        index = np.asarray(lanes, dtype=int)
        # A new array: the old one is the state of the last step's result, which a caller may hold.
        self.state = self.state.copy()
        self.state[index] = 0.0
        self.step_count[index] = 0
        self.episode_steps[index] = [control_steps(m, period, physics_step) for m in chosen]
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
        kept = {}
        for field in fields(SensorMemory):
            kept[field.name] = getattr(self.memory, field.name).copy()
            kept[field.name][lanes] = getattr(memory, field.name)
        self.memory = SensorMemory(**kept)
        return shown

    def step(self, action: FloatArray) -> StepResult:
        """Advance every table by one control period under `action` (N,), finite."""
        ground = self.excitation.advance()
        outcome = self.model.transition(self.state, action, ground)
        self.state = outcome.response.state
        self.step_count += 1
        terminated = outcome.broken != 0
        truncated = (self.step_count >= self.episode_steps) & ~terminated
        limit_cost = np.zeros(self.lanes)
        if terminated.any():
            limit_cost = np.where(terminated, self.breaking_cost(self.step_count), 0.0)
        observation, self.memory = self.model.observe(
            outcome, ground, action, self.memory, self.noise.advance()
        )
        return StepResult(
            _observation(observation),
            -(outcome.cost.total + outcome.soft_cost + limit_cost),
            terminated,
            truncated,
            outcome,
            ground,
            limit_cost,
        )

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
            "memory": self.memory,  # frozen, and never changed in place
            "fleet": None if self.fleet is None else self.fleet.snapshot(),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a `snapshot` of a simulation of the same scenario and number of lanes."""
        self.excitation.restore(snapshot["excitation"])
        self.state = snapshot["state"].copy()
        self.step_count = snapshot["step_count"].copy()
        self.episode_steps = snapshot["episode_steps"].copy()
        self._severity = snapshot["severity"].copy()
        self.noise.restore(snapshot["noise"])
        self.memory = snapshot["memory"]
        if self.fleet is not None:
            self.fleet.restore(snapshot["fleet"])


def _observation(scaled: FloatArray) -> NDArray[np.float32]:
    # Only the drifting position, or a table that has just diverged, comes near the bound.
    bounded = np.minimum(np.maximum(scaled, -OBSERVATION_BOUND), OBSERVATION_BOUND)
    if np.isnan(bounded.sum()):
        bounded = np.nan_to_num(bounded)
    observation: NDArray[np.float32] = bounded.astype(np.float32)
    return observation


def checked_action(action: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Return `action` as float64 of `shape`.

    Raises
    ------
    ActionError
        If it has another shape, or is not all finite numbers.
    """
    try:
        array = np.asarray(action, dtype=np.float64)
    except (TypeError, ValueError):
        raise ActionError("action", action, f"must be numbers of shape {shape}") from None
    if array.shape != shape:
        raise ActionError("action shape", array.shape, f"must be {shape}")
    if not np.isfinite(array).all():
        raise ActionError(
            "action", action, "must be finite: current as a fraction of the limit, -1 to 1"
        )
    return array


def episode_stream(generator: np.random.Generator) -> np.random.Generator:
    """Return the stream of a lane's next episode.

    Spawned, so that how far ahead the ground is computed never shows in what comes after.
    """
    return generator.spawn(1)[0]
