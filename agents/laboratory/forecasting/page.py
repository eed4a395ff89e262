"""The page of a forecast: bands over time, and one table."""

from __future__ import annotations

import os
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from agents.figure_style import CONTROLLERS, figure_style, new_figure, save_figure
from agents.laboratory.forecasting.forecast import Advice, Forecast
from agents.laboratory.forecasting.quantities import UNITS
from shake_env.files import write_text

# Quantity, heading of its column, and the factor to the unit there.
COLUMNS = (
    ("base_shear_error", "base-shear error [%]", 100.0),
    ("drift_ratio", "peak drift / reference", 1.0),
    ("energy_ratio", "energy / reference", 1.0),
    ("peak_displacement", "stroke [mm]", 1e3),
    ("peak_velocity", "velocity [m/s]", 1.0),
    ("peak_pressure", "pressure [MPa]", 1e-6),
    ("peak_current", "current [mA]", 1e3),
)
_STYLE = (
    "body{font:15px/1.45 sans-serif;max-width:70em;margin:2em auto;padding:0 1em}"
    "table{border-collapse:collapse}"
    "td,th{padding:.25em .6em;border-bottom:1px solid #ccc;text-align:right}"
    "td:first-child,th:first-child{text-align:left}img{max-width:100%}"
)


def forecast_cells(forecast: Forecast) -> list[str]:
    """Return the cells of a forecast's row."""
    row = [forecast.controller, f"{forecast.amplitude:g}"]
    for quantity, _, factor in COLUMNS:
        low, middle, high = (factor * value for value in forecast.interval(quantity))
        row.append(f"{middle:.3g} ({low:.3g} to {high:.3g})")
    coupled = "yes" if forecast.coupling.must_model else "no"
    return [*row, f"{forecast.limit_probability:.3f}", coupled]


def forecast_headings() -> list[str]:
    """Return the headings of the table."""
    titles = [title for _, title, _ in COLUMNS]
    return ["controller", "amplitude", *titles, "P(limit)", "model the coupled system"]


def write_page(
    forecasts: Sequence[Forecast], chosen: Advice, title: str, folder: str | os.PathLike[str]
) -> list[Path]:
    """Write the page and its figure; return the files."""
    folder = Path(folder)
    figures = draw_bands(forecasts, folder)
    interval = f"{100 * forecasts[0].probability:g} %"
    number = len(forecasts[0].broken)
    rows = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in forecast_cells(each)) + "</tr>\n"
        for each in forecasts
    )
    head = "".join(f"<th>{escape(name)}</th>" for name in forecast_headings())
    notes = "".join(f"<li>{_test(each)}: {escape(str(each.coupling))}.</li>" for each in forecasts)
    spectra = "".join(
        f"<li>{_test(each)}: {escape(', '.join(_ordinates(each)))}</li>" for each in forecasts
    )
    page = (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{escape(title)}</title>'
        f"<style>{_STYLE}</style><h1>{escape(title)}</h1>"
        f"<p>Use <b>{escape(chosen.controller)}</b>: {escape(chosen.reason)}.</p>"
        f"<p>Median, and interval that holds {interval} of {number} samples of the belief.</p>"
        f"<table><tr>{head}</tr>\n{rows}</table>"
        f'<p><img src="{figures[1].name}" alt="Bands of base shear and drift over time"></p>'
        f"<h2>Response-spectrum ordinates [m/s²]</h2><ul>{spectra}</ul>"
        f"<h2>Analysis of the data</h2><ul>{notes}</ul></html>\n"
    )
    path = folder / "forecast.html"
    write_text(path, page)
    return [path, *figures]


def _test(forecast: Forecast) -> str:
    return f"{escape(forecast.controller)}, amplitude {forecast.amplitude:g}"


def _ordinates(forecast: Forecast) -> list[str]:
    ordinates = []
    for name in UNITS:
        if name.startswith("spectrum_"):
            low, middle, high = forecast.interval(name)
            ordinates.append(
                f"{name.removeprefix('spectrum_')} s {middle:.3g} ({low:.3g} to {high:.3g})"
            )
    return ordinates


def draw_bands(forecasts: Sequence[Forecast], folder: str | os.PathLike[str]) -> list[Path]:
    """Draw base shear and drift over time with their bands, at the largest amplitude."""
    folder = Path(folder)
    largest = max(each.amplitude for each in forecasts)
    shown = [each for each in forecasts if each.amplitude == largest][: len(CONTROLLERS)]
    with figure_style():
        figure = new_figure(9.0, 3.0 * len(shown) + 0.6)
        panels = figure.subplots(len(shown), 2, squeeze=False, sharex=True)
        for (left, right), each in zip(panels, shown, strict=True):
            outcomes = each.outcomes
            reference = each.band(outcomes.reference)[1]
            _band(left, outcomes.time, 1e-3 * each.band(outcomes.base_shear), "predicted")
            left.plot(outcomes.time, 1e-3 * reference, color="black", linewidth=0.8, label="reference")
            left.set_ylabel("base shear [kN]")
            left.set_title(f"{each.controller}, amplitude {each.amplitude:g}", loc="left")
            _band(right, outcomes.time, 1e3 * each.band(outcomes.drift), "predicted")
            right.set_ylabel("first storey's drift [mm]")
        panels[0][0].legend()
        for panel in panels[-1]:
            panel.set_xlabel("time [s]")
        return save_figure(figure, folder, "forecast")


def _band(panel: Any, time: Any, band: Any, label: str) -> None:
    style = {**CONTROLLERS[0], "marker": "", "linewidth": 1.0}
    panel.fill_between(time, band[0], band[2], color=style["color"], alpha=0.3, linewidth=0.0)
    panel.plot(time, band[1], label=label, **style)


def forecast_to_json(forecast: Forecast) -> dict[str, Any]:
    """Return a forecast as plain JSON values: low end, median and high end of each quantity."""
    quantities = [*UNITS, *forecast.outcomes.measured]
    return {
        "controller": forecast.controller,
        "amplitude": forecast.amplitude,
        "samples": len(forecast.broken),
        "probability": forecast.probability,
        "limit_probability": forecast.limit_probability,
        "reached_a_limit": int(np.sum(forecast.broken)),
        "intervals": {name: list(forecast.interval(name)) for name in quantities},
        "coupling": {
            **{k: float(v) for k, v in vars(forecast.coupling).items() if k != "must_model"},
            "must_model": bool(forecast.coupling.must_model),
        },
    }
