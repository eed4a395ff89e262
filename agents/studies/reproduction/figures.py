"""Figures of the reproduction; the numbers come from `agents.studies.reproduction.tables`."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from agents.figure_style import (
    BLACK,
    BLUE,
    CORRECTED,
    GREY,
    PRINTED,
    SERIES,
    figure_style,
    new_figure,
    save_figure,
)
from agents.studies.reproduction.tables import (
    MASS_RATIOS,
    MODELS,
    PUBLISHED,
    STORIES,
    WEIGHTS,
    table_plant,
)
from baselines.analysis.h2 import tracking_response
from baselines.lqr.continuous import continuous_lqr
from shake_env.model.parameters import FloatArray, ModelEquations

MODEL_STYLE = {"as_printed": PRINTED, "corrected": CORRECTED}
MODEL_NAME = {"as_printed": "as printed", "corrected": "corrected"}
FIGURE_NUMBER = {"II": 3, "III": 4}
LOWEST_SHOWN = 1e-8  # what lies lower is rounding: the printed model's force error in Figure 4
AIM = {"II": "acceleration tracking", "III": "force tracking"}


def transfer_functions(table: str, frequencies: FloatArray, folder: str | PathLike[str]) -> list[Path]:
    """Draw the paper's Figure 3 (Table II) or 4 (Table III), nine cases, both models."""
    folder = Path(folder)
    q_1, q_2 = WEIGHTS[table]
    dashes: tuple[Any, Any] = ("-", (0, (4, 1.5)))
    with figure_style():
        figure = new_figure(8.0, 7.6)
        axes = figure.subplots(3, 3, sharex=True, sharey=True)
        highest = dict.fromkeys(((model, output) for model in MODELS for output in (0, 1)), 0.0)
        for i, mass_ratio in enumerate(MASS_RATIOS):
            for j, stories in enumerate(STORIES):
                ax = axes[i, j]
                for model in MODELS:
                    plant = table_plant(stories, mass_ratio, ModelEquations.named(model))
                    gain = continuous_lqr(plant, q_1=q_1, q_2=q_2).gain
                    response = np.abs(tracking_response(plant, gain, 2.0 * np.pi * frequencies))
                    for output in (0, 1):
                        peak = float(np.max(response[:, output]))
                        highest[model, output] = max(highest[model, output], peak)
                        ax.loglog(
                            frequencies,
                            response[:, output],
                            linestyle=dashes[output],
                            **MODEL_STYLE[model],
                        )
                ax.set_title(f"$n_m$ = {stories}, $\\mu$ = {mass_ratio}")
        axes[0, 0].set_ylim(LOWEST_SHOWN, 3.0 * max(highest.values()))
        axes[0, 0].set_xlim(frequencies[0], frequencies[-1])
        for ax in axes[-1]:
            ax.set_xlabel("frequency [Hz]")
        for ax in axes[:, 0]:
            ax.set_ylabel("magnitude per unit $w$")
        handles = [
            Line2D(
                [], [], linestyle=dashes[output], label=f"{symbol}, {MODEL_NAME[model]}"
                + ("" if highest[model, output] > LOWEST_SHOWN else " (below the axis)"),
                **MODEL_STYLE[model],
            )
            for model in MODELS
            for output, symbol in enumerate(
                (r"$|\tilde G_1|$: $y_A-\tilde y_A$ [m/s²]", r"$|\tilde G_2|$: $f_s-\tilde f_s$ [N]")
            )
        ]  # fmt: skip
        figure.legend(handles=handles, loc="outside lower center", ncols=2)
        figure.suptitle(
            f"Figure {FIGURE_NUMBER[table]} of the paper: {AIM[table]}, "
            f"$q_1$ = {q_1:g}, $q_2$ = {q_2:g}, no added weight"
        )
        return save_figure(figure, folder, f"figure_{FIGURE_NUMBER[table]}")


