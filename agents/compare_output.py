"""A comparison as a table in the terminal, as CSV and JSON, and as a figure of one earthquake."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict, fields
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from agents.compare import Comparison, GroupSummary
from agents.fidelity import Fidelity
from agents.figure_style import BLACK, SERIES, figure_style, new_figure, save_figure
from shake_env.metrics import EpisodeMetrics

WINDOW = 5.0  # [s] shown of the traced earthquake, about its peak


def print_tables(comparison: Comparison, console: Console) -> None:
    """Print one table a group of earthquakes."""
    groups = dict.fromkeys(summary.group for summary in comparison.summaries)
    for group in groups:
        rows = [summary for summary in comparison.summaries if summary.group == group]
        title = f"{group}, {rows[0].earthquakes} earthquakes"
        table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
        table.add_column("controller", overflow="fold", min_width=10)
        headings = [
            f"cost / {_label(comparison.reference)} [95 %]", "accel. %\nrms  peak", "shear %\nrms  peak",
            "lag\nms", "spec.\n%", "Arias", "peak\nmA  m/s   mm", "us",
        ]  # fmt: skip
        broken = any(row.broken_limits for row in rows)
        for heading in headings + ["ended"] * broken:
            table.add_column(heading.replace("[", "\\["), justify="right", no_wrap=True)
        for row in rows:
            table.add_row(*_cells(row, comparison.reference), *[str(row.broken_limits)] * broken)
        console.print(table)
    console.print(
        f"Cost: summed over the group, relative to {_label(comparison.reference)}'s on the same "
        "earthquakes; 95 % bootstrap interval over earthquakes. Errors: relative to the target's own "
        "rms and peak, mean over earthquakes. Lag of the table's acceleration; share of "
        "response-spectrum ordinates more than 10 % off; Arias intensity over the target's. Current, "
        "velocity and stroke: the largest. us: processor time of one decision, median. Ended: by a "
        "broken limit."
    )
    for row in comparison.summaries:
        if np.isfinite(row.damage):
            console.print(f"{_label(row.controller)} on {row.group}: {damage_note(row)}.")
    for name, share in comparison.interventions.items():
        console.print(f"The supervisor changed {100 * share:.2f} % of the commands of {_label(name)}.")
    for left_out in comparison.skipped:
        console.print(f"Left out: {left_out}.", style="yellow")


def damage_note(row: GroupSummary) -> str:
    """Return what a controller that repeats its tests took from the specimen, in words."""
    return (
        f"{row.tests} tests of each earthquake, the one that counts included; before that one the "
        f"specimen had dissipated {row.damage:.1f} times the energy of a perfect test (median)"
    )


def _cells(row: GroupSummary, reference: str) -> list[str]:
    digits = 3 if row.relative_cost_high < 10.0 else 1
    interval = (
        f"{row.relative_cost:.{digits}f} "
        f"\\[{row.relative_cost_low:.{digits}f}, {row.relative_cost_high:.{digits}f}]"
    )
    acceleration = f"{100 * row.acceleration_rms_error:.1f} {100 * row.acceleration_peak_error:5.1f}"
    shear = f"{100 * row.base_shear_rms_error:.1f} {100 * row.base_shear_peak_error:5.1f}"
    return [
        _label(row.controller),
        "1" if row.controller == reference else interval,
        acceleration,
        shear,
        f"{1e3 * row.delay:.1f}" if np.isfinite(row.delay) else "-",
        f"{100 * row.spectral_error:.0f}",
        f"{row.arias_ratio:.2f}",
        f"{1e3 * row.peak_current:.0f} {row.peak_velocity:.2f} {1e3 * row.peak_displacement:4.0f}",
        f"{1e6 * row.decision_time:.0f}" if np.isfinite(row.decision_time) else "-",
    ]


def write_files(
    comparison: Comparison, settings: dict[str, Any], folder: str | PathLike[str]
) -> list[Path]:
    """Write comparison.json, summary.csv, episodes.csv and the figure; return their paths."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / "comparison.json", folder / "summary.csv", folder / "episodes.csv"]
    text = json.dumps(comparison.to_json(settings), indent=2) + "\n"
    paths[0].write_text(text, encoding="utf-8")
    _write_csv(paths[1], [asdict(summary) for summary in comparison.summaries], GroupSummary)
    episodes = [
        {"controller": name, **asdict(row), **asdict(measures)}
        for name, rows in comparison.episodes.items()
        for row, measures in zip(rows, comparison.fidelities[name], strict=True)
    ]
    measured = [field.name for field in fields(Fidelity)]
    _write_csv(paths[2], episodes, EpisodeMetrics, "controller", last=measured)
    return paths + _draw(comparison, folder)


def _write_csv(
    path: Path, rows: list[dict[str, Any]], kind: type[Any], *first: str, last: Sequence[str] = ()
) -> None:
    names = [*first, *(field.name for field in fields(kind)), *last]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(rows)


def _draw(comparison: Comparison, folder: Path) -> list[Path]:
    traces = {name: trace for name, trace in comparison.traces.items() if name != "none"}
    first = next(iter(traces.values()))
    centre = first.time[int(np.argmax(np.abs(first.reference_base_shear)))]
    start = min(max(centre - 0.4 * WINDOW, 0.0), max(first.time[-1] - WINDOW, 0.0))
    with figure_style():
        figure = new_figure(8.0, 5.2)
        upper, lower = figure.subplots(2, 1, sharex=True)
        shown = (first.time >= start) & (first.time <= start + WINDOW)
        upper.plot(
            first.time[shown], first.target_acceleration[shown], color=BLACK, linewidth=2.6, alpha=0.35,
            label="target (real ground)",
        )  # fmt: skip
        lower.plot(
            first.time[shown], first.reference_base_shear[shown] / 1e3, color=BLACK, linewidth=2.6,
            alpha=0.35,
        )  # fmt: skip
        for style, (name, trace) in zip(_styles(len(traces)), traces.items(), strict=True):
            inside = (trace.time >= start) & (trace.time <= start + WINDOW)
            upper.plot(trace.time[inside], trace.table_acceleration[inside], label=_label(name), **style)
            lower.plot(trace.time[inside], trace.base_shear[inside] / 1e3, **style)
        upper.set_ylabel("table acceleration [m/s²]")
        lower.set_ylabel("base shear [kN]")
        lower.set_xlabel("time [s]")
        upper.set_xlim(start, start + WINDOW)
        upper.set_title(f"What the table did, and what the specimen felt: {comparison.traced}")
        figure.legend(*upper.get_legend_handles_labels(), loc="outside lower center", ncols=4)
        return save_figure(figure, folder, "comparison")


def _styles(number: int) -> list[dict[str, Any]]:
    thin = [{**style, "linewidth": 1.3} for style in SERIES[1:]]
    return [thin[i % len(thin)] for i in range(number)]


def _label(name: str) -> str:
    if name in ("lqr", "lqg"):
        return name.upper()
    return Path(name).name if "/" in name else name
