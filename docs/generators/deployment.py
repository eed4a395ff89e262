"""Measured figures of exported programs and rehearsals, from the files in docs/results."""

from __future__ import annotations

import json
from typing import Any

from generators import DOCS
from generators.markdown import table

ACCURACY, TIMES, REHEARSALS = "exported.json", "exported_times.json", "rehearsals.json"


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
        "(`python -m benchmarks.exported_accuracy`).\n\n" + table(head, rows)
    )


def times(result: list[dict[str, Any]]) -> str:
    """Return a row for each case of ``python -m benchmarks.exported``."""
    columns = (
        "float64 median_us", "float64 worst_processor_us", "float64 worst_us", "float32 median_us",
        "float32 worst_us", "numpy median_us",
    )  # fmt: skip
    rows = [
        (
            row["scenario"],
            f"`{row['controller']}`",
            *(f"{row[column]:.2g}" if row[column] < 10 else f"{row[column]:.0f}" for column in columns),
        )
        for row in result
    ]
    head = (
        "scenario", "controller", "C double, median [us]", "worst, processor", "worst, clock",
        "C float, median", "worst, clock", "numpy, median",
    )  # fmt: skip
    return (
        "One decision of 100 000 on two cores of a virtual machine without other work "
        "(`python -m benchmarks.exported`).\n\n" + table(head, rows)
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
    return text + table(head, rows)


def _known(number: float | None) -> str:
    return "-" if number is None else f"{number:.0f}"
