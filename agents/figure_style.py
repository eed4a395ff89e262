"""One style for every figure: readable at column width, safe for colour-blind eyes and for grey print.

Colours are Okabe and Ito's. Lines also differ by dash and by lightness, so that no figure needs colour.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from shake_env.files import write_bytes
from shake_env.simulation.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

BLUE, ORANGE, VERMILLION, GREEN, SKY, PURPLE, BLACK, GREY = (
    "#0072B2", "#E69F00", "#D55E00", "#009E73", "#56B4E9", "#CC79A7", "#000000", "#7F7F7F",
)  # fmt: skip

CORRECTED: dict[str, Any] = {"color": BLUE, "linewidth": 1.6}
# Wider and drawn first, so that it shows where the two models agree.
PRINTED: dict[str, Any] = {"color": ORANGE, "linewidth": 3.0}

SERIES: tuple[dict[str, Any], ...] = (
    {"color": SKY, "linestyle": "-", "linewidth": 2.0},
    {"color": VERMILLION, "linestyle": (0, (5, 2)), "linewidth": 1.7},
    {"color": BLACK, "linestyle": (0, (1, 1.2)), "linewidth": 1.7},
    {"color": GREEN, "linestyle": (0, (6, 2, 1, 2)), "linewidth": 1.7},
    {"color": PURPLE, "linestyle": (0, (3, 1, 1, 1, 1, 1)), "linewidth": 1.7},
)

# Colour, dash pattern and marker each tell controllers apart. Targets lie wide and light behind.
TARGET: dict[str, Any] = {"color": "#9A9A9A", "linestyle": "-", "linewidth": 3.2}
CONTROLLERS: tuple[dict[str, Any], ...] = (
    {"color": BLUE, "linestyle": "-", "marker": "o"},
    {"color": VERMILLION, "linestyle": (0, (5, 2)), "marker": "s"},
    {"color": BLACK, "linestyle": (0, (1, 1.2)), "marker": "^"},
    {"color": GREEN, "linestyle": (0, (6, 2, 1, 2)), "marker": "D"},
    {"color": "#A5527F", "linestyle": (0, (9, 3)), "marker": "v"},  # purple, dark enough for white paper
    {"color": "#9C6B00", "linestyle": (0, (9, 2, 2, 2)), "marker": "X"},  # orange, likewise
    {"color": "#2F8FC4", "linestyle": (0, (2, 2)), "marker": "P"},  # sky, likewise
    {"color": "#D0417E", "linestyle": (0, (4, 1.5, 1, 1.5, 1, 1.5)), "marker": "*"},
)
# The same for plotly, which names dash patterns and markers its own way.
PLOTLY: tuple[dict[str, str], ...] = tuple(
    {"color": style["color"], "dash": dash, "symbol": symbol}
    for style, dash, symbol in zip(
        CONTROLLERS,
        (
            "solid",
            "5px,2px",
            "1.5px,2px",
            "7px,2px,1.5px,2px",
            "10px,3px",
            "10px,2px,3px,2px",
            "3px,3px",
            "5px,2px,1.5px,2px,1.5px,2px",
        ),
        ("circle", "square", "triangle-up", "diamond", "triangle-down", "x", "cross", "star"),
        strict=True,
    )
)

WINDOW = 5.0  # [s] that figures over time show

STYLE: dict[RcKeyType, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.5,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "legend.fontsize": 9.0,
    "legend.frameon": False,
    "legend.handlelength": 3.0,  # long enough to show a whole dash
    "lines.linewidth": 1.7,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "figure.dpi": 110,
    "savefig.dpi": 110,
    "svg.fonttype": "path",
    # Same bytes for the same figure: no date, no random identifiers.
    "svg.hashsalt": "shake",
}


@contextmanager
def figure_style() -> Iterator[None]:
    """Apply the style inside a ``with`` block and nowhere else."""
    with mpl.rc_context(STYLE):
        yield


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure, `width` by `height` inches, that needs no display and no pyplot state."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def strongest_seconds(time: NDArray[np.float64], shear: NDArray[np.floating]) -> tuple[float, float]:
    """Return the ends [s] of a figure's `WINDOW` about the peak of a base shear (samples,)."""
    centre = time[int(np.argmax(np.abs(shear)))]
    start = min(max(centre - 0.4 * WINDOW, 0.0), max(time[-1] - WINDOW, 0.0))
    return float(start), float(min(start + WINDOW, time[-1]))


def tracking_figure(traces: Mapping[str, Trajectory], title: str) -> Figure:
    """Return the strongest seconds of tests on one earthquake: both quantities with their targets.

    Parameters
    ----------
    traces
        By label of the controller, at least one.
    title
        Of the figure.
    """
    first = next(iter(traces.values()))
    start, end = strongest_seconds(first.time, first.reference_base_shear)
    with figure_style():
        figure = new_figure(8.0, 5.2)
        panels = figure.subplots(2, 1, sharex=True)
        for panel, target, achieved, unit in (
            (panels[0], "target_acceleration", "table_acceleration", 1.0),
            (panels[1], "reference_base_shear", "base_shear", 1e-3),
        ):
            curves = [("target (real ground)", first, target, TARGET)]
            for k, (label, trace) in enumerate(traces.items()):
                style = {**CONTROLLERS[k % len(CONTROLLERS)], "marker": "", "linewidth": 1.3}
                curves.append((label, trace, achieved, style))
            for label, trace, name, style in curves:
                inside = (trace.time >= start) & (trace.time <= end)
                values = unit * getattr(trace, name)[inside]
                panel.plot(trace.time[inside], values, label=label, **style)
        panels[0].set_ylabel("table acceleration [m/s²]")
        panels[1].set_ylabel("base shear [kN]")
        panels[1].set_xlabel("time [s]")
        panels[1].set_xlim(start, end)
        panels[0].set_title(title, loc="left")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
        return figure


def save_figure(figure: Figure, folder: str | PathLike[str], name: str) -> list[Path]:
    """Write `figure` as PNG and SVG into `folder` and return both paths."""
    folder = Path(folder)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # laid out once, not again for each format
    paths = [folder / f"{name}.png", folder / f"{name}.svg"]
    for path in paths:
        write_figure(figure, path)
    return paths


def write_figure(figure: Figure, path: str | PathLike[str]) -> None:
    """Write `figure` as PNG or SVG, as the file's ending says; the same figure has the same bytes.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    path = Path(path)
    kind = path.suffix.removeprefix(".")
    image = io.BytesIO()
    figure.savefig(image, format=kind, metadata={"Date" if kind == "svg" else "Software": None})
    write_bytes(path, image.getvalue())