def added_weight(
    table: str, weights: FloatArray, sweeps: Sequence[dict[str, Any]], folder: str | PathLike[str]
) -> list[Path]:
    """Draw both norms over the added weight with the published cells laid over them."""
    folder = Path(folder)
    with figure_style():
        figure = new_figure(8.0, 9.6)
        axes = figure.subplots(4, 3, sharex=True, sharey="row")
        for row in sweeps:
            if row["table"] != table:
                continue
            j, k = STORIES.index(row["stories"]), MASS_RATIOS.index(row["mass_ratio"])
            first = 2 * MODELS.index(row["model"])
            for output, key in enumerate(("acceleration", "base_shear")):
                ax, level = (
                    axes[first + output, j],
                    PUBLISHED[table][row["stories"], row["mass_ratio"]][output],
                )
                values = np.array(row[key])
                ax.plot(weights, np.where(values > 0.0, values, np.nan), **SERIES[k])
                ax.axhline(
                    level, color=SERIES[k]["color"], linewidth=0.9, linestyle=SERIES[k]["linestyle"]
                )
                crossings = row["explains"][key]
                ax.plot(
                    crossings, np.full(len(crossings), level), "o", markersize=6.5, markeredgewidth=1.6,
                    markerfacecolor="white", markeredgecolor=SERIES[k]["color"], zorder=4,
                )  # fmt: skip
        for i, model in enumerate(MODELS):
            for output, label in enumerate(
                (r"$\|\tilde G_1\|^2$ [(m/s²)²]", r"$\|\tilde G_2\|^2$ [N²]")
            ):
                ax = axes[2 * i + output, 0]
                ax.set_ylabel(f"{MODEL_NAME[model]}\n{label}")
                if output == 1:
                    ax.set_yscale("log")
                    ax.set_ylim(bottom=max(ax.get_ylim()[0], 1e-5))
                elif ax.get_ylim()[0] < 1.0:
                    ax.set_yscale("log")
                    ax.set_ylim(top=40.0)
        for j, stories in enumerate(STORIES):
            axes[0, j].set_title(f"$n_m$ = {stories}")
            axes[-1, j].set_xlabel(r"added weight $\lambda$ [SI]")
            axes[-1, j].set_xscale("log")
            axes[-1, j].set_xticks(10.0 ** np.arange(-12, 2, 3))
        handles: list[Line2D] = [
            Line2D([], [], label=f"$\\mu$ = {mass_ratio}", **SERIES[k])
            for k, mass_ratio in enumerate(MASS_RATIOS)
        ]
        handles.append(Line2D([], [], color=GREY, linewidth=0.9, label="published (thin, same dash)"))
        handles.append(
            Line2D([], [], linestyle="", marker="o", markersize=6.5, markerfacecolor="white",
                   markeredgecolor=GREY, markeredgewidth=1.6, label=r"$\lambda$ that gives it")
        )  # fmt: skip
        figure.legend(handles=handles, loc="outside lower center", ncols=5)
        figure.suptitle(f"Table {table} ({AIM[table]}): which added weight explains which cell")
        return save_figure(figure, folder, f"added_weight_table_{table}")


def trade_off(
    curves: dict[int, list[dict[str, float]]], mass_ratio: float, folder: str | PathLike[str]
) -> list[Path]:
    """Draw force error over acceleration error of the 200 Hz LQR as the two weights are swept."""
    folder = Path(folder)
    with figure_style():
        figure = new_figure(6.4, 4.4)
        ax = figure.subplots()
        for k, (stories, rows) in enumerate(curves.items()):
            style = (CORRECTED | {"linestyle": "-"}, SERIES[1])[k]
            acceleration = [100.0 * row["acceleration_error"] for row in rows]
            shear = [100.0 * row["base_shear_error"] for row in rows]
            ax.plot(acceleration, shear, label=f"$n_m$ = {stories}", **style)
            for row in rows:
                pair = (row["acceleration_weight"], row["force_weight"])
                if pair in ((1.0, 0.0), (1.0, 1.0), (0.0, 1.0)):
                    x, y = 100.0 * row["acceleration_error"], 100.0 * row["base_shear_error"]
                    ax.plot(x, y, "o", color=style["color"], markersize=6)
                    if k == 0:
                        last = pair == (0.0, 1.0)
                        ax.annotate(
                            f"$w_a:w_f$ = {pair[0]:g}:{pair[1]:g}",
                            (x, y),
                            xytext=(0 if last else 8, 8),
                            textcoords="offset points",
                            fontsize=8.5,
                            ha="center" if last else "left",
                        )
        ax.set_xlabel("acceleration error, rms relative to the target's [%]")
        ax.set_ylabel("base-shear error, rms relative to the reference's [%]")
        ax.set_ylim(bottom=0.0)
        ax.margins(x=0.12)
        ax.legend(loc="upper right")
        ax.set_title(f"200 Hz LQR, corrected model, $\\mu$ = {mass_ratio}")
        return save_figure(figure, folder, "trade_off")


def unaware_design(
    rows: dict[int, dict[str, list[dict[str, float]]]], folder: str | PathLike[str]
) -> list[Path]:
    """Draw both errors over the specimen's mass for a design without and one with knowledge of it."""
    folder = Path(folder)
    with figure_style():
        figure = new_figure(7.2, 3.6)
        axes = figure.subplots(1, 2, sharey=True)
        for j, (stories, designs) in enumerate(rows.items()):
            ax = axes[j]
            for design, color, knows in (("without", BLACK, "without it"), ("with", BLUE, "knowing it")):
                mu = [row["mass_ratio"] for row in designs[design]]
                for key, dash, what in (
                    ("acceleration_error", "-", "acceleration"),
                    ("base_shear_error", (0, (4, 1.5)), "base shear"),
                ):
                    values = [100.0 * row[key] for row in designs[design]]
                    ax.plot(mu, values, "o", color=color, markersize=4)
                    ax.plot(mu, values, color=color, linestyle=dash, label=f"{what}, design {knows}")
            ax.set_title(f"$n_m$ = {stories}")
            ax.set_xlabel(r"specimen mass over table mass $\mu$ [-]")
        axes[0].set_ylabel("rms error relative to\nthe target's rms [%]")
        axes[0].set_ylim(bottom=0.0)
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=2)
        return save_figure(figure, folder, "unaware_design")
