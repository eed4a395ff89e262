"""Control-limited iterative LQR on the exact period of a table, compiled.

Gauss-Newton (Li and Todorov, ICINCO 2004): the stage cost is a sum of squares, so that its curvature is
that of the residuals' slopes. The current's bounds are kept as in Tassa, Mansard and Todorov (ICRA
2014): where a step meets one, it stops there and its feedback is zero. Imported on first use only.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit

from baselines.planning.period_kernel import (
    ModelArrays,
    Tapes,
    make_tapes,
    period,
    period_jacobian,
    stamp,
    table_model,
    tape_of,
)
from shake_env.kernels.lanes import COLUMNS, IntArray, jit
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import TABLE_DISPLACEMENT

ACCELERATION, FORCE, CURRENT, PLACE = range(4)  # entries of `weights`
ACCELERATION_LIMIT, SOFT_SHARE, SOFT_WEIGHT, CURRENT_LIMIT = range(4)  # entries of `bounds`
# target (H, k), shear (H, k), place (H), weights (4), rows (R, n) of the limited quantities over their
# limits on the scaled state, group (R) of each row, bounds (4), P (n, n) and p (n) of the tail's cost
# z'P z / 2 + p'z on the scaled state
PlanArrays: TypeAlias = tuple[
    FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, IntArray, FloatArray, FloatArray,
    FloatArray,
]  # fmt: skip
MARGIN = 1e-9  # [-] of a hard limit that a plan stays away, for rounding
ROUNDING = 1e-13  # [-] of the cost: a step to a plan as good as this is taken, which ends the search


@jit
def _largest(rows: FloatArray, group: IntArray, first: int, x: FloatArray, scale: FloatArray) -> Any:
    """Return the row of largest size in the group that begins at `first`, its value, and the end."""
    best, value, at = -1.0, 0.0, first
    row = first
    while row < len(group) and group[row] == group[first]:
        total = 0.0
        for a in range(len(scale)):
            if rows[row, a] != 0.0:
                total += rows[row, a] * x[a] / scale[a]
        if abs(total) > best:
            best, value, at = abs(total), total, row
        row += 1
    return at, value, row


@jit
def objective(
    X: FloatArray, Y: FloatArray, U: FloatArray, plan: PlanArrays, scale: FloatArray
) -> tuple[float, float]:
    """Return the cost of a plan, and the largest of its limited quantities over their limits."""
    target, shear, place, weights, rows, group, bounds, P, p = plan
    H, k = target.shape
    cost, worst = 0.0, 0.0
    share, soft = bounds[SOFT_SHARE], bounds[SOFT_WEIGHT]
    span = 1.0 - share
    for t in range(H):
        a, f, largest = 0.0, 0.0, 0.0
        for j in range(k):
            a += (Y[t, j] - target[t, j]) ** 2
            f += (Y[t, k + j] - shear[t, j]) ** 2
            largest = max(largest, abs(Y[t, j]))
        cost += weights[0] * a / k + weights[1] * f / k + weights[2] * U[t] ** 2
        x = X[t + 1]
        if weights[3] > 0.0:
            cost += weights[3] * (x[TABLE_DISPLACEMENT] - place[t]) ** 2
        ratio = largest / bounds[ACCELERATION_LIMIT]
        worst = max(worst, ratio)
        if ratio > share:
            cost += soft * ((ratio - share) / span) ** 2
        first = 0
        while first < len(group):
            _, value, first = _largest(rows, group, first, x, scale)
            worst = max(worst, abs(value))
            if abs(value) > share:
                cost += soft * ((abs(value) - share) / span) ** 2
    x = X[H]
    for a in range(len(scale)):
        total = 0.0
        for b in range(len(scale)):
            total += P[a, b] * x[b] / scale[b]
        cost += (0.5 * total + p[a]) * x[a] / scale[a]
    return cost, worst


@jit
def roll_out(
    X: FloatArray,
    U: FloatArray,
    Y: FloatArray,
    nominal: FloatArray,
    base: FloatArray,
    step: FloatArray,
    gain: FloatArray,
    alpha: float,
    limit: float,
    model: ModelArrays,
    tapes: Tapes,
    scale: FloatArray,
) -> None:
    """Run a plan from X[0] with ``base + alpha step + gain (x - nominal)``; write X, U, Y and tapes."""
    n = len(scale)
    for t in range(len(U)):
        u = base[t] + alpha * step[t]
        if alpha > 0.0:
            for a in range(n):
                u += gain[t, a] * (X[t, a] - nominal[t, a]) / scale[a]
        u = min(max(u, -limit), limit)
        U[t] = u
        period(X[t], u, model, tape_of(tapes, min(t, len(tapes[0]) - 1)), X[t + 1], Y[t])


@jit
def _add_square(row: FloatArray, weight: float, residual: float, P: FloatArray, q: FloatArray) -> None:
    """Add the curvature and slope of ``weight (row z + residual)^2``."""
    for a in range(len(row)):
        if row[a] != 0.0:
            value = 2.0 * weight * row[a]
            q[a] += value * residual
            for b in range(len(row)):
                P[a, b] += value * row[b]


@jit
def backward(
    X: FloatArray,
    Y: FloatArray,
    U: FloatArray,
    A: FloatArray,
    B: FloatArray,
    C: FloatArray,
    D: FloatArray,
    plan: PlanArrays,
    scale: FloatArray,
    damping: float,
    step: FloatArray,
    gain: FloatArray,
) -> None:
    """Write the current's step (H) and feedback (H, n) on the scaled state; Riccati's recursion.

    A, B, C, D hold one period each, or one for all of them.
    """
    target, shear, place, weights, rows, group, bounds, tail_P, tail_p = plan
    H, k = target.shape
    n = len(scale)
    share, soft, limit = bounds[SOFT_SHARE], bounds[SOFT_WEIGHT], bounds[CURRENT_LIMIT]
    span = 1.0 - share
    P, q = tail_P.copy(), tail_p.copy()
    for a in range(n):
        for b in range(n):
            q[a] += tail_P[a, b] * X[H, b] / scale[b]
    PA, Qxx = np.empty((n, n)), np.empty((n, n))
    PB, Qux, Qx = np.empty(n), np.empty(n), np.empty(n)
    row = np.zeros(n)
    for t in range(H - 1, -1, -1):
        x = X[t + 1]
        if weights[3] > 0.0:
            for a in range(n):
                row[a] = 0.0
            row[TABLE_DISPLACEMENT] = scale[TABLE_DISPLACEMENT]
            _add_square(row, weights[3], x[TABLE_DISPLACEMENT] - place[t], P, q)
        if soft > 0.0:
            first = 0
            while first < len(group):
                at, value, first = _largest(rows, group, first, x, scale)
                if abs(value) > share:
                    sign = (1.0 if value > 0.0 else -1.0) / span
                    for a in range(n):
                        row[a] = rows[at, a] * sign
                    _add_square(row, soft, (abs(value) - share) / span, P, q)
        now = min(t, len(A) - 1)
        At, Bt, Ct, Dt = A[now], B[now], C[now], D[now]
        for a in range(n):
            for c in range(n):
                PA[a, c] = 0.0
            total = 0.0
            for b in range(n):
                value = P[a, b]
                total += value * Bt[b]
                for c in range(n):
                    PA[a, c] += value * At[b, c]
            PB[a] = total
        curvature, slope = 2.0 * weights[2], 2.0 * weights[2] * U[t]
        for a in range(n):
            curvature += Bt[a] * PB[a]
            slope += Bt[a] * q[a]
            Qux[a], Qx[a] = 0.0, 0.0
            for c in range(n):
                Qxx[a, c] = 0.0
        for b in range(n):
            value, along = PB[b], q[b]
            for a in range(n):
                Qux[a] += value * At[b, a]
                Qx[a] += along * At[b, a]
            for a in range(n):
                value = At[b, a]
                if value != 0.0:
                    for c in range(n):
                        Qxx[a, c] += value * PA[b, c]
        loudest = 0
        for i in range(2 * k):
            weight = 2.0 * weights[0] / k if i < k else 2.0 * weights[1] / k
            residual = Y[t, i] - (target[t, i] if i < k else shear[t, i - k])
            if i < k and abs(Y[t, i]) > abs(Y[t, loudest]):
                loudest = i
            _add_output(Ct[i], Dt[i], weight, residual, Qxx, Qux, Qx)
            curvature += weight * Dt[i] * Dt[i]
            slope += weight * Dt[i] * residual
        ratio = abs(Y[t, loudest]) / bounds[ACCELERATION_LIMIT]
        if soft > 0.0 and ratio > share:
            scaled = 1.0 / (bounds[ACCELERATION_LIMIT] * span)
            weight = 2.0 * soft * scaled * scaled
            residual = (ratio - share) / span / scaled * (1.0 if Y[t, loudest] > 0.0 else -1.0)
            _add_output(Ct[loudest], Dt[loudest], weight, residual, Qxx, Qux, Qx)
            curvature += weight * Dt[loudest] ** 2
            slope += weight * Dt[loudest] * residual
        move = -slope / (curvature + damping)
        low, high = -limit - U[t], limit - U[t]
        K = gain[t]
        if move < low or move > high:
            move = min(max(move, low), high)
            for a in range(n):
                K[a] = 0.0
        else:
            for a in range(n):
                K[a] = -Qux[a] / (curvature + damping)
        step[t] = move
        for a in range(n):
            q[a] = Qx[a] + K[a] * (curvature * move + slope) + Qux[a] * move
        for a in range(n):
            for c in range(a + 1):
                value = Qxx[a, c] + K[a] * curvature * K[c] + K[a] * Qux[c] + Qux[a] * K[c]
                P[a, c] = value
                P[c, a] = value


@jit
def _add_output(
    row: FloatArray,
    along_current: float,
    weight: float,
    residual: float,
    Qxx: FloatArray,
    Qux: FloatArray,
    Qx: FloatArray,
) -> None:
    """Add what a squared output makes of the value function's curvature and slope."""
    for a in range(len(row)):
        value = weight * row[a]
        Qux[a] += value * along_current
        Qx[a] += value * residual
        for c in range(len(row)):
            Qxx[a, c] += value * row[c]


