"""Required and test response spectra as a figure, with the tolerance below and the bound above."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

from matplotlib.ticker import StrMethodFormatter

from agents.acceptance.clauses import Acceptance
from agents.figure_style import BLACK, CONTROLLERS, GREY, figure_style, new_figure, save_figure


def draw_acceptance(result: Acceptance, folder: str | PathLike[str]) -> list[Path]:
    """Draw the spectra into a folder and return the paths written."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    rules = result.rules
    with figure_style():
        figure = new_figure(6.0, 3.8)
        panel = figure.subplots()
        panel.plot(result.frequency, result.rrs, color=BLACK, linewidth=1.8, label="required (RRS)")
        band: dict[str, Any] = {"color": GREY, "linewidth": 1.0, "linestyle": (0, (4, 2))}
        panel.plot(
            result.frequency, rules.tolerated * result.rrs, label=f"{rules.tolerated:g} RRS", **band
        )
        if rules.upper is not None:
            panel.plot(result.frequency, rules.upper * result.rrs, label=f"{rules.upper:g} RRS", **band)
        for i, (name, ordinates) in enumerate(zip(result.names, result.trs, strict=True)):
            style = CONTROLLERS[i % len(CONTROLLERS)]
            label = f"{name} (TRS)"
            panel.plot(result.frequency, ordinates, markersize=3, linewidth=1.0, label=label, **style)
        panel.set_xscale("log")
        panel.set_yscale("log")
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axis.set_minor_formatter(StrMethodFormatter("{x:g}"))
        panel.set_xlabel(f"frequency [Hz], damping {100 * result.required.damping:g} %")
        panel.set_ylabel("response [m/s²]")
        panel.set_title(f"{result.required.name}: {'pass' if result.passed else 'FAIL'}")
        panel.legend()
        return save_figure(figure, folder, "acceptance")
