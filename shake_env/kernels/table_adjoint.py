"""Slopes of the nonlinear parts, transposed, over the lanes of a block: what a reverse sweep is made of.

Beside :func:`shake_env.kernels.lanes.nonlinear`, part by part. Where a part has a corner, its slope is
that of torch's operations in the array-API kernel, so that both are the same number there as well: a
bound lets a gradient through on its edge, and the sign of zero is zero.
"""

from __future__ import annotations

import math

from shake_env.kernels.lanes import (
    DAMPING,
    DEAD_BAND,
    EXCESS,
    EXPONENT,
    FLOW,
    FORCE,
    FRICTION,
    GAP,
    RATE,
    RATE_LIMIT,
    RATED_PRESSURE,
    SLIPS,
    SMOOTHING_VELOCITY,
    SPOOL_LIMIT,
    SPOOL_VELOCITY,
    STATIC,
    STIFFNESS,
    STORIES,
    STRIBECK_VELOCITY,
    SUPPLY_SAG,
    VISCOUS,
    YIELD_DRIFT,
    IntArray,
    expm1,
    jit,
    tanh,
    within,
)
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import LOAD_PRESSURE, SPOOL_POSITION, TABLE_DISPLACEMENT, TABLE_VELOCITY


@jit
def _pull_flow(
    spool: FloatArray,
    pressure: FloatArray,
    v: FloatArray,
    missing: FloatArray,
    seed: FloatArray,
    to_spool: FloatArray,
    to_pressure: FloatArray,
    w: int,
) -> None:
    limit, dead, rated, sag = v[SPOOL_LIMIT], v[DEAD_BAND], v[RATED_PRESSURE], v[SUPPLY_SAG]
    for n in range(w):
        limited = within(spool[n], limit)
        slope = 1.0 if abs(spool[n]) <= limit else 0.0
        past = abs(limited) - dead
        opening = math.copysign(0.0 if past < 0.0 else past, limited)
        slope = 0.0 if past < 0.0 else slope
        sign = 1.0 if opening > 0.0 else (-1.0 if opening < 0.0 else 0.0)
        available = 1.0 - (sign * pressure[n] + (missing[n] + abs(opening) * sag)) / rated
        floored = available < 1e-6
        root = math.sqrt(1e-6 if floored else available)
        steepness = 0.0 if floored else -0.5 * opening * sign / (root * rated)
        to_spool[n] += seed[n] * (slope * (root + steepness * sag) - 1.0)
        to_pressure[n] += seed[n] * steepness


@jit
def _pull_friction(
    velocity: FloatArray,
    v: FloatArray,
    static: bool,
    coulomb: FloatArray,
    seed: FloatArray,
    to_velocity: FloatArray,
    w: int,
) -> None:
    smoothing, viscous = v[SMOOTHING_VELOCITY], v[VISCOUS]
    excess, stribeck = v[EXCESS], v[STRIBECK_VELOCITY]
    if static:
        for n in range(w):
            ratio = velocity[n] / stribeck
            more = excess * (1.0 + expm1(-(ratio * ratio)))
            side = tanh(velocity[n] / smoothing)
            steep = (coulomb[n] + more) * (1.0 - side * side) / smoothing
            to_velocity[n] -= seed[n] * (steep - 2.0 * ratio / stribeck * more * side + viscous)
    else:
        for n in range(w):
            side = tanh(velocity[n] / smoothing)
            to_velocity[n] -= seed[n] * (coulomb[n] * (1.0 - side * side) / smoothing + viscous)


@jit
def _pull_stops(
    displacement: FloatArray,
    velocity: FloatArray,
    v: FloatArray,
    seed: FloatArray,
    to_displacement: FloatArray,
    to_velocity: FloatArray,
    w: int,
) -> None:
    gap, stiffness, damping = v[GAP], v[STIFFNESS], v[DAMPING]
    for n in range(w):
        past = abs(displacement[n]) - gap
        if past >= 0.0:
            sign = 1.0 if displacement[n] > 0.0 else -1.0
            outward, share = sign * velocity[n], past / 1e-3
            steepness = stiffness + (damping * outward / 1e-3 if share <= 1.0 else 0.0)
            share = 1.0 if share > 1.0 else share
            if stiffness * past + damping * outward * share >= 0.0:
                # The sign comes twice: outward is along it, and so is the force against it.
                to_displacement[n] -= seed[n] * steepness
                to_velocity[n] -= seed[n] * damping * share


