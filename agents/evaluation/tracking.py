"""How closely a table followed its target, in the usual figures of a table test."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.signal import welch

from agents.evaluation.fidelity import delay
from shake_env.model.plant import TABLE_DISPLACEMENT, TABLE_VELOCITY
from shake_env.simulation.trajectory import Trajectory

FloatArray = NDArray[np.float64]

BANDS: tuple[tuple[float, float], ...] = (
    (0.5, 1.0), (1.0, 2.0), (2.0, 4.0), (4.0, 8.0), (8.0, 16.0), (16.0, 32.0),
)  # fmt: skip  # [Hz] octaves
SEGMENT = 8.0  # [s] of a spectrum, so that the lowest octave has four lines


@dataclass(frozen=True)
class TrackingFigures:
    """One test against its target; NaN where the target has nothing of a quantity.

    Peak errors are relative to the target's peak, rms errors to its rms. Velocity and displacement of
    the target are its integrals from rest, held against the table's at the ends of control periods.
    """

    acceleration_peak: float  # [-]
    acceleration_rms: float  # [-]
    velocity_peak: float  # [-]
    velocity_rms: float  # [-]
    displacement_peak: float  # [-]
    displacement_rms: float  # [-]
    delay: float  # [s] of the table's acceleration behind the target's, by cross-correlation
    error_energy: float  # [-] integral of the squared acceleration error over that of the target
    band_ratios: tuple[float, ...]  # (bands,) [-] rms of table over target in each of `BANDS`

    def to_json(self) -> dict[str, Any]:
        """Return the figures as plain JSON values; None for NaN."""
        plain = {name: _known(value) for name, value in vars(self).items() if name != "band_ratios"}
        return plain | {"band_ratios": [_known(value) for value in self.band_ratios]}


def tracking_figures(trajectory: Trajectory, physics_step: float) -> TrackingFigures:
    """Return the tracking figures of a test: peaks, rms, delay, bands, energy.

    Parameters
    ----------
    trajectory
        Of one table.
    physics_step
        Step of its accelerations [s].
    """
    target, achieved = trajectory.target_acceleration, trajectory.table_acceleration
    velocity = cumulative_trapezoid(target, dx=physics_step, initial=0.0)
    displacement = cumulative_trapezoid(velocity, dx=physics_step, initial=0.0)
    substeps = len(target) // len(trajectory.current)
    ends = slice(substeps - 1, None, substeps)
    pairs = (
        (achieved, target),
        (trajectory.state[:, TABLE_VELOCITY], velocity[ends]),
        (trajectory.state[:, TABLE_DISPLACEMENT], displacement[ends]),
    )
    acceleration, speed, place = (_errors(own, wanted) for own, wanted in pairs)
    return TrackingFigures(
        acceleration_peak=acceleration[0],
        acceleration_rms=acceleration[1],
        velocity_peak=speed[0],
        velocity_rms=speed[1],
        displacement_peak=place[0],
        displacement_rms=place[1],
        delay=delay(target, achieved, physics_step),
        error_energy=_over(float(np.sum((achieved - target) ** 2)), float(np.sum(target**2))),
        band_ratios=band_ratios(achieved, target, physics_step),
    )


def band_ratios(achieved: FloatArray, target: FloatArray, step: float) -> tuple[float, ...]:
    """Return the rms of `achieved` over that of `target`, (samples,) each, in every one of `BANDS`.

    NaN in a band that the step or the length does not resolve.
    """
    length = min(len(target), round(SEGMENT / step))
    f, wanted = welch(target, 1.0 / step, nperseg=length)
    _, spectrum = welch(achieved, 1.0 / step, nperseg=length)
    ratios = []
    for low, high in BANDS:
        inside = (f >= low) & (f < high) & (f < 0.5 / step)
        ratios.append(_over(float(np.sum(spectrum[inside])), float(np.sum(wanted[inside]))) ** 0.5)
    return tuple(ratios)


def _errors(own: FloatArray, wanted: FloatArray) -> tuple[float, float]:
    """Return peak and rms error of a signal over the peak and rms of the wanted one."""
    error = own - wanted
    peak = _over(float(np.max(np.abs(error))), float(np.max(np.abs(wanted))))
    return peak, _over(float(np.mean(error**2)), float(np.mean(wanted**2))) ** 0.5


def _known(value: float) -> float | None:
    return None if value != value else value


def _over(value: float, reference: float) -> float:
    return value / reference if reference > 0.0 else float("nan")
