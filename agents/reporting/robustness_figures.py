"""Figures of a robustness result: cost over each quantity, and maps over pairs of them."""

from __future__ import annotations

import math
from itertools import cycle
from os import PathLike
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import FuncFormatter, NullFormatter, NullLocator

from agents.evaluation.perturbations import QUANTITIES
from agents.figure_style import (
    BLACK,
    CONTROLLERS,
    GREY,
    TARGET,
    figure_style,
    new_figure,
    save_figure,
    write_figure,
)
from agents.reporting.robustness_tables import Point, controller_label, point_at, sweep_points
from shake_env.model.parameters import FloatArray

WIDEST = 5  # maps side by side whose numbers can be read
LEAST, MOST = 0.3, 4.0  # of the relative cost that panels show; what lies beyond stands at the edge
STRIP = 1.19  # height of a controller's row above and below, as a factor on the logarithmic axis
SHADE = "#E4E4E4"  # training range; in maps, cells that have no ratio
DARKEST = np.log(2.5)  # a map's colour is full at 2.5 times the reference's cost, and at 1 / 2.5


def draw_robustness(
    result: dict[str, Any], folder: str | PathLike[str], *, svg: bool = True
) -> list[Path]:
    """Draw a robustness result and return the files written.

    Parameters
    ----------
    result
        Of ``shake robustness``.
    folder
        Where to; made if it is not there.
    svg
        Whether each figure is written as SVG, too.
    """
    folder = Path(folder)
    written = []
    with figure_style():
        for name, figure in robustness_figures(result).items():
            if svg:
                written += save_figure(figure, folder, name)
                continue
            written.append(folder / f"{name}.png")
            write_figure(figure, written[-1])
    return written


def robustness_figures(result: dict[str, Any]) -> dict[str, Figure]:
    """Return the figures of a robustness result by name: its sweeps, and its maps if it has any."""
    name = f"robustness_{result['scenario']}"
    return {name: _sweeps(result)} | ({f"{name}_maps": _maps(result)} if result["maps"] else {})


