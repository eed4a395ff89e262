"""The readable engine, in numpy: what is compiled is tested equal to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.dynamics.ground import GroundPeriod
from shake_env.kernels.layout import TERMINATED, TRUNCATED
from shake_env.model.parameters import FloatArray
from shake_env.model.random_numbers import GAINS, OFFSETS, SENSORS, normals
from shake_env.motion.targets import EpisodeMotion
from shake_env.scenario.limits import OBSERVATION_BOUND
from shake_env.simulation.engine import (
    BoolArray,
    Episode,
    LaneState,
    Observations,
    StepResult,
    Tables,
)
from shake_env.simulation.excitation import Excitation
from shake_env.simulation.sensors import SensorMemory
from shake_env.simulation.transition import Outcome


class ReferenceEngine:
    """N tables, stepped by `Excitation` and `TableModel`; see `engine.Engine`."""

    def __init__(self, tables: Tables) -> None:
        self._tables, self._model = tables, tables.model
        self._excitation = Excitation(
            tables.scenario.discrete, tables.lanes, tables.maps, tables.preview
        )
        self.number = 0
        counters = np.zeros((2, tables.lanes), dtype=np.int64)
        self.step_count, self.episode_steps = counters
        self.severity = np.ones(tables.lanes)
        self.state: FloatArray = np.zeros((tables.lanes, tables.model.dynamics.states))
        self.memory = tables.model.measurement.rest(tables.lanes)
        self._outcome: Outcome | None = None

    @property
    def motions(self) -> list[EpisodeMotion]:
        """Motion of each table's episode."""
        return self._excitation.motions

    def start(self, lanes: Sequence[int], episodes: Sequence[Episode]) -> Observations:
        """Put tables to rest at the beginning of their episodes; return their observations."""
        self.number += 1
        index = np.asarray(lanes, dtype=int)
        self.step_count[index] = 0
        self.episode_steps[index] = [each.steps for each in episodes]
        self.severity[index] = [each.severity for each in episodes]
        self.state = np.where(np.isin(np.arange(len(self.state)), index)[:, None], 0.0, self.state)
        n = 3 * self._tables.scenario.specimen.stories
        for lane, each in zip(lanes, episodes, strict=True):
            if each.specimen is not None:
                self.state[lane, 4 : 4 + n] = each.specimen[0]
        motions, keys = [each.motion for each in episodes], [each.key for each in episodes]
        references = [None if e.specimen is None else e.specimen[1] for e in episodes]
        ground = self._excitation.start(lanes, motions, keys, references)
        model, memory = self._model, self._model.measurement.rest(len(lanes))
        if self._tables.scenario.sensing.full_state:
            head = model.full_state(self.state[index], ground)
            shown = model.measurement.observation(head, None, ground.preview, memory)
        else:
            measurement, count = model.measurement, len(model.measurement.rms)
            keys_now, zero = np.stack(keys), np.zeros(len(keys), dtype=np.int64)
            bias, gain = (normals(keys_now, zero, block, count) for block in (OFFSETS, GAINS))
            memory = replace(memory, bias=measurement.offset * bias, gain=measurement.gain_error * gain)
            noise = self._noise()[index]
            readings, memory = measurement.read(memory, np.zeros_like(noise), noise, memory.action)
            shown, memory = model.show(readings, ground, memory)
        parts = {}
        for field in fields(SensorMemory):
            parts[field.name] = getattr(self.memory, field.name).copy()
            parts[field.name][index] = getattr(memory, field.name)
        self.memory = SensorMemory(**parts)
        return _bounded(shown)

    def _noise(self) -> FloatArray:
        """Return the noise (N, s) of the readings at the end of the present period, SI."""
        rms, excitation = self._model.measurement.rms, self._excitation
        if not len(rms):
            return np.zeros((len(self.state), 0))
        noise: FloatArray = rms * normals(
            excitation.key, excitation.period - excitation.ahead, SENSORS, len(rms)
        )
        return noise

    def step(self, action: NDArray[np.floating[Any]]) -> StepResult:
        """Advance every table by one control period under `action` (N,)."""
        self.number += 1
        action = action.astype(float)  # at the precision of everything else
        ground = self._excitation.advance()
        outcome = self._model.transition(self.state, action, ground)
        self.state, self._outcome = outcome.response.state, outcome
        self.step_count += 1
        left = self.episode_steps - self.step_count
        terminated = outcome.broken != 0
        truncated = (left <= 0) & ~terminated
        remaining = np.minimum(np.maximum(left, 1), self._tables.limit_steps)
        price = np.where(terminated, self._tables.limit_rate * self.severity * remaining, 0.0)
        shown, self.memory = self._model.observe(outcome, ground, action, self.memory, self._noise())
        response, state = outcome.response, outcome.response.state
        report = np.stack(
            [
                response.table_acceleration[:, -1],
                ground.target[:, -1],
                response.base_shear[:, -1],
                ground.reference_shear[:, -1],
                outcome.current,
                state[:, 1],
                state[:, 2],
                state[:, 0],
                outcome.cost.acceleration,
                outcome.cost.force,
                outcome.cost.current,
                price,
                outcome.soft_cost,
                -(outcome.cost.total + outcome.soft_cost + price),
                outcome.broken,
            ]
        )
        ended = TERMINATED * bool(terminated.any()) | TRUNCATED * bool(truncated.any())
        return StepResult(self, _bounded(shown), report, terminated, truncated, ended)

    def step_alone(self, action: float) -> tuple[Observations, list[float], int]:
        """Advance the one table; return its observation (n,), report and `StepResult.ended`."""
        result = self.step(np.array([action]))
        return result.observation[0], result.report[:, 0].tolist(), result.ended

    def advance_ground(self) -> tuple[GroundPeriod, FloatArray]:
        """Advance the ground alone; return it, and the noise (N, s) of the readings, SI."""
        self.number += 1
        return self._excitation.advance(), self._noise()

    def outcome(self, report: FloatArray) -> Outcome:
        """Return what the present period brought."""
        assert self._outcome is not None  # a step came before
        return self._outcome

    def ground(self, *, preview: bool = True) -> GroundPeriod:
        """Return the ground of the present period."""
        ground = self._excitation.present()
        return ground if preview else replace(ground, preview=None)

    def rest(self, lanes: BoolArray) -> None:
        """Put the state of some tables (N,) of bool to rest, in the middle of their episodes."""
        self.state = np.where(lanes[:, None], 0.0, self.state)

    def redrawn(self, lanes: Sequence[int]) -> None:
        """Do nothing: the model is read anew in every period."""

    def get_state(self) -> LaneState:
        """Return everything that `set_state` needs to go on exactly; see `engine.Engine`."""
        return {
            **self._excitation.get_state(),
            "state": self.state.copy(),
            **self.memory.arrays(),
            "step_count": self.step_count.copy(),
            "episode_steps": self.episode_steps.copy(),
            "severity": self.severity.copy(),
        }

    def set_state(self, state: LaneState) -> None:
        """Go on from the state of as many tables of the same scenario."""
        self.number += 1
        self._excitation.set_state(state)
        self.state, self.memory = state["state"].copy(), SensorMemory.from_state(state)
        for name in ("step_count", "episode_steps", "severity"):
            getattr(self, name)[...] = state[name]


def _bounded(scaled: FloatArray) -> Observations:
    # Only the drifting position, or a table that has just diverged, comes near the bound.
    bounded = np.nan_to_num(np.clip(scaled, -OBSERVATION_BOUND, OBSERVATION_BOUND))
    return bounded.astype(np.float32)