@jit
def improve(
    X: FloatArray,
    Y: FloatArray,
    U: FloatArray,
    gain: FloatArray,
    model: ModelArrays,
    scale: FloatArray,
    plan: PlanArrays,
    alphas: FloatArray,
    iterations: int,
    tolerance: float,
) -> tuple[float, float, int]:
    """Improve the currents U (H) of a plan from X[0], in place.

    A step is taken if it makes a plan that keeps the hard limits cheaper, or of two that do not the
    cheaper one, or leads to one that keeps them. X (H + 1, n), Y (H, 2 k) and gain (H, n) are written.

    Returns
    -------
    cost, largest ratio, iterations
        Of the plan; see `objective`.
    """
    H, n, outputs = len(U), len(scale), Y.shape[1]
    limit = plan[6][CURRENT_LIMIT]
    linear = model[8][COLUMNS] == 0
    stored = 1 if linear else H
    tapes = make_tapes(model, stored)
    A, B = np.zeros((stored, n, n)), np.zeros((stored, n))
    C, D = np.zeros((stored, outputs, n)), np.zeros((stored, outputs))
    X_new, Y_new, U_new = np.zeros((H + 1, n)), np.zeros((H, outputs)), np.zeros(H)
    step = np.zeros(H)
    X_new[0] = X[0]
    roll_out(X, U, Y, X, U, step, gain, 0.0, limit, model, tapes, scale)
    cost, worst = objective(X, Y, U, plan, scale)
    damping, done, small = 0.0, 0, 0
    smallest = 1e-3 * max(plan[3][CURRENT], 1e-12)
    fresh = True
    while done < iterations:
        done += 1
        if fresh:
            for t in range(stored):  # the last plan that was rolled out is the one that was taken
                period_jacobian(model, tape_of(tapes, t), scale, A[t], B[t], C[t], D[t])
        backward(X, Y, U, A, B, C, D, plan, scale, damping, step, gain)
        taken, saved = 0.0, 0.0
        for alpha in alphas:
            roll_out(X_new, U_new, Y_new, X, U, step, gain, alpha, limit, model, tapes, scale)
            cost_new, worst_new = objective(X_new, Y_new, U_new, plan, scale)
            # A comparison with NaN, of a plan that diverged, is False.
            within, kept_new = worst <= 1.0 - MARGIN, worst_new <= 1.0 - MARGIN
            if (kept_new and not within and cost_new == cost_new) or (
                kept_new == within and cost_new <= cost + ROUNDING * abs(cost)
            ):
                taken, saved = alpha, cost - cost_new
                cost, worst = cost_new, worst_new
                X[:], Y[:], U[:] = X_new, Y_new, U_new
                break
        if taken == 0.0:
            # At a minimum no damping helps: the steps it leaves are below rounding.
            damping = max(10.0 * damping, smallest)
            fresh = False
            small += 1
            if small > 6 or iterations == 1:
                break
            continue
        fresh = not linear
        damping = damping / 3.0 if taken >= 0.5 and damping > smallest else damping
        if taken >= 0.5 and damping <= smallest:
            damping = 0.0
        if taken < 0.1:
            damping = max(3.0 * damping, smallest)
        small = small + 1 if saved < tolerance * abs(cost) else 0
        if small >= 2:
            break
    return cost, worst, done


