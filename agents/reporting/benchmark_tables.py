"""Tables of the classical benchmark, for the documentation."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from agents.evaluation.results import cost_text
from agents.reporting.bound_notes import bound_notes, causal_notes, class_note, marked_class
from agents.reporting.markdown_blocks import markdown_table, put_block


def benchmark_markdown(result: dict[str, Any]) -> str:
    """Return a benchmark's result as a Markdown table."""
    head = (
        "controller", "information", "cost / bound [95 %]", f"cost / {result['reference']} [95 %]",
        "regret closed %", "accel. % rms, peak", "shear % rms, peak", "lag ms",
        "spectrum %", "Arias", "drift", "energy", "ended", "us",
    )  # fmt: skip
    rows, own = [], result["information"]
    for row in result["rows"]:
        costs = [
            "-" if row[name] is None else cost_text(*(row[name + end] for end in ("", "_low", "_high")))
            for name in ("bound_cost", "relative_cost")
        ]
        closed = "-" if row["regret_closed"] is None else f"{100 * row['regret_closed']:.0f}"
        lag = "-" if row["delay"] is None else f"{1e3 * row['delay']:.1f}"
        errors = [
            f"{100 * row[f'{name}_rms_error']:.1f}, {100 * row[f'{name}_peak_error']:.0f}"
            for name in ("acceleration", "base_shear")
        ]
        ratios = [f"{row[f'{name}_ratio']:.2f}" for name in ("arias", "drift", "energy")]
        decision = "-" if row["decision_time"] is None else f"{1e6 * row['decision_time']:.0f}"
        rows.append(
            [row["controller"], marked_class(row["information"], own), *costs, closed, *errors, lag,
             f"{100 * row['spectral_error']:.0f}", *ratios, str(row["broken_limits"]), decision]
        )  # fmt: skip
    number = result["rows"][0]["earthquakes"]
    lines = [markdown_table(head, rows)]
    for row in result["rows"]:
        if row["damage"] is not None:
            lines.append(
                f"`{row['controller']}` takes {row['tests']} tests of each earthquake, the one that "
                f"counts included; before that one the specimen has dissipated {row['damage']:.1f} "
                "times the energy of a perfect test (median)."
            )
    seed = "recorded" if result["seed"] is None else f"seeds from {result['seed']}"
    lines.append(f"{number} earthquakes, {seed}, version {result['version']}, {result['machine']}.")
    if result["bound"] is not None:
        lines += bound_notes(result["bound"], number)
        lines += causal_notes(result["causal_bound"], own, result["rows"], result["bound"])
        lines += class_note([row["information"] for row in result["rows"]], own)
    return "\n".join(lines) + "\n"


def put_tables(page: str | PathLike[str], results: Sequence[dict[str, Any]]) -> None:
    """Put benchmark tables into a page, at ``<!-- bench NAME -->`` (`markdown_blocks.put_block`)."""
    page = Path(page)
    for result in results:
        put_block(
            page, f"bench {result['scenario']}", benchmark_markdown(result), end=result["scenario"]
        )
