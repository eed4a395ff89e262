"""A target that begins and ends at rest, so that a table that stands still can follow it.

After a filter that runs both ways, a baseline or resampling, a motion has a velocity and a displacement
at its first sample. Here both rise from zero over a ramp, and the acceleration is their derivative.
"""

from __future__ import annotations

import numpy as np
import scipy  # loads its parts on first use, scipy.signal among them, which takes half a second
from numpy.typing import NDArray

from shake_env.model.parameters import FloatArray

RAMP = 2.0  # [s] of the record's own time at either end
QUIET = 0.1  # [-] of the peak acceleration, below which a ramp does not distort the strong motion

Integrals = tuple[FloatArray, FloatArray, FloatArray]  # [m/s^2], [m/s], [m], (samples,) each


def integrals(acceleration: FloatArray, step: float) -> Integrals:
    """Return `acceleration` (samples,), its velocity and its displacement, both less their trend.

    The trends are those of an uncorrected record; the velocity at the first sample is what is left.
    """
    velocity = _integrated(acceleration, step)
    return acceleration, velocity, _integrated(velocity, step)


def from_rest(acceleration: FloatArray, step: float, ramp: float) -> Integrals:
    """Return a motion that begins and ends at rest, with its velocity and displacement.

    The displacement d (less its trend) is multiplied by a window w that rises over `ramp` as a
    fifth-order polynomial with no slope or curvature at its ends, and falls likewise. Acceleration is
    the second derivative of the product, ``w d'' + 2 w' d' + w'' d``. Between the ramps it is the given
    one, less a constant: the slope of the velocity's trend. Where the given acceleration exceeds a tenth
    of its peak within a ramp, zeros are added before or after it, so that the ramp lies outside.

    Parameters
    ----------
    acceleration
        (samples,) [m/s^2].
    step
        Time between samples [s].
    ramp
        Length of each ramp [s].

    Returns
    -------
    Acceleration [m/s^2], velocity [m/s] and displacement [m], (samples + zeros,) each. The last two are
    the trapezoidal integrals of the first from zero.
    """
    acceleration = _with_quiet_ends(acceleration, round(ramp / step))
    samples = len(acceleration)
    raw_velocity = _cumulative(acceleration, step)
    velocity = scipy.signal.detrend(raw_velocity)
    raw_displacement = _cumulative(velocity, step)
    displacement = scipy.signal.detrend(raw_displacement)
    duration = (samples - 1) * step
    acceleration = acceleration - _rise(raw_velocity - velocity) / duration
    velocity = velocity - _rise(raw_displacement - displacement) / duration
    time = step * np.arange(samples)
    up, up_slope, up_curve = _ramp(time / ramp)
    down, down_slope, down_curve = (values[::-1] for values in (up, up_slope, up_curve))
    window = up * down
    slope = (up_slope * down - up * down_slope) / ramp
    curve = (up_curve * down - 2.0 * up_slope * down_slope + up * down_curve) / ramp**2
    moved = window * acceleration + 2.0 * slope * velocity + curve * displacement
    moved_velocity = _cumulative(moved, step)
    return (
        moved,
        moved_velocity,
        _cumulative(moved_velocity, step),
    )


def _integrated(values: FloatArray, step: float) -> FloatArray:
    integral: FloatArray = scipy.signal.detrend(_cumulative(values, step))
    return integral


def _rise(line: FloatArray) -> float:
    return float(line[-1] - line[0])


def _with_quiet_ends(acceleration: FloatArray, samples: int) -> FloatArray:
    """Return a motion (n,) with zeros at its ends, until `samples` of each end are quiet."""
    strong = np.flatnonzero(np.abs(acceleration) > QUIET * np.max(np.abs(acceleration)))
    if not len(strong):  # a motion of zeros
        return acceleration
    before = max(samples - int(strong[0]), 0)
    after = max(samples - (len(acceleration) - 1 - int(strong[-1])), 0)
    return np.pad(acceleration, (before, after))


def _ramp(share: NDArray[np.floating]) -> Integrals:
    """Return a ramp from 0 to 1 at `share` (n,) of its length, with first and second derivative."""
    s = np.minimum(share, 1.0)
    value = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    slope = 30.0 * s**2 * (1.0 - s) ** 2
    return value, slope, 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)


def _cumulative(values: FloatArray, step: float) -> FloatArray:
    """Return the integral (samples,) from the first sample on, by trapezoids."""
    integral: FloatArray = scipy.integrate.cumulative_trapezoid(values, dx=step, initial=0.0)
    return integral
