"""Figures of the nonlinear parts in separate tests; the numbers come from `bench`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from agents.figure_style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    SKY,
    VERMILLION,
    figure_style,
    new_figure,
    save_figure,
)  # fmt: skip
from agents.studies.components.bench import (
    EXPONENTS,
    LEVELS,
    ComponentSetup,
    StoreyLoop,
    TablePeriod,
    elastoplastic_energy,
    shaken_storey,
    steady_loop,
    valve_flow,
)
from shake_env.model.nonlinearity import Friction, ServoValve
from shake_env.model.parameters import FloatArray

LITRES_A_MINUTE = 60_000.0  # in a cubic metre a second
DUCTILITY = 5.0  # [-] drift over yield drift where the exponents are set side by side
PLAIN = 150.0  # [N] the level that a whole period is drawn of
CLOSE = 0.12  # [s] shown about a reversal of the table
OPENINGS = (1.0, 0.75, 0.5, 0.25)  # [-] spool over its limit

GUIDE: dict[str, Any] = {"color": GREY, "linewidth": 1.1, "linestyle": (0, (5, 2))}
# By lightness from grey to dark, and by dash.
FOUR: tuple[dict[str, Any], ...] = (
    {"color": GREY, "linewidth": 3.2, "alpha": 0.6},
    {"color": SKY, "linewidth": 1.8},
    {"color": VERMILLION, "linewidth": 1.6, "linestyle": (0, (5, 1.5))},
    {"color": BLACK, "linewidth": 1.3, "linestyle": (0, (1, 1))},
)


def yielding_figure(bench: ComponentSetup, loop: StoreyLoop, folder: str | PathLike[str]) -> list[Path]:
    """Draw the storey's loops: growing cycles, exponents, energy a cycle, and under a record."""
    folder = Path(folder)
    law = bench.yielding
    k, d_y, force_y = bench.stiffness, law.yield_drift, bench.yield_force
    reach = max(bench.ductilities) * d_y
    with figure_style():
        figure = new_figure(7.0, 5.9)
        (grown, knees), (energies, shaken) = figure.subplots(2, 2)
        grown.plot(1e3 * loop.drift, loop.force, color=BLUE, linewidth=1.5)
        elastic = np.array([0.0, 1.75 * d_y])
        grown.plot(1e3 * elastic, k * elastic, **GUIDE)
        beyond = np.array([d_y, reach])
        grown.plot(1e3 * beyond, force_y + law.stiffness_ratio * k * (beyond - d_y), **GUIDE)
        grown.plot(1e3 * d_y, force_y, "o", color=VERMILLION, markersize=6, zorder=3)
        grown.annotate("$k$", (1e3 * elastic[1], k * elastic[1]), (-5, -2), textcoords="offset points",
                       ha="right", va="top")  # fmt: skip
        grown.annotate(r"$\alpha\,k$", (1e3 * reach, force_y + law.stiffness_ratio * k * (reach - d_y)),
                       (0, 5), textcoords="offset points", ha="right")  # fmt: skip
        grown.annotate(
            f"yield point\n{1e3 * d_y:g} mm, {force_y:.0f} N", (1e3 * d_y, force_y), (0.03, 0.97),
            textcoords="axes fraction", va="top",
            arrowprops={"arrowstyle": "-", "color": VERMILLION, "shrinkB": 3},
        )  # fmt: skip
        grown.set_title(f"(a) cycles that grow, $n$ = {law.exponent:g}")
        grown.set_ylim(-1.75 * force_y, 1.75 * force_y)
        _loop_axes(grown)

        styles = (FOUR[1], FOUR[2], FOUR[3])
        at = np.array([DUCTILITY * d_y])
        limit = elastoplastic_energy(bench, law, at)[0]
        for exponent, style in zip(EXPONENTS, styles, strict=True):
            drift, force, energy = steady_loop(bench, replace(law, exponent=exponent), at)
            label = f"$n$ = {exponent:g}: {energy[0]:.1f} J"
            knees.plot(1e3 * drift[:, 0], force[:, 0], label=label, **style)
        knees.set_title(f"(b) exponents, at {DUCTILITY:g} times the yield drift")
        knees.set_ylim(-2.4 * force_y, 1.75 * force_y)
        knees.legend(loc="lower right", fontsize=8.5)
        _loop_axes(knees)

        amplitudes = d_y * np.linspace(0.25, max(bench.ductilities), 20)
        for exponent, style in zip(EXPONENTS, styles, strict=True):
            _, _, energy = steady_loop(bench, replace(law, exponent=exponent), amplitudes)
            energies.plot(1e3 * amplitudes, energy, **style)
        limits = elastoplastic_energy(bench, law, amplitudes)
        energies.plot(1e3 * amplitudes, limits, label=r"$4\,(1-\alpha)\,F_y\,(d-d_y)$",
                      color=GREY, linewidth=4.0, alpha=0.4, zorder=1)  # fmt: skip
        energies.axvline(1e3 * d_y, **GUIDE)
        energies.annotate(
            "$d_y$", (1e3 * d_y, 0.97 * limit), (4, 0), textcoords="offset points", va="top"
        )
        energies.set_title("(c) energy dissipated a cycle, $n$ as in (b)")
        energies.set_xlabel("drift amplitude $d$ [mm]")
        energies.set_ylabel("energy [J]")
        energies.set_ylim(bottom=-0.03 * limit)
        energies.set_xlim(0.0, 1.02e3 * amplitudes[-1])
        energies.legend(loc="lower right", fontsize=8.5)

        drift, shear = shaken_storey(bench)
        shaken.plot(1e3 * drift, shear, color=BLUE, linewidth=0.7)
        shaken.axhline(force_y, **GUIDE)
        shaken.axhline(-force_y, **GUIDE)
        shaken.annotate("$F_y$", (0.0, force_y), (4, 3), xycoords=("axes fraction", "data"),
                        textcoords="offset points")  # fmt: skip
        shaken.set_title("(d) the same storey, Napa College HNE")
        shaken.set_ylabel("base shear [N]")
        shaken.set_xlabel("drift [mm]")
        return save_figure(figure, folder, "component_yielding")


