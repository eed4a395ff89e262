"""One control period of N tables in one compiled call: `TableModel.transition` and `observe`, fused.

The readable model stays the reference, and a test holds this equal to it. What differs is only where
things lie (:mod:`shake_env.simulation.fused_layout`): tables are taken in blocks, with a row for each
quantity, so that every line of arithmetic runs over the lanes of a block. Imported on first use, where
numba is installed.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numba import boolean, float32, float64, int64, njit
from numpy.typing import NDArray

from shake_env.kernels.lanes import (
    BLOCK,
    COLUMNS,
    IntArray,
    add_product,
    fill,
    follow,
    inlined,
    stamp,
    view,
)
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import LOAD_PRESSURE, TABLE_DISPLACEMENT, TABLE_VELOCITY
from shake_env.scenario.limits import OBSERVATION_BOUND
from shake_env.simulation import fused_layout as at

EXACT = 1.5 * 2.0**52  # adding and taking it off rounds to a whole number, half to even


@inlined
def _matrix(v: FloatArray, p: IntArray, block: int, place: int, columns: int, rows: int) -> FloatArray:
    """Return a matrix of a block of tables, (columns, rows, 1 or lanes)."""
    depth = p[at.DEPTH]
    start = block * p[at.STRIDE] + p[place]
    matrix: FloatArray = view(v, start, (columns, rows, depth))
    return matrix


@inlined
def _move(
    before: FloatArray,
    after: FloatArray,
    drive: FloatArray,
    v: FloatArray,
    p: IntArray,
    start: int,
    first: int,
    w: int,
    width: int,
) -> None:
    """Write the state and the response of a block, from the current that `after` holds.

    `start` is where in `v` there is room to work in.
    """
    order, k, commands = p[at.ORDER], p[at.SUBSTEPS], p[at.COMMANDS]
    inputs, rows, block = p[COLUMNS], order + 2 * k, first // width
    tall = order + 1 + inputs
    x, middle = view(v, start, (tall, width)), start + tall * width
    y, start = view(v, middle, (rows, width)), middle + rows * width
    for i in range(order):
        for n in range(w):
            x[i, n] = before[at.STATE + i, first + n]
    if p[at.LIFTED]:
        for n in range(w):
            x[order, n] = after[at.CURRENT, first + n]
        fill(y, 0.0, w)
        add_product(_matrix(v, p, block, at.ADVANCE, order + 1, rows), x, y, w)
        for i in range(p[at.DRIVE]):
            for n in range(w):
                y[i, n] += drive[i, first + n]
        for i in range(rows):
            # Without commands under way the response lies right behind the state.
            for n in range(w):
                after[at.STATE + i, first + n] = y[i, n]
        return
    later, start = view(v, start, (inputs, width)), start + inputs * width
    seen, start = view(v, start, (2, width)), start + 2 * width
    arriving, start = view(v, start, (k, width)), start + k * width
    rate, start = view(v, start, (2, width)), start + 2 * width
    friction = view(v, start, (width,))
    own = p[at.DEPTH] > 1
    picks = _matrix(v, p, block, at.ARRIVAL, commands + 1, k)
    coulomb = _matrix(v, p, block, at.COULOMB, 1, 1)
    spool_rate = _matrix(v, p, block, at.SPOOL_RATE, 1, 2)
    for n in range(w):
        lane = n if own else 0
        friction[n] = coulomb[0, 0, lane]
        rate[0, n], rate[1, n] = spool_rate[0, 0, lane], spool_rate[0, 1, lane]
    for j in range(k):
        for n in range(w):
            lane = n if own else 0
            arriving[j, n] = picks[commands, j, lane] * after[at.CURRENT, first + n]
        for i in range(commands):
            for n in range(w):
                lane = n if own else 0
                arriving[j, n] += picks[i, j, lane] * before[at.STATE + order + i, first + n]
    transition = _matrix(v, p, block, at.ADVANCE, tall, order)
    change = _matrix(v, p, block, at.CHANGE, inputs, order)
    outputs = _matrix(v, p, block, at.OUTPUTS, tall, 2)
    predicted, response = view(v, middle, (order, width)), y[order:]
    follow(
        x,
        predicted,
        later,
        seen,
        arriving,
        transition,
        change,
        outputs,
        v,
        p,
        friction,
        rate,
        response,
        w,
    )  # fmt: skip
    for i in range(order):
        for n in range(w):
            after[at.STATE + i, first + n] = x[i, n]
    for i in range(commands):
        source = before[at.STATE + order + i + 1] if i + 1 < commands else after[at.CURRENT]
        for n in range(w):
            after[at.STATE + order + i, first + n] = source[first + n]
    for i in range(2 * k):
        for n in range(w):
            after[p[at.RESPONSE] + i, first + n] = response[i, n]


@inlined
def _price(
    after: FloatArray, ground: FloatArray, weights: FloatArray, p: IntArray, first: int, w: int
) -> None:
    """Write the terms of the stage cost; see `StageCost.terms`."""
    k = p[at.SUBSTEPS]
    target, own = p[at.FILTER] + p[at.REFERENCE], weights.shape[2] > 1
    for part in range(2):
        total = after[at.ACCELERATION_COST + part]
        for n in range(w):
            total[first + n] = 0.0
        for j in range(k):
            ours, theirs = after[p[at.RESPONSE] + part * k + j], ground[target + part * k + j]
            for n in range(w):
                error = ours[first + n] - theirs[first + n]
                total[first + n] += error * error
        for n in range(w):
            total[first + n] = weights[0, part, n if own else 0] * (total[first + n] / k)
    current = after[at.CURRENT]
    for n in range(w):
        square = current[first + n] * current[first + n]
        after[at.CURRENT_COST, first + n] = weights[0, 2, n if own else 0] * square


@inlined
def _judge(
    after: FloatArray, size: FloatArray, number: int, soft: bool, v: FloatArray, first: int, w: int
) -> None:
    """Hold the size (w) of a quantity against its limit, and price what comes close."""
    limit = v[at.LIMITS + number - 1]
    if limit == np.inf:
        return
    code, cost = after[at.BROKEN], after[at.SOFT_COST]
    for n in range(w):
        # Compared with 0.0 first, as the first limit that broke is the one to be named.
        if code[first + n] == 0.0 and size[n] > limit:
            code[first + n] = number
    if soft and v[at.SOFT_WEIGHT] > 0.0:
        share = v[at.SOFT_SHARE]
        span = 1.0 - share
        for n in range(w):
            beyond = (size[n] / limit - share) / span
            beyond = 0.0 if beyond < 0.0 else beyond
            cost[first + n] += v[at.SOFT_WEIGHT] * (beyond * beyond)


@inlined
def _largest(rows: FloatArray, size: FloatArray, first: int, w: int) -> None:
    """Write the largest absolute value of each lane's rows, NaN if there is one."""
    for n in range(w):
        size[n] = 0.0
    for i in range(len(rows)):
        for n in range(w):
            value = abs(rows[i, first + n])
            size[n] = size[n] if value <= size[n] else value


