"""Intensity measures of a recorded motion, through eqsig."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.errors import ParameterError, ShakeError, install_hint
from shake_env.model.parameters import GRAVITY
from shake_env.motion.targets import resample
from shake_env.records import Record

FloatArray = NDArray[np.float64]

PERIODS: FloatArray = np.geomspace(0.05, 5.0, 60)  # [s]
DAMPING = 0.05  # [-]
SAMPLES_A_PERIOD = 6  # that eqsig needs
REFINED = 16  # times as many samples; straight lines then lose 0.3 % of the shortest wave
_EQSIG_GRAVITY = 9.81  # [m/s^2] that eqsig divides by
_CELLS = 4_000_000  # periods x samples that eqsig holds at once


def _eqsig() -> Any:
    try:
        import eqsig.im
        import eqsig.sdof
    except ImportError:
        raise ShakeError("eqsig", "missing", install_hint("agents")) from None
    return eqsig


def arias_intensity(record: Record) -> float:
    """Return the Arias intensity, pi / (2 g) times the integral of squared acceleration [m/s].

    g is standard gravity. Source: Arias (1970); eqsig integrates by trapezoids.
    """
    eqsig = _eqsig()
    signal = eqsig.AccSignal(record.acceleration, record.sampling_interval)
    built_up = eqsig.im.calc_arias_intensity(signal)
    return float(built_up[-1]) * _EQSIG_GRAVITY / GRAVITY


def significant_duration(record: Record) -> float:
    """Return the time between 5 and 95 % of the Arias intensity [s] (Trifunac and Brady, 1975).

    eqsig counts samples strictly between the two; a record whose whole intensity lies in one or two
    samples, or that is at rest, has a duration of 0.
    """
    squares = np.cumsum(record.acceleration**2)
    if not np.any((squares > 0.05 * squares[-1]) & (squares < 0.95 * squares[-1])):
        return 0.0
    return float(_eqsig().im.calc_sig_dur_vals(record.acceleration, record.sampling_interval))


def response_spectrum(
    record: Record, periods: FloatArray = PERIODS, damping: float = DAMPING
) -> FloatArray:
    """Return the pseudo-acceleration response spectrum of a record.

    eqsig steps each oscillator exactly for straight lines between samples (Nigam and Jennings, 1969).
    Below six samples a period it gives the peak of the ground instead: there the record is interpolated
    first, band-limited (`shake_env.motion.targets.resample`).

    Parameters
    ----------
    record
        The motion.
    periods
        (n,) undamped natural periods [s], at least two samples.
    damping
        Damping ratio [-].

    Returns
    -------
    (n,) [m/s^2].

    Raises
    ------
    ParameterError
        If a period is shorter than two samples.
    """
    step = record.sampling_interval
    if np.any(periods < 2.0 * step):
        remedy = f"must be at least two samples of {step:g} s: the record holds nothing shorter"
        raise ParameterError("periods", float(np.min(periods)), remedy)
    short = periods < SAMPLES_A_PERIOD * step
    spectrum = np.empty(len(periods))
    if not short.all():
        spectrum[~short] = _spectrum(record.acceleration, step, periods[~short], damping)
    if short.any():
        values = resample(record.acceleration, step, step / REFINED)
        spectrum[short] = _spectrum(values, step / REFINED, periods[short], damping)
    return spectrum


def _spectrum(values: FloatArray, step: float, periods: FloatArray, damping: float) -> FloatArray:
    sdof = _eqsig().sdof
    at_once = max(1, _CELLS // len(values))
    return np.concatenate(
        [
            sdof.pseudo_response_spectra(values, step, periods[i : i + at_once], damping)[2]
            for i in range(0, len(periods), at_once)
        ]
    )