def _loop_axes(ax: Axes) -> None:
    ax.set_xlabel("drift [mm]")
    ax.set_ylabel("storey force [N]")


def friction_figure(
    bench: ComponentSetup, own: TablePeriod, levels: TablePeriod, folder: str | PathLike[str]
) -> list[Path]:
    """Draw the law, its loop on the moving table, and what it does to the table's acceleration.

    Parameters
    ----------
    bench
        Whose law.
    own
        The table with the bench's own law.
    levels
        Tables with Coulomb friction alone, at `LEVELS`.
    folder
        Where to.
    """
    folder = Path(folder)
    law = bench.friction
    static = law.coulomb if law.static is None else law.static
    with figure_style():
        figure = new_figure(7.2, 6.3)
        (curve, loop), (period, close) = figure.subplots(2, 2)
        velocity = np.linspace(-0.1, 0.1, 2001)
        rest: dict[str, float] = {
            "stribeck_velocity": law.stribeck_velocity, "smoothing_velocity": law.smoothing_velocity,
        }  # fmt: skip
        parts = (
            ("Coulomb", Friction(coulomb=law.coulomb, **rest), FOUR[1]),
            ("with Stribeck", Friction(coulomb=law.coulomb, static=static, **rest), FOUR[2]),
            ("and viscous", law, FOUR[3]),
        )
        band = 1e3 * law.smoothing_velocity
        curve.axvspan(-band, band, color=GREY, alpha=0.25, linewidth=0)
        for name, part, style in parts:
            curve.plot(1e3 * velocity, -part.force(velocity), label=name, **style)
        for value, name in ((law.coulomb, "$F_c$"), (static, "$F_s$")):
            curve.axhline(value, xmax=0.5, **GUIDE)
            curve.annotate(name, (-98.0, value), (0, 2), textcoords="offset points")
        curve.annotate(r"$\pm v_0$", (band, -0.9 * static), (4, 0), textcoords="offset points")
        curve.set_title("(a) the law, against the motion")
        curve.set_xlabel("table velocity [mm/s]")
        curve.set_ylabel("friction [N]")
        curve.legend(loc="lower right", fontsize=8.5, bbox_to_anchor=(1.0, 0.12))

        # Labels stand outside their loops, but for the smallest, which the bench's own law lies around.
        for i, level in enumerate(LEVELS):
            if level == 0.0:
                continue
            loop.plot(1e3 * _centred(levels.displacement[:, i]), -levels.friction[:, i], **FOUR[i])
            inside = level == law.coulomb
            loop.annotate(f"{level:.0f} N: {levels.energy[i]:.1f} J", (0.0, level),
                          (0, -3 if inside else 3), textcoords="offset points", ha="center",
                          va="top" if inside else "bottom")  # fmt: skip
        path, force = _centred(own.displacement[:, 0]), -own.friction[:, 0]
        loop.plot(1e3 * path, force, color=GREEN, linewidth=1.4)
        loop.annotate(
            f"all of (a): {own.energy[0]:.1f} J", (0.0, np.min(force)), (0.0, -0.7 * LEVELS[-1]),
            ha="center", va="center", arrowprops={"arrowstyle": "-", "color": GREEN, "shrinkB": 0},
        )  # fmt: skip
        loop.set_ylim(-1.1 * LEVELS[-1], 1.25 * LEVELS[-1])
        loop.set_title(f"(b) loops, {bench.frequency:g} Hz; energy a period")
        loop.set_xlabel("table displacement [mm]")
        loop.set_ylabel("friction [N]")

        _accelerations(period, levels, (0.0, PLAIN))
        for share in (0.0, 0.5):
            period.axvline(levels.reversal[LEVELS.index(PLAIN)] + share / bench.frequency, **GUIDE)
        period.set_xlim(0.0, 1.0 / bench.frequency)
        period.set_xlabel("time [s]")
        period.set_title("(c) dashed: the velocity reverses")

        _accelerations(close, levels, LEVELS, aligned=True)
        close.axvline(0.0, **GUIDE)
        close.set_xlim(-1e3 * CLOSE / 3.0, 1e3 * CLOSE)
        close.set_xlabel("time since the reversal [ms]")
        ringing = bench.plant.natural_frequencies[-1]
        close.set_title(f"(d) a spike, then the oil rings at {ringing:.1f} Hz")
        figure.legend(*close.get_legend_handles_labels(), loc="outside lower center", ncols=4,
                      title="Coulomb friction in (c) and (d)")  # fmt: skip
        return save_figure(figure, folder, "component_friction")


