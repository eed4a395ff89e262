"""The figures of a report as pictures, SVG and PNG."""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from agents.evaluation.fidelity import PERIODS, TOLERANCE
from agents.figure_style import (
    CONTROLLERS,
    GREY,
    TARGET,
    WINDOW,
    figure_style,
    new_figure,
    save_figure,
    strongest_seconds,
)
from agents.reporting.report.contents import Report
from agents.reporting.report.data import UNITS, spectral_ratio
from agents.reporting.report.traces import Curves

LEAST = 1e-12


def draw_report_figures(report: Report, folder: str | PathLike[str]) -> list[str]:
    """Draw every figure of a report that there are data for; return their names, without endings."""
    folder = Path(folder)
    drawn = []
    with figure_style():
        for name, draw in _FIGURES.items():
            figure = draw(report)
            if figure is not None:
                save_figure(figure, folder, name)
                drawn.append(name)
    return drawn


def _line(report: Report, name: str, width: float = 1.4) -> dict[str, Any]:
    style = CONTROLLERS[report.controllers.index(name) % len(CONTROLLERS)]
    return {"color": style["color"], "linestyle": style["linestyle"], "linewidth": width,
            "label": report.labels[name]}  # fmt: skip


def _mark(report: Report, name: str) -> dict[str, Any]:
    style = CONTROLLERS[report.controllers.index(name) % len(CONTROLLERS)]
    return {"color": style["color"], "marker": style["marker"], "linestyle": "none"}


def _legend(figure: Figure, panel: Axes) -> None:
    handles, labels = panel.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 4))


