"""A search of an experiment as a figure: the cost of each trial over each value that was searched."""

from __future__ import annotations

import math
from os import PathLike
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from agents.experiments.search_space import Choice, Knob
from agents.experiments.search_trace import Trace, TrialRow, trace_file_name
from agents.figure_style import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    VERMILLION,
    figure_style,
    new_figure,
    write_figure,
)

ACROSS = 4  # panels in a row
WIDEST = 20  # characters of an axis' label that a panel has room for
ROOM = 3.0  # a cost of more than so many times the median is drawn at the top: it says "lost", not how

# Lightness and shape tell them apart as well as colour does.
HELD: dict[str, Any] = {"marker": "o", "color": BLUE, "s": 18, "linewidths": 0.0}
LOST: dict[str, Any] = {"marker": "^", "facecolors": "none", "edgecolors": VERMILLION, "s": 26}
CUT: dict[str, Any] = {"marker": "|", "color": GREY, "s": 40, "linewidths": 1.0}
OWN: dict[str, Any] = {"marker": "s", "facecolors": "none", "edgecolors": BLACK, "s": 70}
BEST: dict[str, Any] = {"marker": "*", "facecolors": ORANGE, "edgecolors": BLACK, "s": 110}


def search_figure(trace: Trace, folder: str | PathLike[str]) -> Path:
    """Draw a training search into `folder` and return the path of its PNG."""
    folder = Path(folder)
    with figure_style():
        rows = math.ceil(len(trace.space) / ACROSS)
        figure = new_figure(7.0, 0.45 + 2.0 * rows)
        panels = figure.subplots(rows, ACROSS, squeeze=False, sharey=True)
        top = _top(trace)
        for axes, knob in zip(panels.flat, trace.space, strict=False):
            _panel(axes, trace, knob, top)
        for axes in panels.flat[len(trace.space) :]:
            axes.set_visible(False)
        for row in panels:
            row[0].set_ylabel(f"cost / {trace.reference}")
        handles, labels = panels.flat[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), handlelength=1.0)
        path = folder / f"{trace_file_name(trace.experiment)}.png"
        write_figure(figure, path)
    return path


def _top(trace: Trace) -> float:
    """Return the cost at which those above are drawn."""
    costs = np.asarray([row.cost for row in trace.judged if row.cost is not None])
    if not len(costs):
        return 1.0
    within = costs[costs <= ROOM * np.median(costs)]
    spread = float(np.ptp(within)) or 0.1 * float(within[0])
    return float(within.max()) + 0.15 * spread


def _place(knob: Knob, row: TrialRow) -> float:
    value = row.values[knob.name]
    return float(knob.values.index(value)) if isinstance(knob, Choice) else float(value)


def _panel(axes: Axes, trace: Trace, knob: Knob, top: float) -> None:
    def points(rows: list[TrialRow], label: str, style: dict[str, Any], order: int = 2) -> None:
        if rows:
            height = [top if row.cost is None else min(row.cost, top) for row in rows]
            place = [_place(knob, row) for row in rows]
            axes.scatter(place, height, label=label, zorder=order, **style)

    judged = trace.judged
    points([row for row in judged if not row.lost], "every table held", HELD)
    points([row for row in judged if row.lost], "a table lost", LOST)
    points([row for row in trace.trials if row.cost is None], "pruned or failed", CUT)
    points([row for row in judged if row.default], "the experiment", OWN, 3)
    points(judged[:1], "best", BEST, 4)
    axes.set_xlabel(fill(knob.meaning, WIDEST))
    if isinstance(knob, Choice):
        names = [str(value) for value in knob.values]
        axes.set_xticks(range(len(names)), names)
        axes.set_xlim(-0.5, len(names) - 0.5)
        if max(map(len, names)) > 4:
            axes.set_xticks(range(len(names)), names, rotation=40.0, ha="right", rotation_mode="anchor")
        return
    if knob.logarithmic:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=_subdivisions(knob.high / knob.low)))
        axes.xaxis.set_major_formatter(FuncFormatter(_label))
        axes.xaxis.set_minor_formatter(NullFormatter())
        room = (knob.high / knob.low) ** 0.05
        axes.set_xlim(knob.low / room, knob.high * room)


def _label(value: float, place: float | None) -> str:
    """Return a number as short as it can be told: 3e-4 and not 0.0003."""
    return f"{value:g}" if value >= 0.01 else f"{value:.0e}".replace("e-0", "e-")


def _subdivisions(ratio: float) -> tuple[float, ...]:
    """Return which multiples of powers of ten are labelled, so that two to four labels fit."""
    return (1.0,) if ratio >= 90.0 else (1.0, 3.0) if ratio > 12.0 else (1.0, 2.0, 5.0)
