"""Exported C beside Python: every controller that has a C form, in every named scenario.

    python -m benchmarks.exported_accuracy docs/results/exported.json

Ten earthquakes and random observations each, in both precisions; sanitizers (gcc and clang) and valgrind
where they are installed. Each finished case is kept in the file, and a later call goes on from there.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from agents.deployment.accuracy import agreement
from agents.deployment.exported import exported
from agents.policies.registry import get_controller
from shake_env import SCENARIO_NAMES, make_scenario
from shake_env.errors import ShakeError
from shake_env.files import write_text

SUPERVISED = ("laboratory", "unknown-specimen", "yielding", "field", "records")  # lqg, or preview-lqr


def cases() -> list[tuple[str, str, bool]]:
    """Return scenario, controller and whether the supervisor is around it, of every case."""
    made = [(scenario, name, False) for scenario in SCENARIO_NAMES for name in exported()]
    return made + [
        (scenario, "preview-lqr" if scenario == "yielding" else "lqg", True) for scenario in SUPERVISED
    ]


def main() -> None:
    """Compare, and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--scenarios", nargs="*", default=SCENARIO_NAMES, choices=SCENARIO_NAMES)
    arguments = parser.parse_args()
    file = arguments.file
    rows = json.loads(file.read_text(encoding="utf-8"))["rows"] if file.exists() else []
    done = {(row["scenario"], row["controller"]) for row in rows}
    for scenario_name, name, supervised in cases():
        title = name + (" + supervisor" if supervised else "")
        if scenario_name not in arguments.scenarios or (scenario_name, title) in done:
            continue
        scenario = make_scenario(scenario_name)
        try:
            get_controller(name, scenario)
        except ShakeError:  # no controller of this name drives this table
            continue
        result = agreement(name, scenario, supervised=supervised)
        rows.append(asdict(result) | {"good": result.good})
        print(result, "good" if result.good else "NOT GOOD", flush=True)
        write_text(file, json.dumps({"rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
