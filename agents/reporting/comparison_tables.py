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
from agents.evaluation.results import Comparison, GroupSummary, cost_text, drive_column
from agents.figure_style import save_figure, tracking_figure
from agents.reporting.bound_notes import comparison_notes, marked_class
from agents.reporting.csv_file import write_csv
from agents.reporting.summary_text import QUESTIONS, verdict
from agents.reporting.terminal import print_table
from shake_env.files import write_json
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.metrics import EpisodeMetrics


def print_tables(comparison: Comparison, console: Console) -> None:
    """Print a comparison as one table a group of earthquakes."""
    groups = dict.fromkeys(summary.group for summary in comparison.summaries)
    drive, unit, _ = drive_column(comparison.input_unit)
    ended = any(summary.broken_limits for summary in comparison.summaries)
    for group in groups:
        rows = [summary for summary in comparison.summaries if summary.group == group]
        bounded = any(np.isfinite(row.bound_cost) for row in rows)
        shown = {"ended": ended, BOUND_HEADING: bounded, "regret\nclosed %": bounded}
        columns = [column for column in COLUMNS if shown.get(column[0], True)]
        headings = [
            heading.format(reference=_label(comparison.reference), drive=f"{drive}\n{unit}")
            for heading, _ in columns
        ]
        cells = [
            [
                _label(row.controller),
                marked_class(row.information, comparison.information),
                *(cell(row, comparison) for _, cell in columns),
            ]
            for row in rows
        ]
        number = rows[0].earthquakes
        title = f"{group}, {number} earthquake{'s' if number != 1 else ''}"
        print_table(console, ["controller", "information", *headings], cells, title=title, left=(1,))
    if comparison.events:
        by_event = comparison.by_event()
        cells = [
            [_label(name), *(f"{costs[name]:.3f}" for costs in by_event.values())]
            for name in comparison.episodes
        ]
        title = f"motions by event, cost / {_label(comparison.reference)}"
        print_table(console, ["controller", *by_event], cells, title=title)
    for note in comparison_notes(comparison):
        console.print(note, highlight=False)
    console.print(
        f"Cost: summed over the group, relative to {_label(comparison.reference)}'s on the same "
        "earthquakes; 95 % bootstrap interval over earthquakes. Errors: relative to the target's own "
        "rms and peak, mean over earthquakes. Lag of the table's acceleration; share of "
        f"response-spectrum ordinates more than 10 % off; Arias intensity over the target's. "
        f"{drive.title()}, velocity and stroke: the largest. Decision: processor time of one, median."
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


def print_verdict(comparison: Comparison, scenario: Scenario, console: Console) -> None:
    """Print who wins a comparison, where it loses and what limits it, as a table of three rows."""
    sentences = verdict(comparison, scenario, _label).sentences
    rows = list(zip(QUESTIONS, sentences, strict=True))
    print_table(console, ("verdict", ""), rows, left=(1,), fold=1)


def damage_note(row: GroupSummary) -> str:
    """Return what a controller that repeats its tests took from the specimen, in words."""
    return (
        f"{row.tests} tests of each earthquake, the one that counts included; before that one the "
        f"specimen had dissipated {row.damage:.1f} times the energy of a perfect test (median)"
    )


def _cost(row: GroupSummary, comparison: Comparison) -> str:
    return "1" if row.controller == comparison.reference else row.cost_text()


def _bound_cost(row: GroupSummary, comparison: Comparison) -> str:
    return cost_text(row.bound_cost, row.bound_cost_low, row.bound_cost_high)


def _drive(row: GroupSummary, comparison: Comparison) -> str:
    _, _, factor = drive_column(comparison.input_unit)
    return f"{factor * row.peak_current:.{0 if factor > 1.0 else 2}f}"


def _figure(name: str, scale: float, digits: int) -> Callable[[GroupSummary, Comparison], str]:
    """Return what writes a figure of a row, scaled; a dash where it is not defined."""

    def cell(row: GroupSummary, comparison: Comparison) -> str:
        value = getattr(row, name)
        return f"{scale * value:.{digits}f}" if np.isfinite(value) else "-"

    return cell


# Heading and cell of each column. The order is of worth: a narrow terminal gets the last ones below.
BOUND_HEADING = "cost / bound\n[95 %]"
COLUMNS: tuple[tuple[str, Callable[[GroupSummary, Comparison], str]], ...] = (
    ("cost / {reference}\n[95 %]", _cost),
    (BOUND_HEADING, _bound_cost),
    ("accel.\nrms %", _figure("acceleration_rms_error", 100.0, 1)),
    ("accel.\npeak %", _figure("acceleration_peak_error", 100.0, 1)),
    ("shear\nrms %", _figure("base_shear_rms_error", 100.0, 1)),
    ("shear\npeak %", _figure("base_shear_peak_error", 100.0, 1)),
    ("regret\nclosed %", _figure("regret_closed", 100.0, 0)),
    ("lag\nms", _figure("delay", 1e3, 1)),
    ("ended", _figure("broken_limits", 1.0, 0)),
    ("spectrum\n%", _figure("spectral_error", 100.0, 0)),
    ("Arias\n-", _figure("arias_ratio", 1.0, 2)),
    ("{drive}", _drive),
    ("velocity\nm/s", _figure("peak_velocity", 1.0, 2)),
    ("stroke\nmm", _figure("peak_displacement", 1e3, 0)),
    ("decision\nus", _figure("decision_time", 1e6, 0)),
)


def write_files(
    comparison: Comparison, settings: dict[str, Any], folder: str | PathLike[str]
) -> list[Path]:
    """Write a comparison's JSON, CSV files and figure; return their paths."""
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
    traces = {_label(name): trace for name, trace in comparison.traces.items() if name != "none"}
    figure = tracking_figure(traces, f"Motion of the table and base shear: {comparison.traced}")
    return paths + save_figure(figure, folder, "comparison")


def _label(name: str) -> str:
    if name in ("lqr", "lqg"):
        return name.upper()
    return Path(name).name if "/" in name else name