def _centred(values: FloatArray) -> FloatArray:
    return values - 0.5 * (np.max(values) + np.min(values))


def _accelerations(
    ax: Axes, tables: TablePeriod, shown: Sequence[float], *, aligned: bool = False
) -> None:
    for level, style, values, zero in zip(
        LEVELS, FOUR, tables.acceleration.T, tables.reversal, strict=True
    ):
        if level not in shown:
            continue
        time = 1e3 * (tables.time - zero) if aligned else tables.time
        ax.plot(time, values, label="none" if level == 0.0 else f"{level:.0f} N", **style)
    ax.set_ylabel("table acceleration [m/s²]")


def valve_figure(bench: ComponentSetup, folder: str | PathLike[str]) -> list[Path]:
    """Draw flow over load pressure, normalised and in shop units, and flow over spool."""
    folder = Path(folder)
    valve, supply, travel = bench.valve, bench.valve.supply_pressure, bench.valve.spool_limit
    rated = bench.plant.actuator.flow_gain * travel
    orifice = replace(valve, dead_band=0.0)
    linear = ServoValve()
    pressure = supply * np.concatenate([np.linspace(-1.25, 0.9, 400), np.linspace(0.9, 1.25, 400)])
    with figure_style():
        figure = new_figure(7.2, 6.5)
        (unit, shop), (spool_ax, null) = figure.subplots(2, 2)
        styles = (
            FOUR[3],
            FOUR[2],
            FOUR[1],
            {"color": GREEN, "linewidth": 1.6, "linestyle": (0, (6, 2, 1, 2))},
        )
        for opening, style in zip(OPENINGS, styles, strict=True):
            for side in (1.0, -1.0):
                position = np.full_like(pressure, side * opening * travel)
                flow = valve_flow(bench, orifice, position, pressure * side)
                straight = valve_flow(bench, linear, position, pressure * side)
                entry = {"label": f"{opening:.2f}"} if side > 0.0 else {}
                unit.plot(side * pressure / supply, flow / rated, **entry, **style)
                shop.plot(1e-6 * side * pressure, LITRES_A_MINUTE * flow, **style)
                unit.plot(
                    side * pressure / supply, straight / rated, color=GREY, linewidth=0.8, zorder=1
                )
                shop.plot(1e-6 * side * pressure, LITRES_A_MINUTE * straight, color=GREY,
                          linewidth=0.8, zorder=1)  # fmt: skip
        for ax, of, size in ((unit, 1.0, 1.0), (shop, 1e-6 * supply, LITRES_A_MINUTE * rated)):
            for side in (-1.0, 1.0):
                ax.axvline(side * of, **GUIDE)
            ax.set_xlim(-1.25 * of, 1.25 * of)
            ax.set_ylim(-1.6 * size, 1.6 * size)
        unit.annotate("$P_s$", (1.0, 1.45), (3, 0), textcoords="offset points")
        unit.annotate("$-P_s$", (-1.0, -1.5), (3, 0), textcoords="offset points")
        shop.annotate(f"{1e-6 * supply:g} MPa", (1e-6 * supply, 1.4 * LITRES_A_MINUTE * rated), (-4, 0),
                      textcoords="offset points", ha="right")  # fmt: skip
        unit.set_title("(a) normalised")
        unit.set_xlabel("load pressure over supply pressure [-]")
        unit.set_ylabel("flow over rated flow [-]")
        shop.set_title(f"(b) spool limit {1e6 * travel:g} µm, {LITRES_A_MINUTE * rated:.0f} l/min")
        shop.set_xlabel("load pressure [MPa]")
        shop.set_ylabel("flow [l/min]")

        spool = np.linspace(-1.6 * travel, 1.6 * travel, 1601)
        near = (
            np.linspace(-4.0 * valve.dead_band, 4.0 * valve.dead_band, 801) if valve.dead_band else spool
        )
        shares = (0.0, 0.5, -0.5)
        looks = ({"color": BLUE, "linewidth": 1.7}, FOUR[2], {"color": ORANGE, "linewidth": 1.6,
                                                            "linestyle": (0, (1, 1))})  # fmt: skip
        for ax, positions in ((spool_ax, spool), (null, near)):
            straight = valve_flow(bench, linear, positions, np.zeros_like(positions))
            ax.plot(1e6 * positions, LITRES_A_MINUTE * straight, color=GREY, linewidth=0.8)
            for share, look in zip(shares, looks, strict=True):
                flow = valve_flow(bench, valve, positions, np.full_like(positions, share * supply))
                label = "$p_l = 0$" if share == 0.0 else f"$p_l = {share:+g}\\,P_s$"
                ax.plot(1e6 * positions, LITRES_A_MINUTE * flow, label=label, **look)
            ax.set_xlabel("spool position [µm]")
            ax.set_ylabel("flow [l/min]")
        top = 1.25 * LITRES_A_MINUTE * rated
        spool_ax.vlines(1e6 * travel * np.array([-1.0, 1.0]), -top, 0.75 * top, **GUIDE)
        spool_ax.annotate("spool limit", (1e6 * travel, -top), (0, -3), textcoords="offset points",
                          ha="center", va="top")  # fmt: skip
        spool_ax.set_ylim(-1.25 * top, 1.55 * top)
        spool_ax.set_title("(c) flow over spool")
        spool_ax.legend(loc="upper left", fontsize=8.5)
        band = 1e6 * valve.dead_band
        null.axvspan(-band, band, color=GREY, alpha=0.25, linewidth=0)
        null.set_title(f"(d) dead band, ±{band:g} µm")
        handles, labels = unit.get_legend_handles_labels()
        reference = spool_ax.get_lines()[0]
        figure.legend(
            [*handles, reference], [*labels, "linear valve"], loc="outside lower center", ncols=5,
            title="spool over its limit in (a) and (b)",
        )  # fmt: skip
        return save_figure(figure, folder, "component_valve")
