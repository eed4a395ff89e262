"""Measured figures of exported programs and rehearsals, from the files in docs/results."""

from __future__ import annotations

import json
from typing import Any

from generators import DOCS
from generators.markdown import table

ACCURACY, TIMES, REHEARSALS = "exported.json", "exported_times.json", "rehearsals.json"
GOAL_NETWORK, GOAL_MEDIAN = "64 x 64 behind the estimator", 5.0  # [us]
GOAL_COST = 1e-3  # [-] cost of a test in single precision, difference from Python's


def deployment_figures() -> str:
    """Return the tables of those measurements whose file is there."""
    parts = ((ACCURACY, accuracy), (TIMES, times), (REHEARSALS, rehearsals))
    made = []
    for name, part in parts:
        file = DOCS / "results" / name
        if file.exists():
            made.append(part(json.loads(file.read_text(encoding="utf-8"))))
    return "\n".join(made)


def accuracy(result: dict[str, Any]) -> str:
    """Return a row for each controller: the worst of its scenarios."""
    rows = []
    for name in dict.fromkeys(row["controller"] for row in result["rows"]):
        own = [row for row in result["rows"] if row["controller"] == name]

        def worst(field: str, own: list[dict[str, Any]] = own) -> str:
            value = max(row[field] for row in own)
            return f"{value:.1g}" if value else "0"

        decisions, exceptions = (sum(row[key] for row in own) for key in ("decisions", "exceptions"))
        rows.append((
            f"`{name}`",
            str(len(own)),
            f"{decisions:,}".replace(",", " "),
            worst("largest"),
            str(exceptions),
            worst("single"),
            str(sum(row["costs"] for row in own)),
            worst("cost"),
            worst("nearest"),
            f"{sum(row['random'] for row in own):,}".replace(",", " "),
            worst("random_largest"),
            ", ".join(sorted({each for row in own for each in row["checked"]})),
        ))  # fmt: skip
    head = (
        "controller", "scenarios", "decisions", "double", "of one float32 step", "single",
        "costs", "cost, single",
        "outside of runs that differ in last bits", "random observations", "double", "no finding of",
    )  # fmt: skip
    scenarios = ", ".join(dict.fromkeys(f"`{row['scenario']}`" for row in result["rows"]))
    return (
        "Actions of C and Python, largest difference over the action's range; costs, relative "
        f"difference. Ten earthquakes in each scenario of {scenarios} that the controller suits "
        "(`python -m benchmarks.exported_accuracy`).\n\n" + table(head, rows) + _missed_costs(result)
    )


def _missed_costs(result: dict[str, Any]) -> str:
    """Return in words which rows miss the goal of the cost in single precision."""
    missed = [row for row in result["rows"] if row["cost"] > GOAL_COST]
    outside = [row for row in missed if row["nearest"] > GOAL_COST]
    named = "; ".join(
        f"`{row['controller']}` in `{row['scenario']}`, {100 * row['cost']:.2g} %" for row in outside
    )
    text = (
        f"\nGoal for the cost in single precision: within {GOAL_COST:g} of Python's. **Missed** in "
        f"{len(missed)} of {len(result['rows'])} cases of controller and scenario. In "
        f"{len(missed) - len(outside)} of these the cost lies among those of runs in double precision "
        "that differ in last bits"
    )
    if outside:
        text += f". In {len(outside)} it does not (largest difference): {named}"
    return text + ". [Why](#how-exact-it-is).\n"


