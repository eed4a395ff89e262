"""What each mismatch between a table and its model costs each controller, one at a time.

A scenario with an uncertainty is run again with one of its spreads alone, the rest at the nominal
values; then with the errors of its sensors alone; then with everything. Controllers are designed once,
on the nominal table. What they cost on it is the first row.

``python -m agents.studies.mismatch field lqg lqg-dac`` prints the table;
``--output docs/results/mismatch_field.json --page docs/scenarios/field.md`` keeps it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import shake_env
from agents.policies.registry import get_controller
from agents.provenance import machine
from agents.reporting.markdown_blocks import markdown_table, put_block
from agents.seeds import VALIDATION_SEED
from shake_env.errors import ScenarioError
from shake_env.files import write_json
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.scenario.overrides import make_scenario
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uncertainty

NONE, SENSORS, ALL = "none", "sensors", "all"


@dataclass(frozen=True)
class Mismatch:
    """What one mismatch costs."""

    name: str  # `NONE`, a field of `Uncertainty`, `SENSORS` or `ALL`
    costs: dict[str, float]  # mean stage cost of each controller
    lost: dict[str, int]  # tests of each that broke a limit


def mismatched(scenario: Scenario) -> dict[str, Scenario]:
    """Return the scenario with each of its mismatches alone, by name; with none first, all last.

    Raises
    ------
    ScenarioError
        If it draws nothing.
    """
    if not scenario.uncertainty.active:
        raise ScenarioError("uncertainty", scenario.uncertainty, "draws nothing: name field")
    sensors = scenario.sensing.sensors
    exact = None if sensors is None else tuple(replace(s, gain_error=0.0, bias=0.0) for s in sensors)
    known = replace(
        scenario, uncertainty=Uncertainty(), sensing=replace(scenario.sensing, sensors=exact)
    )
    laws = {NONE: known}
    for name, spread in vars(scenario.uncertainty).items():
        if spread is not None:
            laws[name] = replace(known, uncertainty=Uncertainty(**{name: spread}))
    if exact != sensors:
        laws[SENSORS] = replace(known, sensing=scenario.sensing)
    return {**laws, ALL: scenario}


def mismatch_costs(
    scenario: Scenario,
    controllers: Sequence[str],
    earthquakes: int = 8,
    seed: int = VALIDATION_SEED,
    tell: Callable[[str], None] = lambda text: None,
) -> list[Mismatch]:
    """Return what each mismatch costs.

    Parameters
    ----------
    scenario
        With an uncertainty.
    controllers
        Names, as `agents.policies.registry.get_controller` takes them.
    earthquakes, seed
        Number and first seed of the noise earthquakes, the same in every row.
    tell
        Told of each row when it begins.
    """
    quakes = noise_earthquakes(scenario, earthquakes, seed)
    laws = {name: get_controller(name, scenario) for name in controllers}
    rows = []
    for mismatch, run in mismatched(scenario).items():
        tell(mismatch)
        metrics = {name: rollout(law, run, quakes)[0] for name, law in laws.items()}
        rows.append(
            Mismatch(
                mismatch,
                {name: float(np.mean([m.cost for m in each])) for name, each in metrics.items()},
                {name: sum(m.broken_limit is not None for m in each) for name, each in metrics.items()},
            )
        )
    return rows


def mismatch_to_json(
    rows: Sequence[Mismatch], scenario: Scenario, earthquakes: int, seed: int
) -> dict[str, Any]:
    """Return the rows as plain JSON values, with what they depend on."""
    return {
        "scenario": scenario.name,
        "earthquakes": earthquakes,
        "seed": seed,
        "version": shake_env.__version__,
        "machine": machine(),
        "rows": [asdict(row) for row in rows],
    }


def mismatch_table(result: dict[str, Any]) -> str:
    """Return the study of mismatches as a table: cost with none, then each over it; lost tests."""
    nominal, names = result["rows"][0]["costs"], list(result["rows"][0]["costs"])
    rows = []
    for row in result["rows"]:
        cells = [row["name"]]
        for name in names:
            cost, lost = row["costs"][name], row["lost"][name]
            text = f"{cost:.3g}" if row["name"] == NONE else f"{cost / nominal[name]:.2f}"
            cells.append(text + (f" ({lost} lost)" if lost else ""))
        rows.append(cells)
    table = markdown_table(("mismatch", *(f"`{name}`" for name in names)), rows)
    return (
        f"{table}\n{result['earthquakes']} validation earthquakes, seeds from {result['seed']}, version "
        f"{result['version']}, {result['machine']}.\n"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study, write it, print its table."""
    parser = argparse.ArgumentParser(prog="python -m agents.studies.mismatch", description=__doc__)
    parser.add_argument("scenario", help="a named scenario that draws its plant, or a file")
    parser.add_argument("controllers", nargs="+", help="names, or paths of policies")
    parser.add_argument("--earthquakes", type=int, default=8, help="noise earthquakes (default 8)")
    parser.add_argument("--seed", type=int, default=VALIDATION_SEED, help="seed of the first")
    parser.add_argument("--output", type=Path, help="file that the result is written to, as JSON")
    parser.add_argument("--page", type=Path, help="Markdown page with <!-- mismatch --> for the table")
    given = parser.parse_args(arguments)
    scenario = make_scenario(given.scenario)
    rows = mismatch_costs(
        scenario,
        given.controllers,
        given.earthquakes,
        given.seed,
        tell=lambda text: print(text, file=sys.stderr, flush=True),
    )
    result = mismatch_to_json(rows, scenario, given.earthquakes, given.seed)
    if given.output is not None:
        write_json(given.output, result, indent=1)
    if given.page is not None:
        put_block(given.page, "mismatch", mismatch_table(result))
    print(mismatch_table(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
