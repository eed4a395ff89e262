"""How long one decision takes: exported C beside numpy, estimator and supervisor included.

    python -m benchmarks.exported                 a table of the cases, as Markdown
    python -m benchmarks.exported --json FILE     the numbers as well
    python -m benchmarks.exported --steps 1000    fewer steps, to try it

Cases: every export of the laboratory scenario, every shipped policy, every other controller with a form
in C in the first named scenario that it suits, and the supervisor around `lqg`. Of C and of numpy, one
after the other, median and worst of 100 000 steps, timed one by one on recorded inputs: by the clock,
and in processor time, which leaves out when other programs ran. Numpy's times include Python's garbage
collection, as a controller in Python has it.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from agents.deployment.compiled import step_times
from agents.deployment.controller_program import controller_program
from agents.deployment.export import RECORDED, export_c
from agents.deployment.exported import exported
from agents.deployment.recorded import record_decisions
from agents.policies.policy_file import PolicyFile
from agents.policies.registry import get_controller, policies_trained_for
from shake_env import Supervised, make_scenario
from shake_env.controller import Controller, decide
from shake_env.errors import ShakeError
from shake_env.rollout import noise_earthquakes
from shake_env.scenario.presets import NAMED
from shake_env.scenario.scenario import Scenario

STEPS = 100_000
SUPERVISED = ("laboratory", "lqg")  # the supervisor's time is added to the controller's
# Their policies are the laboratory's.
SAME_POLICIES = ("records",)
Case = tuple[str, str, bool]  # scenario, controller, supervisor


def cases() -> list[Case]:
    """Return what is timed; see the module."""
    made = [("laboratory", name) for name in exported() if has_program(name, "laboratory")]
    for scenario in NAMED:
        if scenario not in SAME_POLICIES:
            made += [(scenario, name) for name in policies_trained_for(scenario)]
    for name in exported():
        if all(name != known for _, known in made):
            suited = (scenario for scenario in NAMED if has_program(name, scenario))
            made += [(scenario, name) for scenario in islice(suited, 1)]
    made = sorted(dict.fromkeys(made), key=lambda case: list(NAMED).index(case[0]))
    return [*((*case, False) for case in made), (*SUPERVISED, True)]


def has_program(name: str, scenario_name: str) -> bool:
    """Return whether a controller suits a scenario and has a form in C there."""
    try:
        controller_program(name, make_scenario(scenario_name))
    except ShakeError:
        return False
    return True


def network(controller: Controller) -> str | None:
    """Return what a policy is, such as ``64 x 64 behind the estimator``; None: no policy."""
    if not isinstance(controller, PolicyFile):
        return None
    parts = [" x ".join(str(len(weight)) for weight in controller.weights[:-1])]
    if controller.memory is not None:
        parts.append(f"and {controller.memory.kind.upper()} of {controller.memory.units}")
    if controller.law is not None:
        parts.append("behind the estimator")
    return " ".join(parts)


def numpy_times(controller: Controller, scenario: Scenario, steps: int) -> dict[str, float]:
    """Return median and worst [us] of steps of a controller in Python, on the inputs that C has."""
    decisions = record_decisions(controller, scenario, noise_earthquakes(scenario, 1), RECORDED)
    shown = decisions.observations[:, 0]
    memory, start = None, np.ones(1, dtype=bool)
    by_clock, by_processor = np.empty(steps), np.empty(steps)
    for k in range(steps):
        observation = shown[k % len(shown)]
        used, began = time.process_time(), time.perf_counter()
        _, memory = decide(controller, observation, memory, start)
        by_clock[k] = time.perf_counter() - began
        by_processor[k] = time.process_time() - used
        start = np.zeros(1, dtype=bool)
    return {
        "median_us": 1e6 * float(np.median(by_clock)),
        "worst_us": 1e6 * float(by_clock.max()),
        "worst_processor_us": 1e6 * float(by_processor.max()),
    }


def measure(scenario_name: str, name: str, supervised: bool, steps: int = STEPS) -> dict[str, Any]:
    """Return the times of one case [us]."""
    scenario = make_scenario(scenario_name)
    controller = get_controller(name, scenario)
    result: dict[str, Any] = {
        "scenario": scenario_name,
        "controller": name + (" + supervisor" if supervised else ""),
        "network": network(controller),
        "steps": steps,
    }
    if supervised:
        controller = Supervised(controller, scenario)
    for precision in ("float64", "float32"):
        with tempfile.TemporaryDirectory() as folder:
            program, _ = export_c(
                name, scenario, Path(folder), supervised=supervised, precision=precision
            )
            times = step_times(Path(folder), program.name, steps)
        for key in ("median_us", "worst_us", "worst_processor_us"):
            result[f"{precision} {key}"] = times[key]
    for key, value in numpy_times(controller, scenario, steps).items():
        result[f"numpy {key}"] = value
    return result


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--only", help="cases whose 'scenario controller' has this text in it")
    arguments = parser.parse_args()
    if not 1 <= arguments.steps <= STEPS:
        parser.error(f"--steps {arguments.steps}: give 1 to {STEPS}")
    rows = []
    for scenario, name, supervised in cases():
        if arguments.only and arguments.only not in f"{scenario} {name}":
            continue
        print(f"{scenario} {name}", "+ supervisor" * supervised, file=sys.stderr, flush=True)
        rows.append(measure(scenario, name, supervised, arguments.steps))
    print(table(rows))
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


def table(rows: list[dict[str, Any]]) -> str:
    """Return the cases as a Markdown table."""
    kinds = ("float64", "float32", "numpy")
    keys = ("median_us", "worst_processor_us", "worst_us")
    heads = [f"{kind} {key.removesuffix('_us').replace('_', ' ')}" for kind in kinds for key in keys]
    lines = [
        f"| scenario | controller | network | {' | '.join(f'{head} [us]' for head in heads)} |",
        f"|---|---|---|{'---|' * len(heads)}",
    ]
    for row in rows:
        numbers = " | ".join(f"{row[f'{kind} {key}']:.1f}" for kind in kinds for key in keys)
        lines.append(f"| {row['scenario']} | {row['controller']} | {row['network'] or ''} | {numbers} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
