"""Processor time of one decision."""

from __future__ import annotations

import time

import numpy as np

from shake_env.controller import Controller, decide
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.engine import Observations
from shake_env.simulation.simulation import Simulation

BLOCK = 2e-4  # [s] of processor time at least that is measured at once
TICKS = 20  # of the clock that a block has at least
WHOLE = 0.1  # [s] of processor time at least that is measured in all


def decision_time(controller: Controller, scenario: Scenario, decisions: int = 200) -> float:
    """Return the processor time [s] of one decision for one table, in its episode: median of blocks.

    The episode is run first, and its observations are kept. Then the controller decides on them in
    order, again and again from the episode's start, without the simulation in between. A block is one
    decision or as many as take `BLOCK` and `TICKS` of the clock. Processor time, so that other work on
    the machine is not counted as the controller's.

    Parameters
    ----------
    decisions
        At most so many of the episode, which may end before.

    Returns
    -------
    The median; NaN where there is no decision, or the first observation is not finite.
    """
    shown = _observations(controller, scenario, decisions)
    if not shown:
        return float("nan")
    block = max(BLOCK, TICKS * _tick())
    blocks: list[float] = []
    began = first = time.process_time()
    number = 0
    while len(blocks) < 3 or began - first < WHOLE:
        memory, start = None, np.ones(1, dtype=bool)
        for observation in shown:
            _, memory = decide(controller, observation, memory, start)
            start = np.zeros(1, dtype=bool)
            number += 1
            now = time.process_time()
            if now - began >= block:
                blocks.append((now - began) / number)
                began, number = now, 0
    return float(np.median(blocks))


def _tick() -> float:
    """Return the largest of three successive steps of the clock of processor time [s]."""
    steps = []
    for _ in range(3):
        began = now = time.process_time()
        while now == began:
            now = time.process_time()
        steps.append(now - began)
    return max(steps)


def _observations(controller: Controller, scenario: Scenario, decisions: int) -> list[Observations]:
    """Return what a controller is shown in its episode, until it ends or is not finite."""
    simulation = Simulation(scenario, 1)
    observation = simulation.start([0], [np.random.default_rng(0)])[0]
    memory, start, shown = None, np.ones(1, dtype=bool), []
    for _ in range(min(decisions, int(simulation.episode_steps[0]))):
        if not np.isfinite(observation).all():
            break
        shown.append(np.array(observation))
        action, memory = decide(controller, observation, memory, start)
        start = np.zeros(1, dtype=bool)
        if not np.isfinite(action).all():
            break
        observation = simulation.step(np.asarray(action, dtype=float)).observation[0]
    return shown
