"""What the page's script draws, as plain JSON values."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.evaluation.fidelity import PERIODS, TOLERANCE
from agents.figure_style import PLOTLY
from agents.reporting.report.contents import Report
from agents.reporting.report.traces import pack_all

UNITS = {
    "mass_ratio": "specimen mass over table mass [-]",
    "storey_frequency": "storey frequency [Hz]",
    "damping_ratio": "damping ratio [-]",
    "bulk_modulus": "bulk modulus [Pa]",
    "leakage": "leakage [m³/(Pa s)]",
    "valve_time_constant": "valve time constant [s]",
    "valve_gain": "valve gain [m/A]",
    "coulomb_friction": "Coulomb friction [N]",
    "delay": "loop delay [physics steps]",
}


def page_data(report: Report) -> dict[str, Any]:
    """Return everything that the script of the report's page reads, NaN as null."""
    gathered, comparison = report.gathered, report.comparison
    names = report.controllers
    packed = pack_all(
        [
            [gathered.targets[i], *(gathered.runs[name][i] for name in names)]
            for i in range(len(gathered.earthquakes))
        ],
        comparison.groups,
    )
    quakes = []
    for i, (target, *runs) in enumerate(packed):
        quakes.append(
            {
                "name": gathered.earthquakes[i].name,
                "group": comparison.groups[i],
                "target": target,
                "runs": runs,
                "spectra": [_short(gathered.target_spectra[i])]
                + [_short(gathered.spectra[name][i]) for name in names],
                "errors": [
                    [
                        _short_number(100 * row.acceleration_rms_error),
                        _short_number(100 * row.base_shear_rms_error),
                        row.broken_limit,
                    ]
                    for row in (comparison.episodes[name][i] for name in names)
                ],
            }
        )
    return {
        "controllers": [
            {"label": report.labels[name], "shown": name in report.shown, **PLOTLY[k % len(PLOTLY)]}
            for k, name in enumerate(names)
        ],
        "channels": [vars(channel) for channel in report.channels],
        "earthquakes": quakes,
        "first": [quake.name for quake in gathered.earthquakes].index(comparison.traced),
        "group": report.verdict.group,
        "periods": _short(PERIODS),
        "tolerance": TOLERANCE,
        "ratios": [_short(spectral_ratio(report, name)) for name in names],
        "transfer": _transfer(report),
        "tradeOff": {
            "means": [
                [_short(np.array(pair)) for pair in vars(report.trade_off[n]).values()] for n in names
            ],
            "each": [
                [
                    [_short_number(row.acceleration_rms_error), _short_number(row.base_shear_rms_error)]
                    for row in (comparison.episodes[name][i] for i in report.members)
                ]
                for name in names
            ],
            "frontier": [_short(np.array(point)) for point in report.frontier],
        },
        "hysteresis": gathered.drift,
        "robustness": _robustness(report),
        "learning": [
            {
                "controller": names.index(name),
                "steps": [steps for steps, _ in curve],
                "cost": [_short_number(cost) for _, cost in curve],
            }
            for name, curve in report.learning.items()
        ],
    }


def spectral_ratio(report: Report, name: str) -> NDArray[np.float64]:
    """Return a report's ratio of response spectra, achieved over target (periods,), geometric mean.

    NaN for a table that stands still.
    """
    gathered = report.gathered
    wanted = np.array([gathered.target_spectra[i] for i in report.members])
    achieved = np.array([gathered.spectra[name][i] for i in report.members])
    known = (wanted > 0.0) & (achieved > 0.0)
    if not known.all():
        return np.full(len(PERIODS), np.nan)
    ratio: NDArray[np.float64] = np.exp(np.mean(np.log(achieved / wanted), axis=0))
    return ratio


def _transfer(report: Report) -> dict[str, Any] | None:
    estimates = report.gathered.transfer
    if not all(estimate.known for estimate in estimates.values()):
        return None
    curves = [estimates[name].response() for name in report.controllers]
    return {
        "frequency": [_short(frequency) for frequency, _, _ in curves],
        "acceleration": [_short(acceleration) for _, acceleration, _ in curves],
        "shear": [_short(shear) for _, _, shear in curves],
    }


def _robustness(report: Report) -> dict[str, Any] | None:
    drawn = report.drawn.parameters
    if not drawn or len(report.members) < 2:
        return None
    return {
        "parameters": [
            {"label": UNITS.get(name, name), "values": _short(values[report.members])}
            for name, values in drawn.items()
        ],
        "error": [
            [
                _short_number(100 * report.comparison.episodes[name][i].base_shear_rms_error)
                for i in report.members
            ]
            for name in report.controllers
        ],
    }


def _short(values: NDArray[np.float64]) -> list[float | None]:
    return [_short_number(value) for value in values.tolist()]


def _short_number(value: float) -> float | None:
    return float(f"{value:.4g}") if np.isfinite(value) else None