def times(result: list[dict[str, Any]]) -> str:
    """Return a row for each case of ``python -m benchmarks.exported``, and whether the goal is met."""
    columns = (
        "float64 median_us", "float64 worst_processor_us", "float64 worst_us", "float32 median_us",
        "float32 worst_us", "numpy median_us", "numpy worst_processor_us", "numpy worst_us",
    )  # fmt: skip
    rows = []
    for row in result:
        mark = "**" if row.get("network") == GOAL_NETWORK else ""
        rows.append((
            row["scenario"],
            f"{mark}`{row['controller']}`{mark}",
            f"{mark}{row.get('network') or '-'}{mark}",
            *(_time(row.get(column)) for column in columns),
        ))  # fmt: skip
    head = (
        "scenario", "controller", "network", "C double, median [us]", "worst, processor", "worst, clock",
        "C float, median", "worst, clock", "numpy, median", "worst, processor", "worst, clock",
    )  # fmt: skip
    steps = min(row.get("steps", 100_000) for row in result)
    text = (
        f"One decision of {_grouped(steps)} on two cores of a virtual machine without other work "
        "(`python -m benchmarks.exported`).\n\n" + table(head, rows)
    )
    marked = [row for row in result if row.get("network") == GOAL_NETWORK]
    if not marked:
        return text
    found = ", ".join(f"`{row['controller']}` {_time(row['float64 median_us'])} us" for row in marked)
    met = all(row["float64 median_us"] <= GOAL_MEDIAN for row in marked)
    return text + (
        f"\nGoal for a network of {GOAL_NETWORK} (bold): a median of at most {GOAL_MEDIAN:g} us in "
        f"double precision. Measured: {found}. The goal is {'met' if met else '**missed**'}.\n"
    )


def rehearsals(result: list[dict[str, Any]]) -> str:
    """Return a row for each rehearsal; times are those of its first test."""
    rows = []
    for each in result:
        first = each["first_test"]
        injected = sum(each["injected"].values())
        rows.append((
            each["title"],
            str(each["tests"]),
            f"{each['periods']:,}".replace(",", " "),
            str(injected),
            str(sum(len(test["faults"]) for test in each["unnoticed"])),
            str(each["deadline_misses_not_injected"]),
            _known(each.get("while_the_machine_stalled")),
            _known((first.get("machine") or {}).get("longest_stall_us")),
            str(each["hard_limits_broken"]),
            *(f"{first[name][key]:.0f}" for name in ("latency", "jitter")
              for key in ("median_us", "p99_us", "worst_us")),
        ))  # fmt: skip
    times = (
        f"{name}, {key}" for name in ("latency", "jitter") for key in ("median [us]", "99 %", "worst")
    )
    head = (
        "rehearsal", "tests", "periods", "faults injected", "unnoticed", "misses not injected",
        "of them in a stall", "longest stall [us]", "limits broken", *times,
    )  # fmt: skip
    text = (
        "Rehearsals of the C program `lqg` in `laboratory`, on a virtual machine that its host stops "
        "now and then.\n\n"
    )
    return text + table(head, rows) + _missed_deadlines(result)


def _missed_deadlines(result: list[dict[str, Any]]) -> str:
    """Return in words which rehearsals miss the goal of no deadline missed, and which broke a limit."""
    missed = [
        f"{each['title']}: {_grouped(each['deadline_misses_not_injected'])} of "
        f"{_grouped(each['periods'])} periods "
        f"({100 * each['deadline_misses_not_injected'] / each['periods']:.2g} %)"
        for each in result
        if each["deadline_misses_not_injected"]
    ]
    broken = [
        f"{each['title']} ({each['first_test']['broken_limit']}, "
        f"after {_grouped(each['periods'])} periods)"
        for each in result
        if each["hard_limits_broken"]
    ]
    words = "**missed**" if missed else "met"
    text = f"\nGoal: no deadline missed but those injected, and no hard limit broken. It is {words}"
    text += f" on this machine: {'; '.join(missed)}.\n" if missed else ".\n"
    if broken:
        text += f"A hard limit was broken: {'; '.join(broken)}. The test ended there.\n"
    return text


def _grouped(number: int) -> str:
    return f"{number:,}".replace(",", " ")


def _time(value: float | None) -> str:
    """Return a time in two digits; a dash where it was not measured."""
    if value is None:
        return "-"
    return f"{value:.2g}" if value < 10 else f"{value:.0f}"


def _known(number: float | None) -> str:
    return "-" if number is None else f"{number:.0f}"
