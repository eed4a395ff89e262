"""The first column of a table: a count, or times that are evenly spaced."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from shake_env.errors import RecordError
from shake_env.model.parameters import FloatArray

_UNEVEN = 0.02  # of a step: more than printed digits take off, less than a line lost
_AT_ONCE = 65_536  # rows
_MOST_DECIMALS = 9

Place = Callable[[int], str]  # from a row's number to file and line


def is_count(values: FloatArray) -> bool:
    """Return whether a column is 0, 1, 2, ... or 1, 2, 3, ..."""
    first = float(values[0])
    return first in (0.0, 1.0) and all(
        np.array_equal(part, first + begin + np.arange(len(part))) for begin, part in _parts(values)
    )


def is_even(values: FloatArray) -> bool:
    """Return whether a column rises in even steps, within what its printed digits allow."""
    step = _mean_step(values)
    return step is not None and (_unevenness(values, step) is not None or _steps_of(values) is not None)


def is_rising(values: FloatArray) -> bool:
    """Return whether every value is above the one before it."""
    return all(
        np.all(np.diff(values[max(begin - 1, 0) : begin + len(p)]) > 0) for begin, p in _parts(values)
    )


def step_of(values: FloatArray, place: Place, given: float | None) -> float:
    """Return the step of a record's evenly spaced times, in the unit of `values`.

    Parameters
    ----------
    values
        (rows,) times.
    place
        File and line of a row.
    given
        Step that the caller or the header gives, in the unit of `values`. It settles the step where
        the times are printed with too few digits.

    Raises
    ------
    RecordError
        If the times do not rise, are not evenly spaced, or do not settle the step.
    """
    mean = _mean_step(values)
    if mean is None:
        raise RecordError(
            place(0), f"{float(values[0]):g}", "the first column must be time, rising from line to line"
        )
    deviation = _unevenness(values, mean)
    if deviation is None:
        steps = _steps_of(values)
        if steps is None:
            # Past a lost line every time is off a little; the step that is off the most is that line.
            differences = np.diff(values)
            median = float(np.median(differences))
            worst = int(np.argmax(np.abs(differences - median))) + 1
            raise RecordError(
                place(worst),
                f"{float(values[worst]):g}",
                f"the times are not evenly spaced by {median:g} s",
            )
        low, high = steps
        if given is None or not low <= given <= high:
            raise RecordError(
                place(0), f"steps of {low:.6g} to {high:.6g} s",
                "the times have too few decimals to tell the step: give sampling_interval in s",
            )  # fmt: skip
        return given
    short = float(f"{mean:.9g}")  # 0.005, where the times' own rounding makes 0.00499999999999
    if abs(short - mean) <= 1e-9 * mean:
        return short
    # The shortest step by which the last time is off no more than the others are.
    for digits in range(2, 9):
        short = float(f"{mean:.{digits}g}")
        if abs(short - mean) * (len(values) - 1) <= deviation:
            return short
    return mean


def _parts(values: FloatArray) -> Iterator[tuple[int, FloatArray]]:
    """Yield parts of a column with the row at which each begins: what is computed of them is small."""
    for begin in range(0, len(values), _AT_ONCE):
        yield begin, values[begin : begin + _AT_ONCE]


def _mean_step(values: FloatArray) -> float | None:
    mean = float(values[-1] - values[0]) / (len(values) - 1)
    return mean if math.isfinite(mean) and mean > 0.0 else None


def _unevenness(values: FloatArray, step: float) -> float | None:
    """Return by how much a time is off at most, or None where the steps are not even."""
    largest = 0.0
    for begin, part in _parts(values):
        off = np.abs(part - (values[0] + step * (begin + np.arange(len(part)))))
        differences = np.diff(values[max(begin - 1, 0) : begin + len(part)])
        if np.any(off > _UNEVEN * step) or np.any(np.abs(differences - step) > 2.0 * _UNEVEN * step):
            return None
        largest = max(largest, float(np.max(off)))
    return largest


def _steps_of(values: FloatArray) -> tuple[float, float] | None:
    """Return the least and the largest step that rounded times allow, or None where no step does."""
    for decimals in range(_MOST_DECIMALS):
        scale = 10.0**decimals
        if all(np.all(np.abs(p * scale - np.rint(p * scale)) < 1e-6 * scale) for _, p in _parts(values)):
            break
    else:
        return None
    low, high = 0.0, math.inf
    for begin, part in _parts(values):
        rows = begin + np.arange(len(part))
        rising = rows > 0
        if not rising.any():
            continue
        spans, rows = (part - values[0])[rising], rows[rising]
        low = max(low, float(np.max((spans - 1.0 / scale) / rows)))
        high = min(high, float(np.min((spans + 1.0 / scale) / rows)))
    # A step much longer than the last decimal would show in the times themselves.
    return (low, high) if low <= high < 5.0 / scale else None