def _log(axis: Any) -> None:
    low, high = axis.get_view_interval()
    wide = high / low
    few, more = (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
    subs = few if wide > 6.0 else more if wide > 2.5 else tuple(np.arange(2, 20) / 2.0)
    axis.set_major_locator(LogLocator(subs=subs, numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, place: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _time(curves: Curves) -> Any:
    return (np.arange(len(curves.values["acceleration"])) + 1.0) / curves.rate


def _strongest(target: Curves) -> tuple[float, float]:
    return strongest_seconds(_time(target), target.values["shear"])


def _traces(report: Report) -> Figure:
    i = [quake.name for quake in report.gathered.earthquakes].index(report.comparison.traced)
    target = report.gathered.targets[i]
    start, end = _strongest(target)
    figure = new_figure(8.0, 9.0)
    panels = figure.subplots(len(report.channels), 1, sharex=True)
    for panel, channel in zip(panels, report.channels, strict=True):
        largest = 0.0
        shown = [("target (real ground)", target, TARGET)] if channel.targeted else []
        shown += [(report.labels[n], report.gathered.runs[n][i], _line(report, n)) for n in report.shown]
        for label, curves, style in shown:
            at = _time(curves)
            inside = (at >= start) & (at <= end)
            values = curves.values[channel.key][inside]
            largest = max(largest, float(np.max(np.abs(values), initial=0.0)))
            panel.plot(at[inside], values, **{**style, "label": label})
        title = channel.title
        if channel.limit is not None and channel.limit < 3.5 * largest:
            title += f", dashed: limit ±{channel.limit:g} {channel.unit}"
            for side in (-channel.limit, channel.limit):
                panel.axhline(side, color=GREY, linewidth=1.1, linestyle=(0, (7, 3)))
        elif channel.limit is not None:
            title += f", limit ±{channel.limit:g} {channel.unit} is far outside"
        panel.set_title(title, loc="left")
        panel.set_ylabel(f"[{channel.unit}]")
    panels[-1].set_xlim(start, end)
    panels[-1].set_xlabel("time [s]")
    figure.align_ylabels(panels)
    figure.suptitle(f"The strongest {WINDOW:g} s of {report.comparison.traced}")
    _legend(figure, panels[0])
    return figure


def _spectra(report: Report) -> Figure:
    gathered = report.gathered
    i = [quake.name for quake in gathered.earthquakes].index(report.comparison.traced)
    figure = new_figure(8.0, 4.2)
    left, right = figure.subplots(1, 2)
    target = gathered.target_spectra[i]
    left.fill_between(PERIODS, (1 - TOLERANCE) * target, (1 + TOLERANCE) * target, color="#D9D9D9",
                      label=f"target ± {100 * TOLERANCE:.0f} %")  # fmt: skip
    left.plot(PERIODS, target, **TARGET, label="target")
    right.fill_between(PERIODS, 1 - TOLERANCE, 1 + TOLERANCE, color="#D9D9D9")
    for name in report.shown:
        left.plot(PERIODS, gathered.spectra[name][i], **_line(report, name))
        right.plot(PERIODS, spectral_ratio(report, name), **_line(report, name))
    left.set_ylim(bottom=0.0)
    left.set_ylabel("pseudo-acceleration [m/s²]")
    left.set_title(report.comparison.traced, loc="left")
    right.set_ylabel("achieved / target [-]")
    right.set_title(f"Mean over {report.verdict.group}", loc="left")
    for panel in (left, right):
        panel.set_xscale("log")
        panel.set_xlim(PERIODS[0], PERIODS[-1])
        panel.set_xlabel("period [s]")
        _log(panel.xaxis)
    _legend(figure, left)
    return figure


def _transfer(report: Report) -> Figure | None:
    if not all(estimate.known for estimate in report.gathered.transfer.values()):
        return None
    figure = new_figure(8.0, 4.2)
    left, right = figure.subplots(1, 2)
    for name, estimate in report.gathered.transfer.items():
        frequency, acceleration, shear = estimate.response()
        left.plot(frequency, np.maximum(acceleration, LEAST), **_line(report, name))
        right.plot(frequency, np.maximum(shear, LEAST), **_line(report, name))
    left.set_ylabel("acceleration error / target [-]")
    right.set_ylabel("base shear error / target [N/(m/s²)]")
    for panel in (left, right):
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_xlabel("frequency [Hz]")
        panel.set_xlim(0.4, 50.0)
        _log(panel.xaxis)
    _legend(figure, left)
    return figure


def _trade_off(report: Report) -> Figure:
    figure = new_figure(6.4, 4.8)
    panel = figure.subplots()
    if report.frontier:
        curve = 100 * np.array(report.frontier)
        panel.plot(curve[:, 0], curve[:, 1], **TARGET, label="LQR of every weighting, expected")
    for name, errors in report.trade_off.items():
        if name == "none":
            continue  # off by all of both: it would squeeze the others into a corner
        rows = [report.comparison.episodes[name][i] for i in report.members]
        mark = _mark(report, name)
        panel.plot(
            [100 * row.acceleration_rms_error for row in rows],
            [100 * row.base_shear_rms_error for row in rows], **mark, markersize=3, alpha=0.25,
        )  # fmt: skip
        (x, *x_ends), (y, *y_ends) = errors.acceleration, errors.base_shear
        x_bars, y_bars = (
            np.abs(100 * (np.array(ends)[:, None] - mean)) for ends, mean in ((x_ends, x), (y_ends, y))
        )
        panel.errorbar(
            100 * x, 100 * y, y_bars, x_bars, color=mark["color"], capsize=2.5, linestyle="none"
        )
        panel.plot(
            100 * x, 100 * y, **mark, markersize=8, markeredgecolor="white", zorder=4,
            label=report.labels[name],
        )  # fmt: skip
    panel.set_xscale("log")
    panel.set_yscale("log")
    for axis in (panel.xaxis, panel.yaxis):
        _log(axis)
    panel.set_xlabel("acceleration error [% of the target's rms]")
    panel.set_ylabel("base shear error [% of the target's rms]")
    panel.set_title(f"Down and left is better: {report.verdict.group}", loc="left")
    _legend(figure, panel)
    return figure


def _hysteresis(report: Report) -> Figure | None:
    if not report.gathered.drift:
        return None
    i = [quake.name for quake in report.gathered.earthquakes].index(report.comparison.traced)
    figure = new_figure(6.4, 4.8)
    panel = figure.subplots()
    start, end = _strongest(report.gathered.targets[i])
    shown = [("target (real ground)", report.gathered.targets[i], TARGET)]
    shown += [(report.labels[n], report.gathered.runs[n][i], _line(report, n)) for n in report.shown]
    for label, curves, style in shown:
        at = _time(curves)
        inside = (at >= start) & (at <= end)
        drift, shear = curves.values["drift"][inside], curves.values["shear"][inside]
        panel.plot(drift, shear, **{**style, "label": label})
    panel.set_xlabel("drift of the first storey [mm]")
    panel.set_ylabel("base shear [kN]")
    panel.set_title(f"How the specimen yielded: {report.comparison.traced}", loc="left")
    _legend(figure, panel)
    return figure


def _robustness(report: Report) -> Figure | None:
    drawn = list(report.drawn.parameters.items())
    if not drawn or len(report.members) < 2:
        return None
    (first, x), (second, y) = (drawn + drawn)[:2]
    errors = {
        name: np.array([100 * report.comparison.episodes[name][i].base_shear_rms_error
                        for i in report.members])
        for name in report.shown
    }  # fmt: skip
    highest = float(np.quantile(np.concatenate(list(errors.values())), 0.95))
    columns = min(2, len(errors))
    rows = -(-len(errors) // columns)
    figure = new_figure(8.0, 0.6 + 3.0 * rows)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel in panels[len(errors) :]:
        panel.remove()
    points = None
    for panel, (name, error) in zip(panels, errors.items(), strict=False):
        panel.set_title(report.labels[name], loc="left")
        panel.set_xlabel(UNITS.get(first, first))
        if len(drawn) == 1:
            panel.plot(x[report.members], error, **_mark(report, name), markersize=5)
            panel.set_ylabel("base shear error [%]")
            continue
        points = panel.scatter(
            x[report.members], y[report.members], c=error, cmap="cividis_r", vmin=0.0, vmax=highest,
            s=15 + 130 * np.minimum(error / highest, 1.0), edgecolors="black", linewidths=0.5,
        )  # fmt: skip
        panel.set_ylabel(UNITS.get(second, second))
    if points is not None:
        figure.colorbar(points, ax=panels[: len(errors)].tolist(), label="base shear error [%]")
    return figure


def _learning(report: Report) -> Figure | None:
    if not report.learning:
        return None
    figure = new_figure(6.4, 4.0)
    panel = figure.subplots()
    for name, curve in report.learning.items():
        steps, cost = np.array(curve).T
        panel.plot(steps / 1e6, cost, **_line(report, name), marker=_mark(report, name)["marker"],
                   markersize=4)  # fmt: skip
    panel.axhline(1.0, color=GREY, linewidth=1.1, linestyle=(0, (7, 3)))
    panel.set_yscale("log")
    _log(panel.yaxis)
    panel.set_xlabel("control periods trained on [million]")
    panel.set_ylabel("cost / reference [-]")
    panel.set_title("Evaluations during training; dashed: as good as the reference", loc="left")
    _legend(figure, panel)
    return figure


_FIGURES: dict[str, Callable[[Report], Figure | None]] = {
    "trade_off": _trade_off,
    "traces": _traces,
    "spectra": _spectra,
    "hysteresis": _hysteresis,
    "transfer": _transfer,
    "robustness": _robustness,
    "learning": _learning,
}
