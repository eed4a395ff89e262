"""Extended Kalman filter of one table on its exact nonlinear period, compiled.

Equations as in Anderson and Moore, Optimal Filtering, 1979, ch. 8. Readings have independent noises and
are taken one after another, each in Joseph's form, which keeps the covariance symmetric and positive.
Imported on first use only.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit

from baselines.planning.period_kernel import (
    ModelArrays,
    gradients_of_g,
    make_tapes,
    period,
    period_jacobian,
    stamp,
    table_model,
    tape_of,
)
from shake_env.kernels.lanes import COLUMNS, YIELD_DRIFT, IntArray, jit, nonlinear, slip_rates
from shake_env.model.parameters import FloatArray

# rows (s, n) of the signals on the scaled state; outputs (s, 2) on [y_A, f_s]; biased (s), where an
# offset lies behind the state, -1 for none; variance (s)
SensorArrays: TypeAlias = tuple[FloatArray, FloatArray, IntArray, FloatArray]
# Of p parameters: step (p) between the models that slopes are taken from, low (p) and high (p)
ParameterArrays: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]


@jit
def _signals(
    x: FloatArray,
    model: ModelArrays,
    scale: FloatArray,
    sensors: SensorArrays,
    value: FloatArray,
    slope: FloatArray,
) -> None:
    """Write the sensors' signals (s) at a state, and their slopes (s, m) along the scaled state."""
    C, D, coulomb, rate, v, s = model[2], model[3], model[5], model[4], model[7], model[8]
    rows, outputs = sensors[0], sensors[1]
    order, inputs = slope.shape[1], s[COLUMNS]
    column, g, none = np.zeros((order, 1)), np.zeros((inputs, 1)), np.zeros(1)
    for i in range(order):
        column[i, 0] = x[i]
    if inputs > 0:
        nonlinear(column, none, v, s, coulomb, rate, g, 1)
    gradient, _ = gradients_of_g(column, none, model)
    for r in range(len(value)):
        value[r] = 0.0
        for i in range(order):
            slope[r, i] = rows[r, i]
            value[r] += rows[r, i] * x[i] / scale[i]
        for o in range(2):
            weight = outputs[r, o]
            if weight != 0.0:
                for i in range(order):
                    along_x = C[o, i]
                    for n in range(inputs):
                        along_x += D[o, n] * gradient[i, n]
                    slope[r, i] += weight * along_x * scale[i]
                    value[r] += weight * C[o, i] * x[i]
                for n in range(inputs):
                    value[r] += weight * D[o, n] * g[n, 0]


