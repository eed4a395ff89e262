"""Results of the protocol as JSON files, and as the tables of a Markdown page."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from agents.reporting.bound_notes import bound_notes, causal_notes, class_note, marked_class
from agents.reporting.markdown_blocks import has_place, markdown_table, put_block

COLUMNS = (
    "controller", "information", "runs", "cost / {normaliser}", "IQM", "worst 5 %", "cost / {reference}",
    "P(better than {reference})", "shear % rms", "accel. % rms", "failures", "us",
)  # fmt: skip


def evaluation_markdown(result: dict[str, Any]) -> str:
    """Return the protocol's result as a Markdown table with what is needed to read it."""
    same = result["normaliser"] == result["reference"]
    head = [column.format(**result) for column in COLUMNS]
    names = ["drift_error", "energy_error", "regret_closed", "optimality"]
    shown = [name for name in names if any(row[name] is not None for row in result["rows"])]
    titles = {"regret_closed": "regret closed %", "optimality": "cost / J*"}
    head[9:9] = [titles.get(name, f"{name.removesuffix('_error')} off % (median)") for name in shown]
    if same:
        del head[6]
    supervised = any("supervised" in row for row in result["rows"])
    if supervised:
        head.insert(-1, "supervised: cost, failures, changed %")
    own = result.get("information", "")
    rows = [
        [
            row["controller"],
            marked_class(row.get("information", "-"), own),
            str(row["runs"]) if row["sources"] else "-",
            cost_interval(row["relative_cost"]),
            cost_interval(row["interquartile_mean"]),
            cost_interval(row["worst_twentieth"]),
            *([] if same else [cost_interval(row["reference_cost"])]),
            interval_text(row["probability_of_improvement"], 2),
            interval_text(row["base_shear_rms_error"], 2, 100.0),
            *(interval_text(row[n], 3 if n == "optimality" else 1, _scale(n)) for n in shown),
            interval_text(row["acceleration_rms_error"], 1, 100.0),
            f"{row['failures']} of {row['episodes']}",
            *([_supervised_text(row)] if supervised else []),
            "-" if row["decision_time"] is None else f"{1e6 * row['decision_time']:.0f}",
        ]
        for row in ranked_rows(result)
    ]
    seed = "recorded" if result["seed"] is None else f"seeds from {result['seed']}"
    codes = dict.fromkeys(str(row["code"]) for row in result["rows"])
    machines = dict.fromkeys(str(row["machine"]) for row in result["rows"])
    lines = [
        markdown_table(head, rows),
        f"{len(result['earthquakes'])} earthquakes, {seed}; version {result['version']} "
        f"({', '.join(codes)}), {'; '.join(machines)}.",
    ]
    lines += _by_event(result)
    if "bound" in result:
        classes = [row["information"] for row in result["rows"]]
        lines += bound_notes(result["bound"], len(result["earthquakes"]))
        lines += causal_notes(result["causal_bound"], own, result["rows"], result["bound"])
        lines += class_note(classes, own)
    elif result["optimal_cost"] is not None:
        lines.append(f"J* = {result['optimal_cost']:.6g}.")
    return "\n".join(lines) + "\n"


def _supervised_text(row: dict[str, Any]) -> str:
    """Return a policy's cost over the normaliser's within the safety supervisor, and what that did."""
    if (figures := row.get("supervised")) is None:
        return "-"
    cost, share = cost_interval(figures["relative_cost"]).split(" ")[0], 100.0 * figures["acted"]
    return f"{cost}, {figures['failures']} of {row['episodes']}, {share:.1g}"


def _by_event(result: dict[str, Any]) -> list[str]:
    """Return a table of the cost over the normaliser's by event, where the motions have events."""
    events = result.get("events", ())
    if not events or result["normaliser"] not in ("bound", *result["episodes"]):
        return []
    bound = result["normaliser"] == "bound"
    base = result["bound"]["costs"] if bound else result["episodes"][result["normaliser"]]["cost"][0]
    places = {
        each: [i for i, event in enumerate(events[: len(base)]) if event == each]
        for each in dict.fromkeys(events)
    }
    rows = []
    for row in ranked_rows(result):
        cost = np.mean(result["episodes"][row["controller"]]["cost"], axis=0)
        ratios = (sum(cost[i] for i in m) / sum(base[i] for i in m) for m in places.values())
        rows.append([row["controller"], *(f"{ratio:.3f}" for ratio in ratios)])
    head = (f"cost / {result['normaliser']} by event", *(f"{e} ({len(m)})" for e, m in places.items()))
    return ["", markdown_table(head, rows)]


def cost_interval(figure: dict[str, float]) -> str:
    """Return a relative cost as `interval_text` does: three digits after the point, one from 10 on."""
    return interval_text(figure, 3 if figure["high"] < 10.0 else 1)


def _scale(name: str) -> float:
    return 1.0 if name == "optimality" else 100.0


def ranked_rows(result: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of the protocol's result by cost, a controller that is the normaliser first."""
    first = result["normaliser"]
    return sorted(result["rows"], key=lambda r: (r["controller"] != first, r["relative_cost"]["value"]))


def interval_text(figure: dict[str, float] | None, digits: int, scale: float = 1.0) -> str:
    """Return ``value [low, high]``; the value alone where there is no interval, a dash for None."""
    if figure is None:
        return "-"
    value, low, high = (f"{scale * figure[key]:.{digits}f}" for key in ("value", "low", "high"))
    return value if low == value == high else f"{value} [{low}, {high}]"


def put_tables(page: str | PathLike[str], results: dict[str, dict[str, Any]]) -> list[str]:
    """Put tables of the protocol's results into a page, each at ``<!-- evaluation NAME -->``.

    Returns
    -------
    Names of results that the page has no place for.

    Raises
    ------
    ParameterError
        If a place has no end; see `markdown_blocks.put_block`.
    """
    page = Path(page)
    missing = []
    for name, result in results.items():
        if has_place(page, f"evaluation {name}"):
            put_block(page, f"evaluation {name}", evaluation_markdown(result), end=name)
        else:
            missing.append(name)
    return missing
