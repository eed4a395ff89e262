"""The figure of `shake adaptation`: ratios of costs over time, and after memories were cleared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Any

from agents.figure_style import CONTROLLERS, GREY, figure_style, new_figure, save_figure
from agents.studies.adaptation.costs import INFORMED

STYLED = ("dagger-apg", "dagger", "nmpc", "nmpc-adaptive", "lqg-searched", "apg")


def draw_adaptation(result: Mapping[str, Any], folder: str | PathLike[str]) -> list[Path]:
    """Draw a result of `agents.studies.adaptation.result.adaptation`; return the files."""
    rows = [row for row in result["rows"] if row["controller"] != INFORMED]
    names = [row["controller"] for row in rows]
    # The same line in every figure, whatever else it shows.
    order = [*STYLED, *(name for name in names if name not in STYLED)]
    styles = {name: CONTROLLERS[order.index(name) % len(CONTROLLERS)] for name in names}
    cleared = result["cleared"]
    with figure_style():
        figure = new_figure(8.0, 5.6 if cleared else 3.6)
        panels = figure.subplots(
            2 if cleared else 1, 1, squeeze=False, height_ratios=[3, 2][: 1 + bool(cleared)]
        )
        top = panels[0, 0]
        for row in rows:
            _curve(top, result["edges"], row["ratio"], row["controller"], styles[row["controller"]])
        top.set_yscale("log")
        top.set_yticks(ticks := [0.5, 1, 1.5, 2, 3, 4, 5], [f"{tick:g}" for tick in ticks])
        top.minorticks_off()
        top.set_ylabel(f"cost / cost of {INFORMED}")
        top.set_title(
            f"{result['scenario']}: cost over time beside the controller that is told the plant",
            loc="left",
        )
        top.set_xlim(result["edges"][0], result["edges"][-1])
        if cleared:
            below = panels[1, 0]
            for row in cleared:
                _curve(below, result["clear_edges"], row["ratio"], row["policy"], styles[row["policy"]])
            below.axvline(result["clear_time"], color=GREY, linewidth=1.0)
            below.set_ylabel("cost / cost if kept")
            below.set_title(
                f"the same policies, memory cleared once after {result['clear_time']:g} s", loc="left"
            )
            below.set_xlim(result["clear_edges"][0], result["clear_edges"][-1])
        panels[-1, 0].set_xlabel("time [s]")
        figure.legend(*top.get_legend_handles_labels(), loc="outside lower center", ncols=3)
        return save_figure(figure, folder, f"adaptation_{result['scenario']}")


def _curve(
    axis: Any,
    edges: Sequence[float],
    ratio: Sequence[Sequence[float]],
    label: str,
    style: Mapping[str, Any],
) -> None:
    """Draw values in the middle of their bins, their interval as a band."""
    middle = [(a + b) / 2.0 for a, b in pairwise(edges)]
    value, low, high = zip(*ratio, strict=True)
    axis.fill_between(middle, low, high, color=style["color"], alpha=0.15, linewidth=0.0)
    line = {**style, "linewidth": 1.4, "markersize": 3.5, "markevery": 2}
    axis.plot(middle, value, label=label, **line)
    axis.axhline(1.0, color=GREY, linewidth=0.8, zorder=0)