@jit
def predict(
    x: FloatArray,
    rest: FloatArray,
    P: FloatArray,
    u: float,
    models: ModelArrays,
    first: int,
    anchor: FloatArray,
    parameters: ParameterArrays,
    scale: FloatArray,
    sensors: SensorArrays,
    Q: FloatArray,
    keep: FloatArray,
) -> None:
    """Carry the estimate a period on, in place.

    The table's model is `models[first]`; the next 2 p are it with each parameter a step up and down.

    Parameters
    ----------
    x
        (n) SI: the m estimated states, then the commands under way, which are known.
    rest
        (a - m) offsets, over the readings' scale, then p parameters.
    P
        (a, a) covariance of ``[x / scale, rest]``.
    u
        Command of the period [A].
    anchor
        (p) parameters of the table's model.
    Q, keep
        (a, a) what a period adds to P; (a - m) share of each of `rest` that stays.
    """
    model, p = table_model(models, first), len(anchor)
    n, size = len(scale), len(P)
    order, substeps = model[0].shape[0], model[6].shape[0]
    tape = tape_of(make_tapes(model, 1), 0)
    moved, response = np.zeros(n), np.zeros(2 * substeps)
    A, B = np.zeros((n, n)), np.zeros(n)
    C, D = np.zeros((2 * substeps, n)), np.zeros(2 * substeps)
    period(x, u, model, tape, moved, response)
    period_jacobian(model, tape, scale, A, B, C, D)
    F = np.zeros((size, size))
    for i in range(order):
        for c in range(order):
            F[i, c] = A[i, c]
    along = np.zeros((p, n))
    for j in range(p):
        for sign in (1.0, -1.0):
            other = table_model(models, first + 2 * j + (1 if sign > 0.0 else 2))
            moved_j, response_j = np.zeros(n), np.zeros(2 * substeps)
            period(x, u, other, tape, moved_j, response_j)
            weight = sign / (2.0 * parameters[0][j])
            for i in range(order):
                along[j, i] += weight * moved_j[i]
    for j in range(p):
        away = rest[size - order - p + j] - anchor[j]
        for i in range(order):
            F[i, size - p + j] = along[j, i] / scale[i]
            moved[i] += away * along[j, i]
    for i in range(order, size):
        F[i, i] = keep[i - order]
        rest[i - order] *= keep[i - order]
    for i in range(n):
        x[i] = moved[i]
    FP = np.zeros((size, size))
    for i in range(size):
        for b in range(size):
            value = F[i, b]
            if value != 0.0:
                for c in range(size):
                    FP[i, c] += value * P[b, c]
    for i in range(size):
        for c in range(i + 1):
            total = Q[i, c]
            for b in range(size):
                total += FP[i, b] * F[c, b]
            P[i, c] = total
            P[c, i] = total


@jit
def correct(
    x: FloatArray,
    rest: FloatArray,
    P: FloatArray,
    readings: FloatArray,
    models: ModelArrays,
    first: int,
    anchor: FloatArray,
    parameters: ParameterArrays,
    scale: FloatArray,
    sensors: SensorArrays,
    innovation: FloatArray,
) -> None:
    """Take readings (s), over their scale, into the estimate, in place.

    `innovation` (s) is written: what each reading was off by over its standard deviation, given those
    before it, so that they are independent and of unit size where the model is right.
    """
    biased, variance = sensors[2], sensors[3]
    model, p = table_model(models, first), len(anchor)
    order, size, s = model[0].shape[0], len(P), len(readings)
    value, slope = np.zeros(s), np.zeros((s, order))
    _signals(x, model, scale, sensors, value, slope)
    along, value_j, slope_j = np.zeros((p, s)), np.zeros(s), np.zeros((s, order))
    for j in range(p):
        for sign in (1.0, -1.0):
            other = table_model(models, first + 2 * j + (1 if sign > 0.0 else 2))
            _signals(x, other, scale, sensors, value_j, slope_j)
            for r in range(s):
                along[j, r] += sign * value_j[r] / (2.0 * parameters[0][j])
    for j in range(p):
        for r in range(s):
            value[r] += along[j, r] * (rest[size - order - p + j] - anchor[j])
    dz, row, PH = np.zeros(size), np.zeros(size), np.zeros(size)
    for r in range(s):
        for i in range(size):
            row[i] = 0.0
        expected = value[r]
        for i in range(order):
            row[i] = slope[r, i]
        for j in range(p):
            row[size - p + j] = along[j, r]
        if biased[r] >= 0:
            row[biased[r]] = 1.0
            expected += rest[biased[r] - order]
        spread = variance[r]
        for i in range(size):
            total = 0.0
            for c in range(size):
                total += P[i, c] * row[c]
            PH[i] = total
        error = readings[r] - expected
        for i in range(size):
            spread += row[i] * PH[i]
            error -= row[i] * dz[i]
        innovation[r] = error / np.sqrt(spread)
        for i in range(size):
            dz[i] += PH[i] / spread * error
        # Joseph's form of one reading: (I - K h) P (I - K h)' + K R K'.
        for i in range(size):
            gain = PH[i] / spread
            for c in range(i + 1):
                other = PH[c] / spread
                joined = P[i, c] - gain * PH[c] - PH[i] * other + gain * spread * other
                P[i, c] = joined
                P[c, i] = joined
    for i in range(order):
        x[i] += dz[i] * scale[i]
    for i in range(order, size):
        rest[i - order] += dz[i]
    for j in range(p):
        at = size - order - p + j
        rest[at] = min(max(rest[at], parameters[1][j]), parameters[2][j])


