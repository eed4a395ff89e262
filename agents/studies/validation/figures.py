"""Figures of the validation; the numbers come from its other modules."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from agents.figure_style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    SERIES,
    SKY,
    VERMILLION,
    figure_style,
    new_figure,
    save_figure,
)  # fmt: skip
from agents.studies.validation.ranges import RANGES, MotionCheck
from agents.studies.validation.reduction import ReducedLoop, error_curves
from agents.studies.validation.responses import SAMPLED, UNAWARE, Motion
from agents.studies.validation.tables import SHORT

WINDOW = 2.0  # [s] shown of the drawn record, about its peak
FREQUENCIES = np.logspace(-2.0, 6.0, 700)  # [Hz]

CUT: dict[str, Any] = {"color": VERMILLION, "linestyle": (0, (5, 2)), "linewidth": 1.6}
SETTLED: dict[str, Any] = {"color": BLUE, "linestyle": (0, (1, 1.2)), "linewidth": 1.9}
FULL: dict[str, Any] = {"color": GREY, "linewidth": 3.0, "alpha": 0.6}
BOUND: dict[str, Any] = {"color": BLACK, "linewidth": 1.1}

MARKERS = {
    SAMPLED: ("o", BLUE), UNAWARE: ("s", ORANGE), "continuous II": ("^", VERMILLION),
    "continuous III": ("v", GREEN),
}  # fmt: skip


def draw_hankel_values(loops: Mapping[str, ReducedLoop], folder: str | PathLike[str]) -> list[Path]:
    """Draw the Hankel singular values for four choices of outputs, and error and bound by order."""
    folder = Path(folder)
    with figure_style():
        figure = new_figure(8.0, 6.6)
        axes = figure.subplots(2, len(loops), sharex="col", sharey="row", squeeze=False)
        for j, (table, reduced) in enumerate(loops.items()):
            summary = reduced.summary
            upper, lower = axes[0, j], axes[1, j]
            for k, (name, values) in enumerate(summary["hankel_singular_values"].items()):
                style = {"color": (SKY, GREEN, BLACK, VERMILLION)[k], "marker": "osD^"[k]}
                order = np.arange(1, len(values) + 1)
                upper.semilogy(order, values, linewidth=0.9, markersize=5 - 0.5 * k, label=name, **style)
            slow, fast = _power(-summary["slowest_pole"]), _power(summary["fastest_pole"])
            upper.set_title(f"Table {table}: poles from {slow} to {fast} rad/s")
            orders = [row["order"] for row in summary["orders"]]
            bounds = [row["bound"] or np.nan for row in summary["orders"]]  # zero at the full order
            lower.semilogy(orders, bounds, label="bound", **BOUND)
            for key, style, marker in (("cut", CUT, "v"), ("settled", SETTLED, "o")):
                errors = [row[f"error_{key}"] for row in summary["orders"]]
                lower.semilogy(
                    orders, errors, marker=marker, markersize=4.5, label=f"error, {key}", **style
                )
            lower.set_xlabel("order")
            for ax in (upper, lower):
                ax.axvline(summary["order"] + 0.5, color=GREY, linewidth=0.9, linestyle="--")
            lower.text(summary["order"] + 0.6, 0.97, f"{summary['order']} kept", fontsize=8.5,
                       transform=lower.get_xaxis_transform(), va="top")  # fmt: skip
        axes[0, 0].set_ylabel("Hankel singular value [-]")
        axes[0, 0].set_ylim(bottom=1e-16)
        axes[1, 0].set_ylabel("largest gain of the difference\nover largest gain [-]")
        axes[0, 0].set_xlim(0.5, None)
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
        figure.legend(*axes[1, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
        return save_figure(figure, folder, "validation_hankel")


def _power(value: float) -> str:
    """Return a positive number as mantissa and power of ten."""
    exponent = int(np.floor(np.log10(value)))
    return f"${value / 10.0**exponent:.1f}\\cdot10^{{{exponent}}}$"


def draw_transfer(loops: Mapping[str, ReducedLoop], folder: str | PathLike[str]) -> list[Path]:
    """Draw both tracking errors of full and reduced loop over frequency, and their difference."""
    folder = Path(folder)
    with figure_style():
        figure = new_figure(8.0, 8.0)
        axes = figure.subplots(3, len(loops), sharex=True, sharey="row", squeeze=False)
        for j, (table, reduced) in enumerate(loops.items()):
            curves = error_curves(reduced, FREQUENCIES)
            bound = reduced.summary["error_bound"]
            for i in range(2):
                ax = axes[i, j]
                for model, style in (("full", FULL), ("cut", CUT), ("settled", SETTLED)):
                    ax.loglog(FREQUENCIES, curves[f"{model} {i}"], **style)
                ax.axhline(bound * reduced.loop.sizes[i], **BOUND)
            for model, style in (("cut", CUT), ("settled", SETTLED)):
                axes[2, j].loglog(FREQUENCIES, curves[f"difference {model}"], **style)
            axes[2, j].axhline(bound, **BOUND)
            axes[0, j].set_title(
                f"Table {table}: {reduced.loop.system.order} states to {reduced.summary['order']}"
            )
            axes[2, j].set_xlabel("frequency [Hz]")
        axes[0, 0].set_ylabel(r"$|\tilde G_1|$: $y_A-\tilde y_A$ [m/s²]")
        axes[1, 0].set_ylabel(r"$|\tilde G_2|$: $f_s-\tilde f_s$ [N]")
        axes[2, 0].set_ylabel("difference, all outputs [-]")
        axes[0, 0].set_xlim(FREQUENCIES[0], FREQUENCIES[-1])
        axes[0, 0].set_ylim(1e-9, None)
        axes[1, 0].set_ylim(1e-10, None)
        axes[2, 0].set_ylim(1e-10, None)
        handles = [
            Line2D([], [], label="full", **FULL),
            Line2D([], [], label="reduced, cut", **CUT),
            Line2D([], [], label="reduced, settled", **SETTLED),
            Line2D([], [], label="bound on the difference", **BOUND),
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=4)
        return save_figure(figure, folder, "validation_transfer")


def draw_ranges(checks: Sequence[MotionCheck], folder: str | PathLike[str]) -> list[Path]:
    """Draw every peak over its limit, by quantity, controller and group of motions."""
    folder = Path(folder)
    names = list(dict.fromkeys(check.group for check in checks))
    with figure_style():
        figure = new_figure(8.0, 1.2 + 2.3 * len(names))
        axes = figure.subplots(len(names), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for ax, group in zip(axes, names, strict=True):
            for k, (controller, (marker, color)) in enumerate(MARKERS.items()):
                of = [
                    check for check in checks if (check.group, check.controller) == (group, controller)
                ]
                for i in range(len(RANGES)):
                    values = [check.checks[i].peak / check.checks[i].limit for check in of]
                    x = np.full(len(values), i + 0.17 * (k - 1.5))
                    ax.semilogy(x, values, marker, color=color, markersize=4.5, markerfacecolor="none")
            for i, known in enumerate(RANGES):
                ax.plot([i - 0.4, i + 0.4], 2 * [known.rated / known.limit], color=GREY, linestyle="--")
            ax.axhline(1.0, color=BLACK, linewidth=1.1)
            ax.set_title(group)
            ax.set_ylabel("peak over limit [-]")
            ax.grid(visible=False, axis="x")
        axes[-1].set_xticks(np.arange(len(RANGES)), [SHORT[known.quantity] for known in RANGES])
        handles = [
            Line2D([], [], linestyle="", marker=marker, color=color, markerfacecolor="none", label=name)
            for name, (marker, color) in MARKERS.items()
        ]
        handles.append(Line2D([], [], color=BLACK, linewidth=1.1, label="limit"))
        handles.append(Line2D([], [], color=GREY, linestyle="--", label="rated"))
        figure.legend(handles=handles, loc="outside lower center", ncols=6, columnspacing=1.2)
        return save_figure(figure, folder, "validation_ranges")


ROWS: tuple[tuple[str, str, float], ...] = (
    ("table_acceleration", "acceleration\n[m/s²]", 1.0),
    ("base_shear", "base shear\n[kN]", 1e-3),
    ("load_pressure", "pressure\n[MPa]", 1e-6),
    ("table_displacement", "position\n[mm]", 1e3),
    ("current", "current\n[mA]", 1e3),
)
TARGETS = {"table_acceleration": "target_acceleration", "base_shear": "reference_base_shear"}


def draw_transients(name: str, motions: Mapping[str, Motion], folder: str | PathLike[str]) -> list[Path]:
    """Draw one motion under the controllers: the table's outputs and states about the strongest part."""
    folder = Path(folder)
    styles = {
        "continuous II": SERIES[0],
        "continuous II, reduced": {"color": BLACK, "linestyle": (0, (1, 3.5)), "linewidth": 2.0},
        SAMPLED: {"color": BLUE, "linewidth": 1.3},
        UNAWARE: {**SERIES[1], "linewidth": 1.3},
    }
    first = motions[SAMPLED]
    centre = first.time[int(np.argmax(np.abs(first.signals["reference_base_shear"])))]
    start = float(np.clip(centre - 0.5 * WINDOW, 0.0, max(first.time[-1] - WINDOW, 0.0)))
    with figure_style():
        figure = new_figure(6.6, 6.2)
        axes = figure.subplots(len(ROWS), 1, sharex=True)
        for ax, (signal, label, factor) in zip(axes, ROWS, strict=True):
            if signal in TARGETS:
                inside = _inside(first, start)
                ax.plot(first.time[inside], factor * first.signals[TARGETS[signal]][inside],
                        color=BLACK, linewidth=5.5, alpha=0.2)  # fmt: skip
            for controller, style in styles.items():
                motion = motions[controller]
                if signal not in motion.signals:
                    continue
                inside = _inside(motion, start)
                ax.plot(motion.time[inside], factor * motion.signals[signal][inside], **style)
            ax.set_ylabel(label)
        axes[-1].set_xlabel("time [s]")
        axes[-1].set_xlim(start, start + WINDOW)
        axes[0].set_title(name)
        handles = [Line2D([], [], color=BLACK, linewidth=5.5, alpha=0.2, label="target, real ground")]
        handles += [Line2D([], [], label=controller, **style) for controller, style in styles.items()]
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
        return save_figure(figure, folder, "validation_transients")


def _inside(motion: Motion, start: float) -> Any:
    return (motion.time >= start) & (motion.time <= start + WINDOW)
