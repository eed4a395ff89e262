"""A comparison as a table in the terminal, as CSV and JSON, and as a figure of one earthquake."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, fields
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from agents.evaluation.fidelity import Fidelity
from agents.evaluation.results import Comparison, GroupSummary
from agents.figure_style import BLACK, SERIES, figure_style, new_figure, save_figure
from agents.reporting.csv_file import write_csv
from agents.reporting.terminal import print_table
from shake_env.files import write_json
from shake_env.simulation.metrics import EpisodeMetrics

WINDOW = 5.0  # [s] shown of the traced earthquake, about its peak


def print_tables(comparison: Comparison, console: Console) -> None:
    """Print one table a group of earthquakes."""
    groups = dict.fromkeys(summary.group for summary in comparison.summaries)
    ended = any(summary.broken_limits for summary in comparison.summaries)
    for group in groups:
        rows = [summary for summary in comparison.summaries if summary.group == group]
        columns = [column for column in COLUMNS if column[0] != "ended" or ended]
        headings = [heading.format(reference=_label(comparison.reference)) for heading, _ in columns]
        cells = [
            [_label(row.controller), *(cell(row, comparison.reference) for _, cell in columns)]
            for row in rows
        ]
        number = rows[0].earthquakes
        title = f"{group}, {number} earthquake{'s' if number != 1 else ''}"
        print_table(console, ["controller", *headings], cells, title=title)
    console.print(
        f"Cost: summed over the group, relative to {_label(comparison.reference)}'s on the same "
        "earthquakes; 95 % bootstrap interval over earthquakes. Errors: relative to the target's own "
        "rms and peak, mean over earthquakes. Lag of the table's acceleration; share of "
        "response-spectrum ordinates more than 10 % off; Arias intensity over the target's. Current, "
        "velocity and stroke: the largest. Decision: processor time of one, median."
        + (" Ended: earthquakes that a broken limit ended." if ended else "")
    )
    for row in comparison.summaries:
        if np.isfinite(row.damage):
            console.print(f"{_label(row.controller)} on {row.group}: {damage_note(row)}.")
    for name, share in comparison.interventions.items():
        console.print(f"The supervisor changed {100 * share:.2f} % of the commands of {_label(name)}.")
    for note in comparison.notes():
        style = "yellow" if note.startswith("Warning") else None
        console.print(note, highlight=False, style=style)
    for left_out in comparison.skipped:
        console.print(f"Left out: {left_out}.", style="yellow")


def damage_note(row: GroupSummary) -> str:
    """Return what a controller that repeats its tests took from the specimen, in words."""
    return (
        f"{row.tests} tests of each earthquake, the one that counts included; before that one the "
        f"specimen had dissipated {row.damage:.1f} times the energy of a perfect test (median)"
    )


def _cost(row: GroupSummary, reference: str) -> str:
    return "1" if row.controller == reference else row.cost_text()


def _figure(name: str, scale: float, digits: int) -> Callable[[GroupSummary, str], str]:
    """Return what writes a figure of a row, scaled; a dash where it is not defined."""

    def cell(row: GroupSummary, reference: str) -> str:
        value = getattr(row, name)
        return f"{scale * value:.{digits}f}" if np.isfinite(value) else "-"

    return cell


# Heading and cell of each column. The order is of worth: a narrow terminal gets the last ones below.
COLUMNS: tuple[tuple[str, Callable[[GroupSummary, str], str]], ...] = (
    ("cost / {reference}\n[95 %]", _cost),
    ("accel.\nrms %", _figure("acceleration_rms_error", 100.0, 1)),
    ("accel.\npeak %", _figure("acceleration_peak_error", 100.0, 1)),
    ("shear\nrms %", _figure("base_shear_rms_error", 100.0, 1)),
    ("shear\npeak %", _figure("base_shear_peak_error", 100.0, 1)),
    ("lag\nms", _figure("delay", 1e3, 1)),
    ("ended", _figure("broken_limits", 1.0, 0)),
    ("spectrum\n%", _figure("spectral_error", 100.0, 0)),
    ("Arias\n-", _figure("arias_ratio", 1.0, 2)),
    ("current\nmA", _figure("peak_current", 1e3, 0)),
    ("velocity\nm/s", _figure("peak_velocity", 1.0, 2)),
    ("stroke\nmm", _figure("peak_displacement", 1e3, 0)),
    ("decision\nus", _figure("decision_time", 1e6, 0)),
)


def write_files(
    comparison: Comparison, settings: dict[str, Any], folder: str | PathLike[str]
) -> list[Path]:
    """Write comparison.json, summary.csv, episodes.csv and the figure; return their paths."""
    folder = Path(folder)
    paths = [folder / "comparison.json", folder / "summary.csv", folder / "episodes.csv"]
    write_json(paths[0], comparison.to_json(settings))
    summaries = [asdict(summary) for summary in comparison.summaries]
    write_csv(paths[1], [field.name for field in fields(GroupSummary)], summaries)
    episodes = [
        {"controller": name, **asdict(row), **asdict(measures)}
        for name, rows in comparison.episodes.items()
        for row, measures in zip(rows, comparison.fidelities[name], strict=True)
    ]
    names = [field.name for kind in (EpisodeMetrics, Fidelity) for field in fields(kind)]
    write_csv(paths[2], ["controller", *names], episodes)
    return paths + _draw(comparison, folder)


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
