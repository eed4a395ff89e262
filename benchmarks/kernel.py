"""Table-steps a second of the nonlinear update, compiled and not, and the cost of drawing a plant.

``OMP_NUM_THREADS=1 python -m benchmarks.kernel [--json]``. What is compared runs in turns, a short spell
each, and medians over the spells are reported: on a shared machine two numbers are only comparable if
they met the same neighbours.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from shake_env import Scenario, make_scenario, nonlinear_dynamics
from shake_env.fleet import Fleet
from shake_env.nonlinear_dynamics import ARRAYS, NonlinearDynamics
from shake_env.nonlinearity import Friction, Nonlinearity, ServoValve, StrokeStops
from shake_env.transition import dynamics_of
from shake_env.uncertainty import Uncertainty, Uniform

PARTS = Nonlinearity(
    friction=Friction(coulomb=150.0),
    valve=ServoValve(supply_pressure=21e6, spool_limit=1.25e-5),
    stops=StrokeStops(gap=0.076),
)
SPREAD = Uncertainty(mass_ratio=Uniform(0.1, 1.0), storey_frequency=Uniform(5.0, 9.0))
SPELL, SPELLS = 0.05, 9  # [s] of each spell, and how many


def scenario() -> Scenario:
    return make_scenario("linear", {"nonlinearity": PARTS, "delay": 2})


def own_matrices(dynamics: NonlinearDynamics, lanes: int) -> NonlinearDynamics:
    stacks = {name: np.repeat(np.asarray(getattr(dynamics, name))[None], lanes, 0) for name in ARRAYS}
    return replace(dynamics, **stacks)


def stepper(dynamics: NonlinearDynamics, lanes: int, compiled: bool) -> Callable[[], None]:
    rng = np.random.default_rng(0)
    currents = rng.normal(0.0, 0.02, (50, lanes))
    state = np.zeros((lanes, dynamics.states))
    for current in currents:
        state = dynamics.control_step(state, current).state

    def step() -> None:
        nonlinear_dynamics.COMPILED = compiled
        dynamics.control_step(state, currents[0])
        nonlinear_dynamics.COMPILED = True

    return step


def medians(work: dict[str, Callable[[], None]]) -> dict[str, float]:
    """Return the median seconds a call of each, run in turns."""
    calls = {}
    for name, call in work.items():
        call()
        begin = time.perf_counter()
        call()
        calls[name] = max(1, round(SPELL / (time.perf_counter() - begin)))
    taken: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(SPELLS):
        for name, call in work.items():
            begin = time.perf_counter()
            for _ in range(calls[name]):
                call()
            taken[name].append((time.perf_counter() - begin) / calls[name])
    return {name: statistics.median(times) for name, times in taken.items()}


def measure() -> dict[str, dict[str, float]]:
    """Return table-steps a second by batch, and plants a second."""
    dynamics = dynamics_of(scenario())
    found = {}
    for lanes in (1, 64, 1024):
        work = {
            f"{plants}, {path}": stepper(model, lanes, path == "compiled")
            for plants, model in (("common", dynamics), ("own", own_matrices(dynamics, lanes)))
            for path in ("reference", "compiled")
        }
        found[f"{lanes} tables"] = {name: lanes / each for name, each in medians(work).items()}
    uncertain = replace(scenario(), uncertainty=SPREAD)
    draws = {}
    for lanes in (1, 64, 1024):
        fleet = Fleet(uncertain, lanes)
        streams = [np.random.default_rng(lane) for lane in range(lanes)]
        draws[f"drawn {lanes} at once"] = lambda f=fleet, s=streams: f.draw(range(len(s)), s)
    sizes = {name: int(name.split()[1]) for name in draws}
    found["plants"] = {name: sizes[name] / each for name, each in medians(draws).items()}
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print the numbers alone")
    asked = parser.parse_args()
    found = measure()
    if asked.json:
        print(json.dumps(found))
        return
    for what, rates in found.items():
        slowest = min(rates.values())
        print(what)
        for name, rate in rates.items():
            print(f"  {name:22s} {rate:12,.0f} a second  {rate / slowest:6.1f} times the slowest")


if __name__ == "__main__":
    main()