@jit
def _pull_slips(
    x: FloatArray, v: FloatArray, stories: int, seed: FloatArray, xbar: FloatArray, w: int
) -> None:
    drift_limit, exponent = v[YIELD_DRIFT], v[EXPONENT]
    whole = exponent == math.floor(exponent) and exponent <= 16.0
    for storey in range(stories):
        at, moving_at, slipping = 4 + storey, 4 + stories + storey, 4 + 2 * stories + storey
        below = 0.0 if storey == 0 else 1.0
        for n in range(w):
            z = (x[at, n] - below * x[at - 1, n] - x[slipping, n]) / drift_limit
            rate = x[moving_at, n] - below * x[moving_at - 1, n]
            if rate * z > 0.0:
                size = abs(z)
                bounded = 1.0 if size > 1.0 else size
                before = 1.0  # bounded ** (exponent - 1)
                if whole:
                    for _ in range(int(exponent) - 1):
                        before *= bounded
                else:
                    before = bounded ** (exponent - 1.0)
                to_rate = seed[storey, n] * before * bounded
                xbar[moving_at, n] += to_rate
                xbar[moving_at - 1, n] -= below * to_rate
                if size <= 1.0:
                    along = math.copysign(exponent * before / drift_limit, z)
                    to_drift = seed[storey, n] * rate * along
                    xbar[at, n] += to_drift
                    xbar[at - 1, n] -= below * to_drift
                    xbar[slipping, n] -= to_drift


@jit
def pull(
    x: FloatArray,
    current: FloatArray,
    v: FloatArray,
    s: IntArray,
    coulomb: FloatArray,
    valve: FloatArray,
    seed: FloatArray,
    xbar: FloatArray,
    cbar: FloatArray,
    w: int,
) -> None:
    """Add what a cost's slope along g, ``seed`` (columns, w), is along the state and the current.

    Parameters
    ----------
    x, current, v, s, coulomb, valve
        As for :func:`shake_env.kernels.lanes.nonlinear`.
    seed
        (columns, w) slope of the cost along each of g.
    xbar, cbar
        (order, w) and (w): what is added to.
    """
    if s[FLOW] >= 0:
        _pull_flow(
            x[SPOOL_POSITION], x[LOAD_PRESSURE], v, valve[2], seed[s[FLOW]], xbar[SPOOL_POSITION],
            xbar[LOAD_PRESSURE], w,
        )  # fmt: skip
    if s[FORCE] >= 0:
        if s[FRICTION]:
            _pull_friction(
                x[TABLE_VELOCITY], v, s[STATIC] > 0, coulomb, seed[s[FORCE]], xbar[TABLE_VELOCITY], w
            )
        if v[GAP] < math.inf:
            _pull_stops(
                x[TABLE_DISPLACEMENT], x[TABLE_VELOCITY], v, seed[s[FORCE]], xbar[TABLE_DISPLACEMENT],
                xbar[TABLE_VELOCITY], w,
            )  # fmt: skip
    if s[RATE] >= 0:
        limit, given = v[RATE_LIMIT], seed[s[RATE]]
        if s[SPOOL_VELOCITY] >= 0:
            own = s[SPOOL_VELOCITY]
            for n in range(w):
                xbar[own, n] -= 0.0 if abs(x[own, n]) <= limit else given[n]
        else:
            for n in range(w):
                free = valve[0, n] * x[SPOOL_POSITION, n] + valve[1, n] * current[n]
                over = 0.0 if abs(free) <= limit else given[n]
                xbar[SPOOL_POSITION, n] -= valve[0, n] * over
                cbar[n] -= valve[1, n] * over
    if s[SLIPS] >= 0:
        _pull_slips(x, v, s[STORIES], seed[s[SLIPS] :], xbar, w)
