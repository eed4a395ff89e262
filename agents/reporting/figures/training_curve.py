"""The training curve of a model card."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path

from matplotlib.ticker import FormatStrFormatter, NullFormatter

from agents.figure_style import BLUE, GREY, figure_style, new_figure, write_figure


def draw_training_curve(curve: Sequence[Sequence[float]], file: str | PathLike[str]) -> None:
    """Draw a policy's cost over the reference's, as training went on, and write the figure."""
    file = Path(file)
    with figure_style():
        figure = new_figure(5.0, 2.6)
        axes = figure.subplots()
        steps = [row[0] / 1e6 for row in curve]
        axes.plot(steps, [row[1] for row in curve], color=BLUE, marker="o", markersize=3.0)
        axes.axhline(1.0, color=GREY, linewidth=1.0, linestyle=(0, (4, 2)))
        ratios = [row[1] for row in curve]
        if max(ratios) > 3.0:
            axes.set_yscale("log")
            axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
            # Within a decade the ticks between its ends are all there is to read.
            narrow = max(ratios) < 10.0 * min(ratios)
            between = FormatStrFormatter("%g") if narrow else NullFormatter()
            axes.yaxis.set_minor_formatter(between)
        axes.set_xlabel("control periods of all tables [million]")
        axes.set_ylabel("cost / reference [-]")
        write_figure(figure, file)
