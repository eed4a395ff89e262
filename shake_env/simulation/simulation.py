"""A batch of tables in their episodes: what both environments, SB3's VecEnv and roll-outs step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.dynamics.ground import GroundMaps, GroundPeriod
from shake_env.errors import ScenarioError
from shake_env.model.inputs import checked_action as checked_action
from shake_env.model.parameters import FloatArray
from shake_env.model.random_numbers import episode_key
from shake_env.model.specimen_state import SpecimenState
from shake_env.motion.targets import EpisodeMotion, Motion, control_steps
from shake_env.numba_support import compiled_module
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.engine import (
    BoolArray,
    Engine,
    Episode,
    IntArray,
    LaneState,
    Observations,
    StepResult,
    Tables,
)
from shake_env.simulation.memory import check_memory
from shake_env.simulation.plant_batch import PlantBatch
from shake_env.simulation.reference_engine import ReferenceEngine
from shake_env.simulation.sensors import SensorMemory
from shake_env.simulation.transition import TableModel


class Simulation:
    """N tables, each with its own motion, random numbers and place in its episode.

    Parameters
    ----------
    scenario
        What is simulated.
    lanes
        Number of tables N.
    threads
        Threads that step them, where there are 512 tables or more for each.

    Raises
    ------
    ScenarioError
        If they need more memory than is free.
    NumericalError
        If a parameter combination leaves a matrix without digits.
    """

    def __init__(self, scenario: Scenario, lanes: int, *, threads: int = 1) -> None:
        check_memory(scenario, lanes)
        self.scenario = scenario
        self.lanes = lanes
        self.plant_batch = PlantBatch(scenario, lanes) if scenario.uncertainty.active else None
        if self.plant_batch is None:
            self.model = TableModel.from_scenario(scenario)
            maps = GroundMaps.from_plant(scenario.discrete, scenario.nonlinearity.yielding)
        else:
            self.model, maps = self.plant_batch.model, self.plant_batch.maps
        horizon, period = scenario.limits.cost_horizon, scenario.control_period
        self.tables = Tables(
            scenario=scenario,
            model=self.model,
            maps=maps,
            lanes=lanes,
            preview=scenario.sensing.preview_steps(scenario.physics_step),
            limit_rate=scenario.limits.cost_factor * scenario.stage_cost.motionless(scenario.plant),
            limit_steps=math.inf if horizon is None else max(1, round(horizon / period)),
            threads=threads,
        )
        self.engine = _engine(self.tables)

    @property
    def state(self) -> FloatArray:
        """State of the tables (N, states), SI, [x_A, x_S] first; a copy, which can be set."""
        return self.engine.state

    @state.setter
    def state(self, state: FloatArray) -> None:
        self.engine.state = state

    @property
    def motions(self) -> list[EpisodeMotion]:
        """The motion of each lane's episode (N)."""
        return list(self.engine.motions)

    @property
    def first_drifts(self) -> FloatArray:
        """Drift of the first storey of specimens and reference specimens (2, N) [m]."""
        reference = self.engine.ground(preview=False).reference
        drifts: FloatArray = np.stack([self.engine.state[:, 4], reference[:, 0]])
        return drifts

    @property
    def specimens(self) -> tuple[FloatArray, FloatArray]:
        """``[x_r, x_r', s]`` of specimens and references (N, 3 stories); (N, 0) if none yield.

        A preview has the reference computed ahead: its state is that at the end of what is shown.
        """
        size = 3 * self.scenario.specimen.stories * self.scenario.nonlinearity.yielding.active
        state = self.engine.get_state()
        return state["state"][:, 4 : 4 + size], state["slipping"][:, :size]

    @property
    def memory(self) -> SensorMemory:
        """What the sensors remember; a copy, which can be set."""
        return self.engine.memory

    @memory.setter
    def memory(self, memory: SensorMemory) -> None:
        self.engine.memory = memory

    @property
    def step_count(self) -> IntArray:
        """Control periods since each lane's start (N,), a view."""
        return self.engine.step_count

    @property
    def episode_steps(self) -> IntArray:
        """Control periods in each lane's episode (N,), a view."""
        return self.engine.episode_steps

    @property
    def observation_size(self) -> int:
        """Length n of an observation."""
        return self.scenario.observation.size

    def start(
        self,
        lanes: Sequence[int],
        streams: Sequence[np.random.Generator],
        motions: Sequence[Motion] | None = None,
        specimens: Sequence[SpecimenState | None] | None = None,
        *,
        draw: bool = True,
    ) -> Observations:
        """Begin an episode in each of `lanes`: table and specimen at rest, a motion from its start.

        Parameters
        ----------
        lanes
            Indices of the tables.
        streams
            One generator a lane, used up by its episode alone: for its motion, its plant, and the key of
            its random numbers.
        motions
            One motion a lane; None takes the scenario's.
        specimens
            Damage of each lane's specimen at the start; None: that of the plant's sample, else as new.
        draw
            Whether an uncertain plant is drawn anew; False: each lane keeps its own.

        Returns
        -------
        Observations (len(lanes), n).

        Raises
        ------
        ScenarioError
            If a specimen is damaged whose storeys do not yield.
        """
        given = [self.scenario.motion] * len(lanes) if motions is None else motions
        chosen = [motion.pick(stream) for motion, stream in zip(given, streams, strict=True)]
        period, physics_step = self.scenario.control_period, self.scenario.physics_step
        # First what may be refused: the tables then are what they were.
        steps = [control_steps(motion, period, physics_step) for motion in chosen]
        given_states = [None] * len(lanes) if specimens is None else specimens
        yielding, stories = self.scenario.nonlinearity.yielding, self.scenario.specimen.stories
        initial = [None if s is None else s.initial(yielding, stories) for s in given_states]
        if self.plant_batch is not None and draw:
            self.plant_batch.sample(lanes, streams)
            self.engine.redrawn(lanes)
            initial = [
                own if state is not None else self.plant_batch.damage(lane)
                for lane, state, own in zip(lanes, given_states, initial, strict=True)
            ]
        # A weak motion lowers what standing still costs, but not what braking a fast table does.
        episodes = [
            Episode(episode_key(stream), motion, count, max(1.0, motion.amplitude**2), damage)
            for stream, motion, count, damage in zip(streams, chosen, steps, initial, strict=True)
        ]
        return self.engine.start(lanes, episodes)

    def step(self, action: NDArray[np.floating[Any]]) -> StepResult:
        """Advance every table by one control period under `action` (N,), finite."""
        return self.engine.step(action)

    def rest(self, lanes: BoolArray) -> None:
        """Put the state of some tables (N,) of bool to rest, in the middle of their episodes."""
        self.engine.rest(lanes)

    def advance_ground(self) -> tuple[GroundPeriod, FloatArray]:
        """Advance the ground alone, as learning through the plant does.

        Returns
        -------
        The ground of the next period (N, ...), and the noise (N, s) of the readings at its end, SI.
        """
        return self.engine.advance_ground()

    def ground_ahead(self, steps: int) -> tuple[GroundPeriod, FloatArray]:
        """Advance the ground by `steps` periods; return what `advance_ground` does, stacked in front."""
        periods, noise = zip(*(self.engine.advance_ground() for _ in range(steps)), strict=True)
        parts = ([getattr(period, field.name) for period in periods] for field in fields(GroundPeriod))
        stacked = (None if column[0] is None else np.stack(column) for column in parts)
        return GroundPeriod(*stacked), np.stack(noise)

    def termination_penalty(self, step_count: IntArray) -> FloatArray:
        """Return what breaking a limit costs (N,) in the period that makes `step_count` (N,) of them."""
        tables = self.tables
        remaining = np.minimum(np.maximum(self.episode_steps - step_count, 1), tables.limit_steps)
        cost: FloatArray = tables.limit_rate * self.engine.severity * remaining
        return cost

    def get_state(self, lanes: Sequence[int] | None = None) -> LaneState:
        """Return everything that tables go on from; each is then where it stood, to the bit.

        Parameters
        ----------
        lanes
            Indices of the tables; None: all N.

        Returns
        -------
        Arrays with one row a table: plant state with the commands under way, sensors, ground and
        preview, key and counters of the random numbers, place in the episode, and a drawn plant. Two
        are arrays of objects: ``motion``, and ``plant_values`` of a drawn plant.
        """
        state = self.engine.get_state()
        if self.plant_batch is not None:
            state |= self.plant_batch.get_state()
        if lanes is None:
            return state
        index = self._index(lanes)
        return {name: array[index] for name, array in state.items()}

    def set_state(self, state: Mapping[str, NDArray[Any]], lanes: Sequence[int] | None = None) -> None:
        """Put tables where others stood; the rest goes on as it was.

        Parameters
        ----------
        state
            What :meth:`get_state` returned, of a simulation of the same scenario.
        lanes
            Indices of the tables that take its rows, in order; None: all N.

        Raises
        ------
        ScenarioError
            If the state is of another scenario or of another number of tables.
        """
        index = self._index(range(self.lanes) if lanes is None else lanes)
        whole = self.get_state()
        if set(whole) != set(state):
            odd = sorted(set(whole) ^ set(state))
            raise ScenarioError("state", odd, "only one has it: take the state of the same scenario")
        for name, own in whole.items():
            given = np.asarray(state[name])
            if given.shape != (len(index), *own.shape[1:]) or given.dtype != own.dtype:
                wanted = f"must be {own.dtype} of shape {(len(index), *own.shape[1:])}"
                raise ScenarioError(f"state {name}", (str(given.dtype), given.shape), wanted)
            own[index] = given
        if self.plant_batch is not None:
            self.plant_batch.set_state(state, index.tolist())
            self.engine.redrawn(index.tolist())
        self.engine.set_state(whole)

    def _index(self, lanes: Sequence[int]) -> IntArray:
        index = np.asarray(lanes, dtype=np.int64)
        if index.ndim != 1 or not np.isin(index, np.arange(self.lanes)).all():
            raise ScenarioError("lanes", lanes, f"must be indices of tables, 0 to {self.lanes - 1}")
        return index


def _engine(tables: Tables) -> Engine:
    """Return the compiled engine, or the readable one where there is no numba."""
    compiled = compiled_module("shake_env.simulation.compiled_engine")
    if compiled is None:
        return ReferenceEngine(tables)
    engine: Engine = compiled.CompiledEngine(tables)
    return engine