@jit
def follow_target(
    state: FloatArray,
    target: FloatArray,
    maps: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
    v: FloatArray,
    shear: FloatArray,
) -> None:
    """Run a yielding reference specimen (3 stories), in place, under a target (samples + 1).

    `maps` as in :class:`shake_env.dynamics.yielding_reference.YieldingReference`, whose update this is:
    A, ground, ground_next, level, slope, C. `shear` (samples) is written.
    """
    A, ground, following, level, slope, C = maps
    n = len(state) // 3
    now, predicted = np.zeros((4 + 3 * n, 1)), np.zeros((4 + 3 * n, 1))
    g, later = np.zeros((n, 1)), np.zeros((n, 1))
    for i in range(3 * n):
        now[4 + i, 0] = state[i]
    slip_rates(now, v, n, g, 1)
    for t in range(len(shear)):
        for i in range(3 * n):
            total = ground[i, 0] * target[t] + following[i, 0] * target[t + 1]
            for c in range(3 * n):
                total += A[i, c] * now[4 + c, 0]
            for c in range(n):
                total += level[i, c] * g[c, 0]
            predicted[4 + i, 0] = total
        slip_rates(predicted, v, n, later, 1)
        shear[t] = 0.0
        for i in range(3 * n):
            total = predicted[4 + i, 0]
            for c in range(n):
                total += slope[i, c] * (later[c, 0] - g[c, 0])
            now[4 + i, 0] = total
            shear[t] += C[0, i] * total
        slip_rates(now, v, n, g, 1)
    for i in range(3 * n):
        state[i] = now[4 + i, 0]


def _cached_filter(number: int) -> Any:
    """Return the filter of a batch as numba keeps it on disk, for sources of this `stamp`."""

    @njit(cache=True, error_model="numpy", nogil=True)
    def filter_tables(
        x: FloatArray,
        rest: FloatArray,
        P: FloatArray,
        fresh: IntArray,
        u: FloatArray,
        readings: FloatArray,
        models: ModelArrays,
        anchor: FloatArray,
        parameters: ParameterArrays,
        scale: FloatArray,
        sensors: SensorArrays,
        Q: FloatArray,
        start: FloatArray,
        keep: FloatArray,
        innovation: FloatArray,
    ) -> int:
        p = anchor.shape[1]
        for n in range(len(x)):
            first = n * (2 * p + 1) if len(models[0]) > 1 else 0
            own = anchor[n]
            if fresh[n]:
                x[n] = 0.0
                rest[n] = 0.0
                for j in range(p):
                    rest[n, rest.shape[1] - p + j] = own[j]
                P[n] = start
            else:
                predict(
                    x[n], rest[n], P[n], u[n], models, first, own, parameters, scale, sensors, Q, keep
                )
            correct(
                x[n], rest[n], P[n], readings[n], models, first, own, parameters, scale, sensors,
                innovation[n],
            )  # fmt: skip
        return number

    return filter_tables


filter_tables = _cached_filter(stamp("period_kernel", "filter_kernel"))


def _cached_reference(number: int) -> Any:
    """Return `follow_target` for a batch."""

    @njit(cache=True, error_model="numpy", nogil=True)
    def follow_targets(
        state: FloatArray,
        target: FloatArray,
        maps: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
        v: FloatArray,
        shear: FloatArray,
    ) -> int:
        for n in range(len(state)):
            if v[YIELD_DRIFT] > 0.0:
                follow_target(state[n], target[n], maps, v, shear[n])
        return number

    return follow_targets


follow_targets = _cached_reference(stamp("filter_kernel"))
