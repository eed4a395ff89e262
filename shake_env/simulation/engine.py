"""What steps N tables: the protocol of both engines, and what a step gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from shake_env.dynamics.ground import GroundMaps, GroundPeriod
from shake_env.errors import ScenarioError
from shake_env.kernels.layout import BROKEN, LIMIT_COST, REWARD
from shake_env.model.parameters import FloatArray
from shake_env.motion.targets import EpisodeMotion
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.sensors import SensorMemory
from shake_env.simulation.transition import Outcome, TableModel

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
LaneState = dict[str, NDArray[Any]]  # what tables go on from, arrays with a row a table
Observations = NDArray[np.float32]


@dataclass(frozen=True)
class Tables:
    """What an engine is made of."""

    scenario: Scenario
    model: TableModel  # in numpy; with drawn plants its matrices one a lane
    maps: GroundMaps  # likewise
    lanes: int  # number of tables N
    preview: tuple[int, int]  # target samples shown ahead, and the physics steps between them
    limit_rate: float  # what a broken limit costs a control period that remains
    limit_steps: float  # the most periods that count; infinite for all
    threads: int = 1  # of the compiled engine


@dataclass(frozen=True)
class Episode:
    """What is fixed when a table begins an episode."""

    key: IntArray  # (2,) of its random numbers
    motion: EpisodeMotion
    steps: int  # control periods
    severity: float  # motionless cost of the motion over the unit target's
    # [x_r, x_r', s] of specimen and reference (2, 3 stories) at the start; None: as new
    specimen: FloatArray | None = None


class StepResult:
    """One control period of N tables. The arrays are the caller's: no later step changes them."""

    def __init__(
        self,
        engine: Engine,
        observation: Observations,
        report: FloatArray,
        terminated: BoolArray,
        truncated: BoolArray,
        ended: int,
    ) -> None:
        self.observation = observation  # (N, n) what the sensing shows after the period
        self.report = report  # (15, N) in SI: rows of `layout.REPORT`
        self.terminated = terminated  # (N,) a limit was broken
        self.truncated = truncated  # (N,) the motion ended, and no limit was broken
        self.ended = ended  # bits of TERMINATED and TRUNCATED, where any table's episode ended
        self._engine, self._number = engine, engine.number

    @property
    def reward(self) -> FloatArray:
        """Minus stage cost, minus the cost of a broken limit (N,)."""
        reward: FloatArray = self.report[REWARD]
        return reward

    @property
    def broken(self) -> FloatArray:
        """0, or 1 + index in limits.REASONS of the limit that was broken (N,)."""
        broken: FloatArray = self.report[BROKEN]
        return broken

    @property
    def limit_cost(self) -> FloatArray:
        """What a broken limit cost (N,)."""
        cost: FloatArray = self.report[LIMIT_COST]
        return cost

    @cached_property
    def outcome(self) -> Outcome:
        """What the period brought; to be asked for before the next step."""
        self._require_present()
        return self._engine.outcome(self.report)

    @cached_property
    def ground(self) -> GroundPeriod:
        """The ground, without a preview; to be asked for before the next step."""
        self._require_present()
        return self._engine.ground(preview=False)

    def _require_present(self) -> None:
        if self._engine.number != self._number:
            raise ScenarioError("result", "of an earlier period", "ask for it before the next step")


class Engine(Protocol):
    """N tables in their episodes.

    Arrays that are returned are copies, but for `step_count` and `episode_steps`.
    """

    number: int  # of the present period, which `step`, `start` and what sets the tables change
    step_count: IntArray  # (N,) control periods since each table's start, a view
    episode_steps: IntArray  # (N,) control periods in each table's episode, a view

    def start(self, lanes: Sequence[int], episodes: Sequence[Episode]) -> Observations:
        """Put tables to rest at the beginning of their episodes; return their observations."""

    def step(self, action: NDArray[np.floating[Any]]) -> StepResult:
        """Advance every table by one control period under `action` (N,)."""

    def step_alone(self, action: float) -> tuple[Observations, list[float], int]:
        """Advance the one table; return its observation (n,), report and `StepResult.ended`."""

    def advance_ground(self) -> tuple[GroundPeriod, FloatArray]:
        """Advance the ground alone; return it, and the noise (N, s) of the readings, SI."""

    def outcome(self, report: FloatArray) -> Outcome:
        """Return what the present period brought."""

    def ground(self, *, preview: bool = True) -> GroundPeriod:
        """Return the ground of the present period, with what a preview shows if that is asked for."""

    @property
    def state(self) -> FloatArray:
        """State of the tables (N, states), SI, [x_A, x_S] first."""

    @state.setter
    def state(self, state: FloatArray) -> None: ...

    @property
    def memory(self) -> SensorMemory:
        """What the sensors remember."""

    @memory.setter
    def memory(self, memory: SensorMemory) -> None: ...

    @property
    def severity(self) -> FloatArray:
        """Motionless cost of each table's motion over the unit target's (N,)."""

    @property
    def motions(self) -> list[EpisodeMotion]:
        """Motion of each table's episode."""

    def rest(self, lanes: BoolArray) -> None:
        """Put the state of some tables (N,) of bool to rest, in the middle of their episodes."""

    def redrawn(self, lanes: Sequence[int]) -> None:
        """Take the plants of some lanes from the model's stacks, which have changed."""

    def get_state(self) -> LaneState:
        """Return everything that `set_state` needs to go on exactly; both engines' are alike.

        Arrays with a row a table; ``motion`` is an array of objects.
        """

    def set_state(self, state: LaneState) -> None:
        """Go on from the state of as many tables of the same scenario."""
