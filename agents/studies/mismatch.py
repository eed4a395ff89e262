"""What each mismatch between a table and its model costs each controller, one at a time.

A scenario with an uncertainty is run again with one of its spreads alone, the rest at the nominal
values; then with the errors of its sensors alone; then with everything. Controllers are designed once,
on the nominal table. What they cost on it is the first row.

``python -m agents.studies.mismatch field lqg lqg-dac`` prints the table.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from agents.policies.registry import get_controller
from agents.seeds import VALIDATION_SEED
from shake_env.errors import ScenarioError
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


def markdown(rows: Sequence[Mismatch]) -> str:
    """Return the rows as a table: cost with no mismatch, then each over it, lost tests in brackets."""
    names = list(rows[0].costs)
    lines = [
        f"| mismatch | {' | '.join(f'`{name}`' for name in names)} |",
        "|---" * (len(names) + 1) + "|",
    ]
    for row in rows:
        cells = []
        for name in names:
            first, cost, lost = rows[0].costs[name], row.costs[name], row.lost[name]
            text = f"{cost:.5f}" if row is rows[0] else f"{cost / first:.2f}"
            cells.append(text + (f" ({lost} lost)" if lost else ""))
        lines.append(f"| {row.name} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    name, *laws = sys.argv[1:]
    print(markdown(mismatch_costs(make_scenario(name), laws, tell=lambda t: print(t, file=sys.stderr))))
