"""Functions of stacks of small matrices, compiled: exponential, covariances, periods of many steps.

The array forms in :mod:`shake_env.model.discretization` and :mod:`shake_env.model.plant` are the
reference. Matrices are float64 in rows, one a plant along the first axis.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from shake_env.model.parameters import FloatArray

jit = njit(error_model="numpy", nogil=True)
MOST_DOUBLINGS = 60
# Numerator of the Pade approximant of degree 13, and the norm up to which it reaches rounding (Higham,
# SIAM J. Matrix Anal. Appl. 26, 2005).
_PADE = tuple(
    float(math.factorial(26 - j) * math.factorial(13))
    / float(math.factorial(26) * math.factorial(j) * math.factorial(13 - j))
    for j in range(14)
)
_REACH = 5.371920351148152


@jit
def multiply(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Write a b to out; terms with a zero of a are left out."""
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            out[i, j] = 0.0
        for k in range(a.shape[1]):
            factor = a[i, k]
            if factor != 0.0:
                for j in range(b.shape[1]):
                    out[i, j] += factor * b[k, j]


@jit
def solve(a: FloatArray, b: FloatArray) -> float:
    """Write the solution of a x = b over b, a's triangular factors over a; return log |det a|."""
    n, size = a.shape[0], 0.0
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(a[i, k]) > abs(a[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(n):
                a[k, j], a[pivot, j] = a[pivot, j], a[k, j]
            for j in range(b.shape[1]):
                b[k, j], b[pivot, j] = b[pivot, j], b[k, j]
        size += math.log(abs(a[k, k]))
        for i in range(k + 1, n):
            factor = a[i, k] / a[k, k]
            if factor != 0.0:
                for j in range(k + 1, n):
                    a[i, j] -= factor * a[k, j]
                for j in range(b.shape[1]):
                    b[i, j] -= factor * b[k, j]
    for k in range(n - 1, -1, -1):
        for i in range(k + 1, n):
            factor = a[k, i]
            if factor != 0.0:
                for j in range(b.shape[1]):
                    b[k, j] -= factor * b[i, j]
        for j in range(b.shape[1]):
            b[k, j] /= a[k, k]
    return size


@jit
def _size(x: FloatArray) -> float:
    """Return the largest sum of a column's sizes."""
    largest = 0.0
    for j in range(x.shape[1]):
        column = 0.0
        for i in range(x.shape[0]):
            column += abs(x[i, j])
        largest = max(largest, column)
    return largest


@jit
def _exponential(x: FloatArray, room: FloatArray) -> None:
    """Write exp(x) over x, with room (6, n, n): scaling, Pade approximant of degree 13, squaring.

    It is scaled by the size of its powers (Al-Mohy and Higham, SIAM J. Matrix Anal. Appl. 31, 2009):
    a large entry that no power repeats, such as an input's, needs none, and would lose digits.
    """
    n, halvings = x.shape[0], 0
    x2, x4, x6, odd, even, free = room[0], room[1], room[2], room[3], room[4], room[5]
    # Each product by one call in a loop, which then is compiled once.
    for step in range(6):
        a, b, out = x, x, x2
        if step == 1:
            a, b, out = x2, x2, x4
        elif step == 2:
            a, b, out = x4, x2, x6
        elif step == 3:
            size = max(_size(x4) ** (1.0 / 4.0), _size(x6) ** (1.0 / 6.0)) / _REACH
            halvings = math.ceil(math.log2(size)) if 1.0 < size < math.inf else 0
            by = 2.0**-halvings
            for i in range(n):
                for j in range(n):
                    x[i, j] *= by
                    x2[i, j] *= by**2
                    x4[i, j] *= by**4
                    x6[i, j] *= by**6
                    p, q, r = x2[i, j], x4[i, j], x6[i, j]
                    odd[i, j] = _PADE[13] * r + _PADE[11] * q + _PADE[9] * p
                    free[i, j] = _PADE[12] * r + _PADE[10] * q + _PADE[8] * p
            a, b, out = x6, free, even
        elif step == 4:
            a, b, out = x6, odd, free
        elif step == 5:
            for i in range(n):
                for j in range(n):
                    p, q, r = x2[i, j], x4[i, j], x6[i, j]
                    free[i, j] += _PADE[7] * r + _PADE[5] * q + _PADE[3] * p
                    even[i, j] += _PADE[6] * r + _PADE[4] * q + _PADE[2] * p
                free[i, i] += _PADE[1]
                even[i, i] += _PADE[0]
            a, b, out = x, free, odd
        multiply(a, b, out)
    for i in range(n):
        for j in range(n):
            x[i, j], free[i, j] = even[i, j] + odd[i, j], even[i, j] - odd[i, j]
    solve(free, x)
    for _ in range(halvings):
        for i in range(n):
            for j in range(n):
                odd[i, j] = x[i, j]
        multiply(odd, odd, x)


@jit
def _symmetric_product(a: FloatArray, middle: FloatArray, out: FloatArray, free: FloatArray) -> None:
    """Write a middle a' to out, for a symmetric matrix in the middle."""
    multiply(a, middle, free)
    n = a.shape[0]
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += free[i, k] * a[j, k]
            out[i, j] = out[j, i] = total


@jit
def _stationary(a: FloatArray, b: FloatArray, out: FloatArray, room: FloatArray) -> None:
    """Write P with ``a P + P a' + b b' = 0`` for a stable a and b (n,); NaN where there is none.

    Smith's doubling behind a Cayley transform at the geometric mean of the rates, and one step of
    refinement (Smith, SIAM J. Appl. Math. 16, 1968).
    """
    n = a.shape[0]
    inverse, moved, power, part, more, free = room[0], room[1], room[2], room[3], room[4], room[5]
    shift = 0.0
    for again in range(2):
        for i in range(n):
            for j in range(n):
                moved[i, j], inverse[i, j], out[i, j] = a[i, j], 0.0, 0.0
            inverse[i, i], moved[i, i] = 1.0, moved[i, i] - shift
        size = solve(moved, inverse)
        if again == 0:
            shift = math.exp(size / n)
    for refinement in range(2):
        multiply(a, out, free)
        for i in range(n):
            for j in range(n):
                part[i, j] = b[i] * b[j] + (free[i, j] + free[j, i])
                power[i, j] = 2.0 * shift * inverse[i, j] + (1.0 if i == j else 0.0)
        settled = False
        for step in range(MOST_DOUBLINGS):
            if step == 0:
                _symmetric_product(inverse, part, more, free)
                for i in range(n):
                    for j in range(n):
                        part[i, j] = 2.0 * shift * more[i, j]
            _symmetric_product(power, part, more, free)
            settled = True
            for i in range(n):
                for j in range(n):
                    part[i, j] += more[i, j]
            for i in range(n):
                settled = settled and abs(more[i, i]) <= 1e-20 * abs(part[i, i])
            if settled:
                break
            multiply(power, power, free)
            for i in range(n):
                for j in range(n):
                    power[i, j] = free[i, j]
        for i in range(n):
            for j in range(n):
                out[i, j] += part[i, j] if settled or refinement else math.nan


@jit
def _noise_columns(left: FloatArray, columns: FloatArray, column: FloatArray) -> bool:
    """Write the directions (n, directions) of a covariance, which is used up; see `noise_factor`.

    State 1 comes first, state 0 second. Returns whether the covariance is finite and has no negative
    part that rounding does not explain.
    """
    n, directions, largest = columns.shape[0], columns.shape[1], 0.0
    for i in range(n):
        largest = max(largest, left[i, i])
    rounding = 2.0**-52 * largest
    for k in range(max(directions, n)):
        pivot = 0
        for i in range(n):
            if left[i, i] > left[pivot, pivot]:
                pivot = i
        if k < 2:
            pivot = 1 - k
        most = left[pivot, pivot]
        root = math.sqrt(most) if most > rounding else math.inf
        for i in range(n):
            column[i] = left[i, pivot] / root
            if k < directions:
                columns[i, k] = column[i]
        for i in range(n):
            for j in range(n):
                left[i, j] -= column[i] * column[j]
    size = 0.0
    for i in range(n):
        for j in range(n):
            if not abs(left[i, j]) < math.inf:
                return False
            size = max(size, abs(left[i, j]))
    return size <= 1e-10 * largest


@jit
def _steps(
    moved: FloatArray,
    held: FloatArray,
    later: FloatArray,
    rows: FloatArray,
    out: FloatArray,
    running: FloatArray,
    free: FloatArray,
) -> None:
    """Write a period of many steps (n + outputs k, n + samples); see `discretization.lift`.

    Rows of the state, then each output's k; `later` multiplies the sample at a step's end, and has no
    column where there is none.
    """
    n, rank, outputs = moved.shape[0], held.shape[1], rows.shape[0]
    k = (out.shape[0] - n) // outputs
    for i in range(n):
        for j in range(running.shape[1]):
            running[i, j] = 1.0 if i == j else 0.0
    for step in range(k):
        multiply(moved, running, free)
        first = n + step * rank
        for i in range(n):
            for j in range(running.shape[1]):
                running[i, j] = free[i, j]
            for r in range(rank):
                running[i, first + r] += held[i, r]
            for r in range(later.shape[1]):
                running[i, first + rank + r] += later[i, r]
        for output in range(outputs):
            at = n + output * k + step
            for j in range(running.shape[1]):
                total = 0.0
                for i in range(n):
                    total += rows[output, i] * running[i, j]
                out[at, j] = total
    for i in range(n):
        for j in range(running.shape[1]):
            out[i, j] = running[i, j]


@jit
def hold(a: FloatArray, b: FloatArray, scale: FloatArray, dt: float) -> Any:
    """Return A, and what levels and slopes of the inputs add; see `discretization.first_order_hold`.

    The model's B is level - slope, its B_next the slope. Of (n, n), (n, inputs) and (n,).
    """
    n, inputs = b.shape
    size = n + 2 * inputs
    room, x = np.empty((6, size, size)), np.empty((size, size))
    moved, level, slope = np.empty((n, n)), np.empty((n, inputs)), np.empty((n, inputs))
    for i in range(size):
        for j in range(size):
            x[i, j] = 1.0 if i >= n and j == i + inputs else 0.0
    for i in range(n):
        for j in range(n):
            x[i, j] = a[i, j] * scale[j] / scale[i] * dt
        for j in range(inputs):
            x[i, n + j] = b[i, j] / scale[i] * dt
    _exponential(x, room)
    for i in range(n):
        for j in range(n):
            moved[i, j] = x[i, j] * scale[i] / scale[j]
        for j in range(inputs):
            level[i, j] = x[i, n + j] * scale[i]
            slope[i, j] = x[i, n + inputs + j] * scale[i]
    return moved, level, slope


@jit
def stationary_covariance(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Write the stationary covariance (n, n) of ``x' = a x + b w``, b (n,); NaN where there is none."""
    _stationary(a, b, out, np.empty((6, a.shape[0], a.shape[1])))


@jit
def noise_map(power: FloatArray, scale: FloatArray, rows: FloatArray, out: FloatArray) -> bool:
    """Write the map of `ground._noise_map`; return whether it is sound.

    From the exponential (2 n, 2 n) of `discretization.noise_covariance`, the states' scale and two
    outputs' rows (2, n).
    """
    n = len(scale)
    rank = (out.shape[1] - n) * 2 // (out.shape[0] - n)
    moved, free, covariance = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    columns, column = np.empty((n, rank)), np.empty(n)
    for i in range(n):
        for j in range(n):
            moved[i, j], free[i, j] = power[n + j, n + i], power[i, n + j]
    multiply(moved, free, covariance)
    for i in range(n):
        for j in range(i + 1):
            mean = 0.5 * (covariance[i, j] + covariance[j, i])
            covariance[i, j] = covariance[j, i] = mean
    if not _noise_columns(covariance, columns, column):
        return False
    for i in range(n):
        for j in range(n):
            moved[i, j] *= scale[i] / scale[j]
        for j in range(rank):
            columns[i, j] *= scale[i]
    period(moved, columns, np.empty((n, 0)), rows, out)
    return True


@jit
def period(
    moved: FloatArray, held: FloatArray, later: FloatArray, rows: FloatArray, out: FloatArray
) -> None:
    """Write a period of many steps; see `_steps`."""
    size = (moved.shape[0], out.shape[1])
    _steps(moved, held, later, rows, out, np.empty(size), np.empty(size))