def _cached(number: int) -> Any:
    """Return `improve` for a batch as numba keeps it on disk, for sources of this `stamp`."""

    @njit(cache=True, error_model="numpy", nogil=True)
    def least_costs(
        U: FloatArray,
        X: FloatArray,
        Y: FloatArray,
        gain: FloatArray,
        signals: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
        common: tuple[FloatArray, FloatArray, IntArray, FloatArray, FloatArray],
        models: ModelArrays,
        scale: FloatArray,
        alphas: FloatArray,
        iterations: int,
        tolerance: float,
        results: FloatArray,
    ) -> int:
        target, shear, place, p = signals
        weights, rows, group, bounds, P = common
        for n in range(len(U)):
            model = table_model(models, n if len(models[0]) > 1 else 0)
            tail, own = P[n if len(P) > 1 else 0], weights[n if len(weights) > 1 else 0]
            plan = (target[n], shear[n], place[n], own, rows, group, bounds, tail, p[n])
            cost, worst, done = improve(
                X[n], Y[n], U[n], gain[n], model, scale, plan, alphas, iterations, tolerance
            )
            results[n, 0], results[n, 1], results[n, 2] = cost, worst, done
        return number

    return least_costs


least_costs = _cached(stamp("period_kernel", "ilqr_kernel"))


