"""Tests of a controller in Python, recorded: what an exported program is compared with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.controller import Controller, decide
from shake_env.rollout import Earthquake
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.simulation import Simulation


@dataclass(frozen=True)
class RecordedDecisions:
    """Decisions of a controller on earthquakes side by side."""

    fresh: NDArray[np.bool_]  # (periods, tables) whether a test begins
    observations: NDArray[np.float32]  # (periods, tables, n)
    actions: NDArray[np.float32]  # (periods, tables)


def record_decisions(
    controller: Controller,
    scenario: Scenario,
    earthquakes: Sequence[Earthquake],
    periods: int | None = None,
) -> RecordedDecisions:
    """Drive tables with a controller, one for each earthquake, and record its decisions.

    Parameters
    ----------
    controller, scenario, earthquakes
        As for `shake_env.rollout.rollout`.
    periods
        At most as many; None: the whole motion.
    """
    tables = len(earthquakes)
    simulation = Simulation(scenario, tables)
    streams = [np.random.default_rng(quake.seed) for quake in earthquakes]
    observation = simulation.start(range(tables), streams, [quake.motion for quake in earthquakes])
    steps = int(simulation.episode_steps.max())
    memory: tuple[Any, ...] | None = None
    fresh, running = np.ones(tables, dtype=bool), np.ones(tables, dtype=bool)
    rows: list[tuple[Any, Any, Any]] = []
    for _ in range(steps if periods is None else min(steps, periods)):
        action, memory = decide(controller, observation, memory, fresh)
        rows.append((fresh, observation, action[:, 0]))
        result = simulation.step(np.where(running, action[:, 0], 0.0).astype(float))
        running = running & ~(result.terminated | result.truncated)
        simulation.rest(~running)
        fresh, observation = ~running, result.observation
    return RecordedDecisions(*(np.stack(column) for column in zip(*rows, strict=True)))
