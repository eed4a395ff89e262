"""Whether rows of numbers are one series wrapped over lines, or channels side by side."""

from __future__ import annotations

import numpy as np

from shake_env.model.parameters import FloatArray
from shake_env.records.text.times import is_count, is_even, is_rising

_FEWEST_ROWS = 8
_FEWEST_COLUMNS = 3
_MOST_ROWS = 4096  # that are looked at
_ALIKE = 2.0  # largest ratio of the differences between neighbours, by their place in the line
_NEARER = 0.7  # neighbours along a line differ by less than this part of those down a column


def is_series(rows: FloatArray, *, counted: bool) -> bool:
    """Return whether a record's `rows` (rows, width) of numbers run on from each line to the next.

    In a series that is wrapped, neighbours along a line differ by the change over one step, wherever in
    the line they stand and also across the end of a line; neighbours down a column differ by the change
    over `width` steps, which is more. Channels side by side differ from one another, or, if they are
    alike, change at the ends of lines only.

    Parameters
    ----------
    rows
        (rows, width) numbers.
    counted
        Whether the file's own count is the number of all numbers, which then decides; a first column of
        times or counts speaks against both.
    """
    if len(rows) < 2:
        return counted
    first = np.ascontiguousarray(rows[:, 0])
    if is_count(first) or is_even(first) or is_rising(first):
        return False
    if counted or len(rows) < _FEWEST_ROWS or rows.shape[1] < _FEWEST_COLUMNS:
        return counted
    rows = rows[:_MOST_ROWS]
    size = rows[:-1].size
    along = np.abs(np.diff(rows.ravel()))[:size].reshape(len(rows) - 1, -1).mean(axis=0)
    down = np.abs(np.diff(rows, axis=0)).mean(axis=0)
    return bool(np.max(along) <= _ALIKE * np.min(along) and np.max(along) < _NEARER * np.min(down))