@inlined
def _check(after: FloatArray, v: FloatArray, p: IntArray, size: FloatArray, first: int, w: int) -> None:
    """Write which limit broke and what soft limits cost; see `Limits.broken` and `soft_cost`."""
    code, cost = after[at.BROKEN], after[at.SOFT_COST]
    for n in range(w):
        code[first + n] = cost[first + n] = 0.0
    for i in range(p[at.CONTROLLED]):
        if i == TABLE_DISPLACEMENT:
            continue
        bound, state = v[at.SCALES + p[at.FILTER] + i] * v[at.STATE_LIMIT], after[at.STATE + i]
        for n in range(w):
            # `not <=`, so that a NaN counts as diverged.
            code[first + n] = code[first + n] if abs(state[first + n]) <= bound else 1.0
    k, row = p[at.SUBSTEPS], p[at.RESPONSE]
    places = (TABLE_DISPLACEMENT, TABLE_VELOCITY, LOAD_PRESSURE)
    for i in range(3):
        _largest(after[at.STATE + places[i] : at.STATE + places[i] + 1], size, first, w)
        _judge(after, size, 2 + i, True, v, first, w)
    _largest(after[row : row + k], size, first, w)
    _judge(after, size, 5, True, v, first, w)
    _largest(after[at.CURRENT : at.CURRENT + 1], size, first, w)
    _judge(after, size, 6, False, v, first, w)
    if p[at.FLOORS]:
        _largest(after[p[at.FLOOR_ROW] : p[at.FLOOR_ROW] + p[at.FLOORS]], size, first, w)
        _judge(after, size, 7, True, v, first, w)


