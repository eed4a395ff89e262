"""How well a test repeated its target, in an earthquake engineer's terms, from a trajectory."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete, lfilter

from shake_env.simulation.trajectory import Trajectory

FloatArray = NDArray[np.float64]

PERIODS: FloatArray = np.geomspace(0.05, 2.0, 40)  # [s] of the response-spectrum ordinates
DAMPING = 0.05  # [-] of their oscillators
TOLERANCE = 0.10  # an ordinate further off than this share of the target's counts as missed
LONGEST_DELAY = 0.05  # [s] searched to either side


@dataclass(frozen=True)
class Fidelity:
    """One test against its target."""

    delay: float  # [s] of the table's acceleration behind the target's, by cross-correlation
    spectral_error: float  # share of response-spectrum ordinates more than 10 % off the target's
    arias_ratio: float  # Arias intensity achieved over the target's
    drift_ratio: float  # peak drift of the first storey over the reference specimen's
    energy_ratio: float  # energy dissipated in the first storey over the reference specimen's


def fidelity(trajectory: Trajectory, physics_step: float) -> Fidelity:
    """Return the fidelity of a test: spectra, cross-correlation and the other measures of `Fidelity`.

    The energy is the work of the base shear on the first storey's drift, by trapezoids over the control
    periods: what damping and yielding took, once the storey has come to rest.

    Parameters
    ----------
    trajectory
        Of one table.
    physics_step
        Step of its accelerations [s].
    """
    target, achieved = trajectory.target_acceleration, trajectory.table_acceleration
    wanted = spectrum(target, physics_step)
    missed = np.abs(spectrum(achieved, physics_step) - wanted) > TOLERANCE * wanted
    substeps = len(target) // len(trajectory.current)
    drift, reference = trajectory.state[:, 4], trajectory.reference[:, 0]
    ends = slice(substeps - 1, None, substeps)
    return Fidelity(
        delay=delay(target, achieved, physics_step),
        spectral_error=float(np.mean(missed)),
        arias_ratio=_ratio(np.sum(achieved**2), np.sum(target**2)),
        drift_ratio=_ratio(np.max(np.abs(drift)), np.max(np.abs(reference))),
        energy_ratio=_ratio(
            _work(trajectory.base_shear[ends], drift),
            _work(trajectory.reference_base_shear[ends], reference),
        ),
    )


def spectrum(
    acceleration: FloatArray, step: float, periods: FloatArray = PERIODS, damping: float = DAMPING
) -> FloatArray:
    """Return the pseudo-acceleration response spectrum (periods,) [m/s^2] of a motion (samples,).

    Each oscillator is stepped exactly for straight lines between samples (Nigam and Jennings, 1969), as
    a recursive filter: eqsig's own steps take a second a motion, and a comparison has thousands.
    """
    response = np.empty(len(periods))
    for i, (numerator, denominator, stiffness) in enumerate(_oscillators(step, tuple(periods), damping)):
        response[i] = stiffness * np.max(np.abs(lfilter(numerator, denominator, acceleration)))
    return response


@lru_cache(maxsize=8)
def _oscillators(
    step: float, periods: tuple[float, ...], damping: float
) -> tuple[tuple[FloatArray, FloatArray, float], ...]:
    filters = []
    for period in periods:
        omega = 2.0 * np.pi / period
        continuous = ([-1.0], [1.0, 2.0 * damping * omega, omega**2])
        numerator, denominator, _ = cont2discrete(continuous, step, method="foh")
        filters.append((np.ravel(numerator), denominator, omega**2))
    return tuple(filters)


def delay(target: FloatArray, achieved: FloatArray, step: float) -> float:
    """Return how far `achieved` (samples,) lags `target` (samples,) [s].

    The lag of largest cross-correlation within 50 ms, refined by a parabola through its neighbours; NaN
    for a table that stands still.
    """
    reach = min(round(LONGEST_DELAY / step), (len(target) - 1) // 2)
    if not np.any(achieved):
        return float("nan")
    middle = target[reach : len(target) - reach]
    windows = np.lib.stride_tricks.sliding_window_view(achieved, len(middle))
    correlation = windows @ middle
    best = int(np.argmax(correlation))
    if not 0 < best < len(correlation) - 1:
        return (best - reach) * step
    before, at, after = correlation[best - 1 : best + 2]
    curvature = before - 2.0 * at + after
    shift = 0.5 * (before - after) / curvature if curvature < 0.0 else 0.0
    return float((best - reach + shift) * step)


def _work(force: FloatArray, displacement: FloatArray) -> float:
    return float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(displacement)))


def _ratio(value: float, reference: float) -> float:
    return float(value / reference) if reference > 0.0 else float("nan")
