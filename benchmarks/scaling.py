"""Cost of a step against storeys, tables, physics steps a period and preview, with fitted exponents."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.timing import seconds_each
from shake_env import Sensing, make_scenario
from shake_env.simulation.simulation import Simulation

TABLES = 256


def _simulation(lanes: int, **options: Any) -> Simulation:
    simulation = Simulation(make_scenario("linear", options), lanes)
    simulation.start(range(lanes), [np.random.default_rng(i) for i in range(lanes)])
    return simulation


def scaling(spell: float, spells: int) -> dict[str, dict[str, Any]]:
    """Return seconds a step by each size, and the exponent over the upper half of the sizes."""
    cases: dict[str, dict[int, Simulation]] = {
        "storeys": {n: _simulation(TABLES, stories=n) for n in (1, 2, 5, 10, 20)},
        "tables": {n: _simulation(n, stories=5) for n in (1, 16, 64, 256, 1024, 4096)},
        "physics steps": {k: _simulation(TABLES, physics_step=0.005 / k) for k in (1, 2, 5, 10, 20)},
        "preview": {
            samples: _simulation(TABLES, sensing=Sensing(preview=0.005 * samples))
            for samples in (1, 10, 40, 160)
        },
        "motion [s]": {t: _simulation(TABLES, duration=float(t)) for t in (5, 20, 80, 320)},
    }
    rates = {}
    for name, sizes in cases.items():
        work = {
            str(size): lambda s=simulation: s.step(np.zeros(s.lanes))
            for size, simulation in sizes.items()
        }
        times = seconds_each(work, spell, spells)
        rates[name] = {"seconds": times, "exponent": exponent(times, len(times) - len(times) // 2)}
    return rates


def exponent(costs: Mapping[str, float], largest: int) -> float:
    """Return the power of the size as which costs grow, fitted over so many of the largest sizes."""
    x, y = np.log([float(size) for size in costs]), np.log(list(costs.values()))
    return float(np.polyfit(x[-largest:], y[-largest:], 1)[0])