@inlined
def _close(
    after: FloatArray,
    ends: FloatArray,
    counters: IntArray,
    own: FloatArray,
    v: FloatArray,
    first: int,
    w: int,
) -> int:
    """Count the period, price a broken limit, write the reward; return which ends occurred."""
    happened = 0
    for lane in range(first, first + w):
        counters[0, lane] += 1
        left = counters[1, lane] - counters[0, lane]
        broken, price = after[at.BROKEN, lane] != 0.0, 0.0
        if broken:
            price = v[at.LIMIT_RATE] * own[0, lane] * min(float(max(left, 1)), v[at.LIMIT_STEPS])
            happened |= at.TERMINATED
        elif left <= 0:
            happened |= at.TRUNCATED
        ends[0, lane], ends[1, lane] = broken, left <= 0 and not broken
        after[at.LIMIT_COST, lane] = price
        stage = after[at.ACCELERATION_COST, lane] + after[at.FORCE_COST, lane]
        stage += after[at.CURRENT_COST, lane]
        after[at.REWARD, lane] = -(stage + after[at.SOFT_COST, lane] + price)
    return happened


@inlined
def _read(
    before: FloatArray,
    after: FloatArray,
    noise: FloatArray,
    own: FloatArray,
    v: FloatArray,
    p: IntArray,
    shown: FloatArray,
    sample: int,
    first: int,
    w: int,
) -> None:
    """Write the sensors' memory, and `shown` (s, w): readings over scale; see `Measurement.read`."""
    last = p[at.RESPONSE] + p[at.SUBSTEPS] - 1
    for i in range(p[at.READINGS]):
        place = p[at.SIGNALS + i]
        row = at.STATE + place
        if place == at.ACCELERATION_SIGNAL:
            row = last
        elif place == at.SHEAR_SIGNAL:
            row = last + p[at.SUBSTEPS]
        elif place >= at.FLOOR_SIGNAL:
            row = p[at.FLOOR_ROW] + place - at.FLOOR_SIGNAL
        signal, filtered, held = after[row], after[p[at.FILTERED] + i], before[p[at.FILTERED] + i]
        share, resolution = v[p[at.FOLLOW] + i], v[p[at.RESOLUTION] + i]
        rounded, scale = v[p[at.ROUNDED] + i], v[p[at.READING_SCALE] + i]
        for n in range(w):
            lane = first + n
            filtered[lane] = held[lane] + share * (signal[lane] - held[lane])
            reading = filtered[lane] + own[1 + i, lane] + noise[lane, sample, i]
            steps = reading / resolution
            whole = (steps + EXACT) - EXACT if abs(steps) < EXACT / 3.0 else steps
            shown[i, n] = (reading + rounded * (whole * resolution - reading)) / scale


@inlined
def _put(look: FloatArray, column: int, rows: FloatArray, scale: FloatArray, start: int, w: int) -> int:
    """Write rows over their scale to those of an observation, bounded; return the next one.

    Only the drifting position, or a table that has just diverged, comes near the bound. A NaN becomes 0.
    """
    for i in range(len(rows)):
        size, out = scale[min(i, len(scale) - 1)], look[column + i]
        for n in range(w):
            value = rows[i, start + n] / size
            value = OBSERVATION_BOUND if value > OBSERVATION_BOUND else value
            value = -OBSERVATION_BOUND if value < -OBSERVATION_BOUND else value
            out[n] = value if value == value else 0.0
    return column + len(rows)


