"""How long one decision takes: exported C beside numpy, estimator and supervisor included.

    python -m benchmarks.exported                 a table of the cases below, as Markdown
    python -m benchmarks.exported --json FILE     the numbers as well

Of C the median and the worst of 100 000 steps, timed one by one on recorded inputs: by the clock, and in
processor time, which leaves out when other programs ran. Of numpy the median processor time of 200
decisions.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

from agents.deployment.compiled import step_times
from agents.deployment.export import export_c
from agents.evaluation.latency import decision_time
from agents.policies.registry import get_controller
from shake_env import Supervised, make_scenario

CASES = (
    ("linear", "lqr", False),
    ("linear", "ppo", False),
    ("laboratory", "pid", False),
    ("laboratory", "tvc-dob", False),
    ("laboratory", "mcs", False),
    ("laboratory", "inverse-ff", False),
    ("laboratory", "lqg", False),
    ("laboratory", "apg", False),
    ("laboratory", "ppo", False),
    ("laboratory", "dagger", False),
    ("unknown-specimen", "apg", False),
    ("unknown-specimen", "adaptive", False),
    ("laboratory", "lqg", True),
)  # scenario, controller, supervisor; laboratory's apg is 64 x 64 behind the estimator


def measure(scenario_name: str, name: str, supervised: bool) -> dict[str, object]:
    """Return the times of one case [us]."""
    scenario = make_scenario(scenario_name)
    result: dict[str, object] = {
        "scenario": scenario_name,
        "controller": name + (" + supervisor" if supervised else ""),
    }
    for precision in ("float64", "float32"):
        with tempfile.TemporaryDirectory() as folder:
            program, _ = export_c(
                name, scenario, Path(folder), supervised=supervised, precision=precision
            )
            times = step_times(Path(folder), program.name)
        for key in ("median_us", "worst_us", "worst_processor_us"):
            result[f"{precision} {key}"] = times[key]
    controller = get_controller(name, scenario)
    if supervised:
        controller = Supervised(controller, scenario)
    result["numpy median_us"] = 1e6 * decision_time(controller, scenario)
    return result


def table(rows: list[dict[str, object]]) -> str:
    """Return the cases as a Markdown table."""
    columns = (
        "float64 median_us", "float64 worst_processor_us", "float64 worst_us", "float32 median_us",
        "float32 worst_processor_us", "numpy median_us",
    )  # fmt: skip
    heads = (
        "C double, median", "worst, processor", "worst, clock", "C float, median", "worst, processor",
        "numpy, median",
    )  # fmt: skip
    lines = [
        f"| scenario | controller | {' | '.join(f'{head} [us]' for head in heads)} |",
        f"|---|---|{'---|' * len(heads)}",
    ]
    for row in rows:
        numbers = " | ".join(f"{row[column]:.1f}" for column in columns)
        lines.append(f"| {row['scenario']} | {row['controller']} | {numbers} |")
    return "\n".join(lines)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    rows = [measure(*case) for case in CASES]
    print(table(rows))
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
