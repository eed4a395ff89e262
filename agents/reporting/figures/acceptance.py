"""Required and test response spectra as a figure, with the tolerance below and the bound above."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import StrMethodFormatter
from numpy.typing import NDArray

from agents.acceptance.clauses import Acceptance
from agents.figure_style import BLACK, CONTROLLERS, GREY, figure_style, new_figure, save_figure

FloatArray = NDArray[np.float64]


def draw_acceptance(result: Acceptance, folder: str | PathLike[str]) -> list[Path]:
    """Draw the spectra into a folder and return the paths written."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    spectra = {f"{name} (TRS)": row for name, row in zip(result.names, result.trs, strict=True)}
    title = f"{result.required.name}: {'pass' if result.passed else 'FAIL'}"
    with figure_style():
        return save_figure(acceptance_figure(result, spectra, title), folder, "acceptance")


def acceptance_figure(result: Acceptance, spectra: Mapping[str, FloatArray], title: str) -> Figure:
    """Return the figure of test spectra beside the required one.

    Parameters
    ----------
    result
        Gives the required spectrum, the frequencies and the tolerances.
    spectra
        (ordinates,) each [m/s^2], by label.
    title
        Of the figure.
    """
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
        for i, (label, ordinates) in enumerate(spectra.items()):
            style = CONTROLLERS[i % len(CONTROLLERS)]
            panel.plot(result.frequency, ordinates, markersize=3, linewidth=1.0, label=label, **style)
        panel.set_xscale("log")
        panel.set_yscale("log")
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axis.set_minor_formatter(StrMethodFormatter("{x:g}"))
        panel.set_xlabel(f"frequency [Hz], damping {100 * result.required.damping:g} %")
        panel.set_ylabel("response [m/s²]")
        panel.set_title(title)
        panel.legend()
    return figure
