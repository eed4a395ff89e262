"""Exported C beside Python: every controller that has a C form, in every named scenario.

    python -m benchmarks.exported_accuracy docs/results/exported.json

Ten earthquakes and random observations each, in both precisions; sanitizers (gcc and clang) and valgrind
where they are installed. Each finished case is kept in the file, and a later call goes on from there.
With `--costs` it only compares the costs again of those cases that had fewer earthquakes than now.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from agents.deployment.accuracy import (
    EARTHQUAKES,
    Agreement,
    agreement,
    compared_costs,
    compared_earthquakes,
)
from agents.deployment.controller_program import controller_program
from agents.deployment.exported import exported
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


def renew_costs(rows: list[dict[str, Any]], file: Path) -> None:
    """Compare costs on all ten earthquakes where fewer were compared; write after each case."""
    for row in rows:
        if row["costs"] < EARTHQUAKES:
            scenario = make_scenario(row["scenario"])
            name, *around = row["controller"].split(" + ")
            program, controller = controller_program(name, scenario, supervised=bool(around))
            quakes = compared_earthquakes(scenario, EARTHQUAKES)
            row |= compared_costs(program, controller, scenario, quakes)
            row["good"] = Agreement(**{key: value for key, value in row.items() if key != "good"}).good
            print(row["scenario"], row["controller"], row["cost"], row["good"], flush=True)
            write_text(file, json.dumps({"rows": rows}, indent=1) + "\n")


def main() -> None:
    """Compare, and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--scenarios", nargs="*", default=SCENARIO_NAMES, choices=SCENARIO_NAMES)
    parser.add_argument("--costs", action="store_true", help="of finished cases, compare costs again")
    arguments = parser.parse_args()
    file = arguments.file
    rows = json.loads(file.read_text(encoding="utf-8"))["rows"] if file.exists() else []
    if arguments.costs:
        renew_costs(rows, file)
        return
    done = {(row["scenario"], row["controller"]) for row in rows}
    for scenario_name, name, supervised in cases():
        title = name + (" + supervisor" if supervised else "")
        if scenario_name not in arguments.scenarios or (scenario_name, title) in done:
            continue
        scenario = make_scenario(scenario_name)
        try:
            controller_program(name, scenario, supervised=supervised)
        except ShakeError:  # no controller of this name drives this table, or none with a C form
            continue
        result = agreement(name, scenario, supervised=supervised)
        rows.append(asdict(result) | {"good": result.good})
        print(result, "good" if result.good else "NOT GOOD", flush=True)
        write_text(file, json.dumps({"rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