def _sweeps(result: dict[str, Any]) -> Figure:
    """Return cost over the reference's, and the reference's over its own, a panel a quantity."""
    columns, quantities = 2, result["quantities"]
    rows = -(-len(quantities) // columns)
    with figure_style():
        figure = new_figure(8.0, 2.2 * rows + (0.0 if len(quantities) % columns else 0.9))
        panels = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
        for number, (ax, quantity) in enumerate(zip(panels, quantities, strict=False)):
            _panel(ax, result, quantity)
            if number % columns == 0:
                ax.set_ylabel(f"cost / {result['reference']} [-]")
        handles = _legend(result)
        if len(panels) > len(quantities):
            panels[-1].set_axis_off()
            panels[-1].legend(handles=handles, loc="center", ncols=1)
        else:
            figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure


def _legend(result: dict[str, Any]) -> list[Any]:
    mark: dict[str, Any] = {"color": BLACK, "linestyle": "", "markersize": 5.5}
    return [
        *(
            Line2D([], [], label=controller_label(each), markersize=5.0, **style)
            for each, style in zip(result["controllers"], cycle(CONTROLLERS), strict=False)
        ),
        Line2D([], [], label=f"{result['reference']}'s own cost / unchanged", **TARGET),
        Line2D([], [], marker="x", markeredgewidth=1.6, label="above: lost tests", **mark),
        Line2D([], [], marker="o", markerfacecolor="none",
               label=f"below: lost none where {result['reference']} did", **mark),
        Patch(facecolor=SHADE, label="drawn in training"),
        Line2D([], [], color=GREY, linestyle="--", linewidth=1.0, label="made for"),
    ]  # fmt: skip


def _panel(ax: Axes, result: dict[str, Any], quantity: dict[str, Any]) -> None:
    shown, points, values = result["controllers"], sweep_points(result, quantity), quantity["values"]
    if quantity["trained"]:
        ax.axvspan(*quantity["trained"], color=SHADE, linewidth=0.0, zorder=0.5)
    ax.axvline(quantity["nominal"], color=GREY, linestyle="--", linewidth=1.0, zorder=1.0)
    _scale(ax, quantity)
    # Where the reference lost a test its cost is a fine, and no measure of another's.
    unmeasured = np.array([point["failures"][result["reference"]] > 0 for point in points])
    own = np.where(unmeasured, np.nan, np.clip(_own_cost(result, points), LEAST, MOST))
    ax.plot(values, own, **TARGET, zorder=1.5)
    for i, each in enumerate(shown):
        style, name = CONTROLLERS[i % len(CONTROLLERS)], each["name"]
        gone = np.array([point["failures"][name] > 0 for point in points])
        ratio = np.clip([point["relative_cost"][name] for point in points], LEAST, MOST)
        ratio[gone | unmeasured] = np.nan
        ax.plot(values, ratio, markersize=4.5, linewidth=1.5, markeredgecolor="white",
                markeredgewidth=0.5, **style)  # fmt: skip
        mark: dict[str, Any] = {"color": style["color"], "linestyle": "", "markersize": 4.8}
        above, below = MOST * STRIP ** (len(shown) - i), LEAST / STRIP ** (1 + i)
        lost = np.asarray(values)[gone]
        ax.plot(lost, np.full(len(lost), above), marker="x", markeredgewidth=1.5, **mark)
        held = np.asarray(values)[unmeasured & ~gone]
        ax.plot(held, np.full(len(held), below), marker=style["marker"], markerfacecolor="none", **mark)
    for edge in (LEAST, MOST):
        ax.axhline(edge, color=GREY, linewidth=0.7)
    ax.set_yscale("log")
    ax.set_ylim(LEAST / STRIP ** (len(shown) + 0.7), MOST * STRIP ** (len(shown) + 0.7))
    ticks = (0.3, 0.5, 1.0, 2.0, 4.0)
    ax.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.yaxis.set_minor_locator(NullLocator())
    ax.set_xlabel(f"{quantity['title']} [{quantity['unit']}]")


def _own_cost(result: dict[str, Any], points: list[Point]) -> FloatArray:
    """Return the reference's cost over its own where nothing is changed, at the same amplitude."""
    name = result["reference"]
    unchanged = point_at(result)["cost"][name]
    amplitude = np.array([point["changes"].get("amplitude", 1.0) for point in points])
    own: FloatArray = np.array([point["cost"][name] for point in points]) / (unchanged * amplitude**2)
    return own


def _scale(ax: Axes, quantity: dict[str, Any]) -> None:
    values = quantity["values"]
    if quantity["name"] == "noise":
        smallest = min(value for value in values if value > 0.0)
        ax.set_xscale("symlog", linthresh=smallest, linscale=0.5)
    elif QUANTITIES[quantity["name"]].logarithmic:
        ax.set_xscale("log")
    else:
        return
    few = values if len(values) < 7 else [v for i, v in enumerate(values) if i % 2 == 0]
    ticks = sorted({*few, values[-1]} - ({values[-2]} if len(few) < len(values) else set()))
    ax.set_xticks(ticks)
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.xaxis.set_minor_locator(NullLocator())


def _maps(result: dict[str, Any]) -> Figure:
    """Return the maps: a row a pair, a column a controller; more than five controllers in blocks."""
    shown, pairs = result["controllers"], result["maps"]
    by_name = {quantity["name"]: quantity for quantity in result["quantities"]}
    blocks = math.ceil(len(shown) / WIDEST)
    columns = math.ceil(len(shown) / blocks)
    heights = [len(pair["ys"]) + 1.6 for pair in pairs] * blocks
    with figure_style():
        figure = new_figure(8.0, 0.7 + 0.36 * sum(heights))
        panels = figure.subplots(
            len(heights), columns, squeeze=False, gridspec_kw={"height_ratios": heights}
        )
        for number, row in enumerate(panels):
            block, pair = columns * (number // len(pairs)), pairs[number % len(pairs)]
            x, y = by_name[pair["x"]], by_name[pair["y"]]
            for i, ax in enumerate(row):
                if block + i >= len(shown):
                    ax.set_axis_off()
                    continue
                each = shown[block + i]
                _map(ax, result, pair, each["name"])
                ax.set_xticks(range(len(pair["xs"])), [f"{value:.3g}" for value in pair["xs"]])
                ax.set_yticks(range(len(pair["ys"])), [f"{value:.3g}" for value in pair["ys"]])
                ax.tick_params(length=0.0, labelsize=7.5)
                ax.set_xlabel(_short(x), fontsize=8.0)
                if i == 0:
                    ax.set_ylabel(_short(y), fontsize=8.0)
                else:
                    ax.set_yticklabels([])
                if number % len(pairs) == 0:
                    ax.set_title(controller_label(each))
        figure.suptitle(
            f"cost / {result['reference']}; framed: made for; x: lost tests; "
            f"held: lost none where {result['reference']} did",
            fontsize=9.0,
        )
    return figure


def _short(quantity: dict[str, Any]) -> str:
    words = {
        "mass_ratio": "mass ratio", "coulomb_friction": "friction", "delay": "delay",
        "noise": "noise", "amplitude": "amplitude", "storey_frequency": "storey freq.",
    }  # fmt: skip
    return f"{words.get(quantity['name'], quantity['title'])} [{quantity['unit']}]"


def _map(ax: Axes, result: dict[str, Any], pair: dict[str, Any], controller: str) -> None:
    shades, norm = mpl.colormaps["PuOr_r"], Normalize(-DARKEST, DARKEST)
    by_name = {quantity["name"]: quantity for quantity in result["quantities"]}
    for i, x in enumerate(pair["xs"]):
        for j, y in enumerate(pair["ys"]):
            point = point_at(result, **{pair["x"]: x, pair["y"]: y})
            gone = point["failures"][controller] > 0
            ratio = point["relative_cost"][controller]
            face: Any = SHADE
            if gone:
                text = "x"
            elif point["failures"][result["reference"]]:
                text = "held"
            else:
                # The map's ends are too dark for figures in black.
                face = shades(0.5 + 0.7 * (float(np.clip(norm(np.log(ratio)), 0.0, 1.0)) - 0.5))
                text = f"{ratio:.2f}" if ratio < 9.95 else f"{ratio:.0f}"
            ax.add_patch(_square(i, j, facecolor=face, edgecolor="white"))
            ax.text(i, j, text, ha="center", va="center", fontsize=11.0 if gone else 7.5,
                    fontweight="bold" if gone else "normal")  # fmt: skip
            if x == by_name[pair["x"]]["nominal"] and y == by_name[pair["y"]]["nominal"]:
                made_for = _square(i, j, fill=False, edgecolor=BLACK, linewidth=1.4, zorder=3.0)
                ax.add_patch(made_for)
    ax.set_xlim(-0.5, len(pair["xs"]) - 0.5)
    ax.set_ylim(-0.5, len(pair["ys"]) - 0.5)
    ax.grid(visible=False)
    ax.spines[:].set_visible(False)


def _square(i: int, j: int, **style: Any) -> Rectangle:
    return Rectangle((i - 0.5, j - 0.5), 1.0, 1.0, **style)
