"""Processor time of one decision."""

from __future__ import annotations

import time

import numpy as np

from shake_env.controller import Controller, decide
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.simulation import Simulation


def decision_time(controller: Controller, scenario: Scenario, decisions: int = 200) -> float:
    """Return the median processor time [s] of one decision for one table, in its episode.

    Processor time, so that other work on the machine is not counted as the controller's.
    """
    simulation = Simulation(scenario, 1)
    observation = simulation.start([0], [np.random.default_rng(0)])
    memory, start, times = None, np.ones(1, dtype=bool), []
    for _ in range(min(decisions, int(simulation.episode_steps[0]))):
        began = time.process_time()
        action, memory = decide(controller, observation[0], memory, start)
        times.append(time.process_time() - began)
        start = np.zeros(1, dtype=bool)
        observation = simulation.step(np.asarray(action, dtype=float)).observation
    return float(np.median(times))