def _cached_jacobian(number: int) -> Any:
    """Return one period with its Jacobian, for tests and designs."""

    @njit(cache=True, error_model="numpy", nogil=True)
    def jacobian(
        x: FloatArray,
        u: float,
        models: ModelArrays,
        scale: FloatArray,
        moved: FloatArray,
        response: FloatArray,
        A: FloatArray,
        B: FloatArray,
        C_x: FloatArray,
        D_u: FloatArray,
    ) -> int:
        model = table_model(models, 0)
        tape = tape_of(make_tapes(model, 1), 0)
        period(x, u, model, tape, moved, response)
        period_jacobian(model, tape, scale, A, B, C_x, D_u)
        return number

    return jacobian


_jacobian = _cached_jacobian(stamp("period_kernel", "ilqr_kernel"))


def period_with_jacobian(
    x: FloatArray, u: float, models: ModelArrays, scale: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the state (n) a period on, the response (2 k), and A, B, C, D of `period_jacobian`."""
    n, outputs = len(scale), 2 * models[6].shape[1]
    moved, response = np.zeros(n), np.zeros(outputs)
    A, B, C, D = np.zeros((n, n)), np.zeros(n), np.zeros((outputs, n)), np.zeros(outputs)
    _jacobian(x, u, models, scale, moved, response, A, B, C, D)
    return moved, response, A, B, C, D