@inlined
def _show(
    seen: NDArray[np.float32],
    before: FloatArray,
    after: FloatArray,
    ground: FloatArray,
    shown: FloatArray,
    look: FloatArray,
    v: FloatArray,
    p: IntArray,
    cursor: int,
    first: int,
    w: int,
) -> None:
    """Write the observation, (N, n), by way of its block's (n, w); see `TableModel.observe`."""
    now, head, k = ground[cursor], p[at.FILTER], p[at.SUBSTEPS]
    scale, one = v[at.SCALES : p[at.FOLLOW]], v[at.ONE : at.ONE + 1]
    column = _put(look, 0, now[:head], scale, first, w)
    if p[at.FULL_STATE]:
        state = after[at.STATE : at.STATE + p[at.CONTROLLED]]
        column = _put(look, column, state, scale[head:], first, w)
        reference = now[head : head + p[at.REFERENCE]]
        column = _put(look, column, reference, scale[head + p[at.CONTROLLED] :], first, w)
    column = _put(look, column, shown, one, 0, w)
    target, size = head + p[at.REFERENCE], v[at.PREVIEW_SCALE : at.PREVIEW_SCALE + 1]
    for i in range(p[at.SAMPLES]):
        ahead = (i + 1) * p[at.SPACING] - 1
        row = target + ahead % k
        coming = ground[cursor + 1 + ahead // k, row : row + 1]
        column = _put(look, column, coming, size, first, w)
    if p[at.LAST_ACTION]:
        column = _put(look, column, after[p[at.ACTION] : p[at.ACTION] + 1], one, first, w)
    _put(look, column, before[p[at.PAST] : p[at.PAST] + p[at.HISTORY]], one, first, w)
    for n in range(w):
        for i in range(len(look)):
            seen[first + n, i] = look[i, n]


@inlined
def _remember(
    before: FloatArray, after: FloatArray, shown: FloatArray, p: IntArray, first: int, w: int
) -> None:
    """Put this period in front of the history; see `Measurement.remember`."""
    if p[at.HISTORY] == 0:
        return
    past, readings = p[at.PAST], p[at.READINGS]
    entry = readings + p[at.LAST_ACTION]
    for i in range(readings):
        for n in range(w):
            after[past + i, first + n] = shown[i, n]
    if p[at.LAST_ACTION]:
        for n in range(w):
            after[past + readings, first + n] = after[p[at.ACTION], first + n]
    for i in range(entry, p[at.HISTORY]):
        for n in range(w):
            after[past + i, first + n] = before[past + i - entry, first + n]


@inlined
def _period(
    before: FloatArray,
    after: FloatArray,
    observation: NDArray[np.float32],
    ends: NDArray[np.bool_],
    ground: FloatArray,
    noise: FloatArray,
    v: FloatArray,
    p: IntArray,
    cursor: int,
    sample: int,
    lanes: int,
) -> int:
    """Advance N tables by one control period.

    Parameters
    ----------
    before, after
        (rows, N) the block of the last period, read, and of this one, written.
    observation, ends
        (N n,) and (2, N) terminated and truncated, written.
    ground
        (rows, width, N) the ground ahead, of which `cursor` is the row of this period.
    noise
        (N, rows, s) of the readings, of which `sample` is the row of this period, SI.
    v, p
        Everything else; see `packing.Packed`.
    lanes
        N, which is compiled in where the caller gives a literal.

    Returns
    -------
    Bits of TERMINATED and TRUNCATED, where any table's episode ended so.
    """
    happened, width = 0, min(BLOCK, lanes)
    seen = view(observation, 0, (lanes, len(observation) // lanes))
    action = view(v, p[at.GIVEN], (lanes,))
    own = view(v, p[at.OWN], (1 + p[at.READINGS], lanes))
    counters = view(p, p[at.COUNTERS], (2, lanes))
    size, start = view(v, p[at.ROOM], (width,)), p[at.ROOM] + width
    readings, columns, floors = p[at.READINGS], p[at.FLOOR_COLUMNS], p[at.FLOORS]
    shown, start = view(v, start, (readings, width)), start + readings * width
    look = view(v, start, (seen.shape[1], width))  # where the others have done
    target, now = p[at.FILTER] + p[at.REFERENCE], ground[cursor]
    last = target + p[at.SUBSTEPS] - 1
    for first in range(0, lanes, width):
        w, block = min(width, lanes - first), first // width
        for n in range(first, first + w):
            bounded = -1.0 if action[n] < -1.0 else action[n]
            bounded = 1.0 if bounded > 1.0 else bounded
            after[p[at.ACTION], n], after[at.CURRENT, n] = bounded, v[at.CURRENT_LIMIT] * bounded
        _move(before, after, now[last + 1 + p[at.SUBSTEPS] :], v, p, start, first, w, width)
        _price(after, now, _matrix(v, p, block, at.COST, 1, 3), p, first, w)
        if floors:
            x, y = view(v, start, (columns, width)), view(v, start + columns * width, (floors, width))
            for i in range(columns):
                for n in range(w):
                    x[i, n] = after[at.STATE + 4 + i, first + n]
            fill(y, 0.0, w)
            add_product(_matrix(v, p, block, at.FLOOR_MAP, columns, floors), x, y, w)
            for i in range(floors):
                for n in range(w):
                    after[p[at.FLOOR_ROW] + i, first + n] = y[i, n]
        _check(after, v, p, size, first, w)
        happened |= _close(after, ends, counters, own, v, first, w)
        _read(before, after, noise, own, v, p, shown, sample, first, w)
        _show(seen, before, after, ground, shown, look, v, p, cursor, first, w)
        _remember(before, after, shown, p, first, w)
        end = p[at.RESPONSE] + p[at.SUBSTEPS] - 1
        for n in range(first, first + w):
            after[at.TABLE_ACCELERATION, n] = after[end, n]
            after[at.TARGET_ACCELERATION, n] = now[last, n]
            after[at.BASE_SHEAR, n] = after[end + p[at.SUBSTEPS], n]
            after[at.REFERENCE_SHEAR, n] = now[last + p[at.SUBSTEPS], n]
            after[at.DISPLACEMENT, n] = after[at.STATE + TABLE_DISPLACEMENT, n]
            after[at.VELOCITY, n] = after[at.STATE + TABLE_VELOCITY, n]
            after[at.PRESSURE, n] = after[at.STATE + LOAD_PRESSURE, n]
    return happened


def _kept(number: int, alone: bool) -> Any:
    """Return `period` as numba keeps it on disk, for sources of this `stamp`; of one table `alone`."""

    @njit(
        int64(
            float64[:, ::1], float64[:, ::1], float32[::1], boolean[:, ::1], float64[:, :, ::1],
            float64[:, :, ::1], float64[::1], int64[::1], int64, int64,
        ),
        cache=True,
        error_model="numpy",
        nogil=True,
    )  # fmt: skip
    def kept(
        before: FloatArray,
        after: FloatArray,
        observation: NDArray[np.float32],
        ends: NDArray[np.bool_],
        ground: FloatArray,
        noise: FloatArray,
        v: FloatArray,
        p: IntArray,
        cursor: int,
        sample: int,
    ) -> int:
        lanes = 1 if alone else before.shape[1]
        happened = _period(before, after, observation, ends, ground, noise, v, p, cursor, sample, lanes)
        return happened if number else 0

    return kept


@lru_cache(maxsize=2)
def period_of(lanes: int) -> Any:
    """Return what advances so many tables: see `_period`, without its last argument.

    One table alone has a function of its own, whose loops over lanes the compiler has taken out. Each is
    compiled when it is first asked for.
    """
    return _kept(stamp(), lanes == 1)
