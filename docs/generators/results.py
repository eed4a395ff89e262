"""Tables of results for README and pages, from the files in docs/results."""

from __future__ import annotations

import json
from typing import Any

from agents.reporting.evaluation_tables import cost_interval, interval_text
from agents.studies.adaptation.result import adaptation_table
from generators import DOCS
from generators.markdown import table
from shake_env import SCENARIO_NAMES
from shake_env.scenario.tables import TABLE_NAMES

HEADLINE = ("lqg-searched", "nmpc", "ppo", "apg", "dagger", "dagger-apg")  # in the README
PLANNED_SCENARIOS = ("laboratory", "yielding", "unknown-specimen", "field", "records")
PLANNERS = ("nmpc", "nmpc-adaptive", "planned")


def headline() -> str:
    """Return the README's two tables of results, costs and base-shear errors, from the result files.

    Costs are over the true bound; over the reference's where a result was made without one.
    """
    costs, errors = [], []
    for name in SCENARIO_NAMES:
        file = DOCS / "results" / f"evaluation_{name}.json"
        if not file.exists():  # not evaluated yet
            continue
        result = json.loads(file.read_text(encoding="utf-8"))
        entries = {row["controller"]: row for row in result["rows"]}
        reference = result["reference"]
        bounded = result["normaliser"] == "bound"
        figure, normaliser = ("relative_cost", "bound") if bounded else ("reference_cost", reference)
        costs.append((
            f"`{name}`",
            normaliser,
            f"`{reference}` {cost_interval(entries[reference][figure])}",
            *(cost_interval(entries[each][figure]) if each in entries else "-" for each in HEADLINE),
        ))  # fmt: skip
        errors.append(
            (
                f"`{name}`",
                *(
                    shear_error(entries[each]) if each in entries else "-"
                    for each in (reference, *HEADLINE)
                ),
            )
        )
    columns = [f"`{name}`" for name in HEADLINE]
    return "\n".join([
        table(("cost", "over", "reference", *columns), costs),
        table(("base-shear error [% rms]", "reference", *columns), errors),
    ])  # fmt: skip


def shear_error(row: dict[str, Any]) -> str:
    """Return a row's base-shear error in percent and, where there are any, its failed tests."""
    failed = f", {row['failures']} of {row['episodes']} failed" if row["failures"] else ""
    return interval_text(row["base_shear_rms_error"], 1, 100.0) + failed


def compared_tables() -> str | None:
    """Return the comparison of every named table from ``results/table_NAME.json``; None: not all there.

    Each is what ``shake compare --table NAME ... --json`` printed.
    """
    files = {name: DOCS / "results" / f"table_{name}.json" for name in TABLE_NAMES}
    if not all(file.exists() for file in files.values()):
        return None
    rows = []
    for name, file in files.items():
        result = json.loads(file.read_text(encoding="utf-8"))
        for row in result["summaries"]:
            rows.append((
                name,
                f"`{row['controller']}`",
                row["information"],
                f"{row['relative_cost']:.3g}",
                *(
                    f"{float(f'{100 * row[error]:.2g}'):g}"
                    for error in ("acceleration_rms_error", "base_shear_rms_error")
                ),
                str(row["broken_limits"]),
            ))  # fmt: skip
    head = (
        "table", "controller", "information", "cost / lqg", "acceleration error [%]",
        "base-shear error [%]", "ended by a limit",
    )  # fmt: skip
    return table(head, rows)


def planning_figures() -> str | None:
    """Return the planners' costs over the bound from the evaluation's results; None: without bounds."""
    rows = []
    for name in PLANNED_SCENARIOS:
        file = DOCS / "results" / f"evaluation_{name}.json"
        result = json.loads(file.read_text(encoding="utf-8"))
        if not result.get("bound", {}).get("costs"):
            return None
        entries = {row["controller"]: row for row in result["rows"]}
        bounds = result["bound"]["costs"]
        lost = ", ".join(
            f"`{each}` {entries[each]['failures']} of {entries[each]['episodes']}"
            for each in PLANNERS
            if each in entries and entries[each]["failures"]
        )
        rows.append((
            f"`{name}`",
            f"{sum(bounds) / len(bounds):.4g} ({len(bounds)})",
            f"`{result['reference']}` {cost_interval(entries[result['reference']]['relative_cost'])}",
            *(cost_interval(entries[p]["relative_cost"]) if p in entries else "-" for p in PLANNERS),
            lost or "none",
        ))  # fmt: skip
    head = (
        "cost / bound", "bound (earthquakes)", "reference", *(f"`{p}`" for p in PLANNERS), "failed",
    )  # fmt: skip
    return table(head, rows)


def sb3_guide() -> str:
    """Return the table of the guide's runs, a row for each setting, with the costs of its seeds."""
    runs = json.loads((DOCS / "results" / "sb3_guide.json").read_text(encoding="utf-8"))
    rows = []
    for variant in dict.fromkeys(run["variant"] for run in runs):
        of_it = [run for run in runs if run["variant"] == variant]
        costs = ", ".join(f"{run['ratio']:.3g}" for run in of_it)
        seconds = ", ".join(f"{run['seconds']:.0f}" for run in of_it)
        steps = f"{of_it[0]['steps']:,}".replace(",", " ")
        rows.append((variant, steps, costs, seconds))
    return table(("setting", "steps", "cost / LQR's cost, one seed each", "processor time [s]"), rows)


def gradient_noise() -> str:
    """Return the table of the estimators of a gradient beside the exact one."""
    result = json.loads((DOCS / "results" / "gradient_noise.json").read_text(encoding="utf-8"))
    rows = [
        (
            each["estimator"],
            f"{100.0 * each['action_share']:.2g} %",
            f"{each['cosine']:.2f}",
            f"{each['along']:.2f} +- {each['along_error']:.2f}",
            f"{each['samples']:,}".replace(",", " "),
        )
        for each in result["estimators"]
    ]
    heading = ("advantage", "share of one action", "cosine", "of the exact gradient", "samples for 1")
    return table(heading, rows)


def adaptation() -> str:
    """Return the costs within an episode over those of the controller that is told the plant."""
    files = [DOCS / "results" / f"adaptation_{name}.json" for name in ("field", "unknown-specimen")]
    return "\n".join(adaptation_table(json.loads(file.read_text(encoding="utf-8"))) for file in files)


def execution_figures() -> str:
    """Return what engines add to a unit, from ``results/execution.json``."""
    result = json.loads((DOCS / "results" / "execution.json").read_text(encoding="utf-8"))
    rows = [
        (
            f"`{row['engine']}`",
            f"{row['wall_s']:.2f}",
            f"{row['overhead_ms_a_unit']:.1f}",
            f"{row['start_s']:.1f}",
            f"{other['wall_s']:.0f}",
        )
        for row, other in zip(result["overhead"], result["campaign"], strict=True)
    ]
    head = (
        "engine", "1000 units of 10 ms [s] (5.0 without loss)", "overhead a unit [ms]", "start [s]",
        "campaign of 12 short runs [s]",
    )  # fmt: skip
    return table(head, rows)
