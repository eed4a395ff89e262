"""The ground and the reference specimen, a block of control periods ahead, compiled; see `excitation`.

Imported on first use only, where numba is installed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import float64, int64, njit, types

from shake_env.kernels.lanes import BLOCK, IntArray, add_product, fill, jit, scalars, slip_rates, stamp
from shake_env.model.nonlinearity import Nonlinearity, Yielding
from shake_env.model.parameters import FloatArray


@jit
def _gather(maps: FloatArray, lanes: IntArray, start: int, count: int, step: FloatArray) -> None:
    """Write maps (1 or N, rows, columns) of lanes from `start` on to step (columns, rows, count)."""
    for n in range(count):
        held = maps[lanes[start + n] if len(maps) > 1 else 0]
        for i in range(held.shape[0]):
            for j in range(held.shape[1]):
                step[j, i, n] = held[i, j]


@jit
def _run_filter(
    ground: FloatArray,
    noise: FloatArray,
    tail: FloatArray,
    maps: FloatArray,
    lanes: IntArray,
    intensity: FloatArray,
    which: IntArray,
    amplitude: FloatArray,
    first: int,
) -> None:
    """Fill rows `first` to the end of `ground` for some tables, from their draws.

    Parameters
    ----------
    ground
        (length, width, N) the ground ahead, written.
    noise
        (n or more, length, draws) of which as many rows are used as there are to fill.
    tail
        (N, exogenous states) at the filled end, moved on.
    maps
        (1 or N, width, exogenous states + draws): one for all tables, or one for each.
    lanes
        (n,) which tables, in order.
    intensity, which
        (kinds, rows, k) of the motion in each physics step, and (n,) which kind each table has.
    amplitude
        (n,) of each motion.
    """
    rows, states, draws = ground.shape[1], tail.shape[1], noise.shape[2]
    substeps = intensity.shape[2]
    rank = draws // substeps
    own, width = len(maps) > 1, min(BLOCK, len(lanes))
    depth = width if own else 1
    step = np.empty((states + draws, rows, depth))
    x, y = np.empty((states + draws, width)), np.empty((rows, width))
    for start in range(0, len(lanes), width):
        w = min(width, len(lanes) - start)
        if own or start == 0:
            _gather(maps, lanes, start, w if own else 1, step)
        lane = lanes[start]
        neighbours = lanes[start + w - 1] - lane == w - 1  # they come in order, each once
        for n in range(w):
            for i in range(states):
                x[i, n] = tail[lanes[start + n], i]
        for row in range(first, len(ground)):
            offset = row - first
            for n in range(w):
                drawn, level = noise[start + n, offset], intensity[which[start + n], offset]
                for j in range(substeps):
                    for i in range(rank):
                        # In this order, to the last bit: intensity, then amplitude.
                        shaped = drawn[j * rank + i] * level[j] * amplitude[start + n]
                        x[states + j * rank + i, n] = shaped
            fill(y, 0.0, w)
            add_product(step, x, y, w)
            if neighbours:
                for i in range(rows):
                    for n in range(w):
                        ground[row, i, lane + n] = y[i, n]
            else:
                for i in range(rows):
                    for n in range(w):
                        ground[row, i, lanes[start + n]] = y[i, n]
            for i in range(states):
                for n in range(w):
                    x[i, n] = y[i, n]
        for n in range(w):
            for i in range(states):
                tail[lanes[start + n], i] = x[i, n]


@jit
def _run_records(
    ground: FloatArray,
    samples: FloatArray,
    states: FloatArray,
    tail: FloatArray,
    maps: FloatArray,
    lanes: IntArray,
    first: int,
) -> None:
    """Fill rows `first` to the end of `ground` for tables under recorded motions.

    Parameters
    ----------
    ground, tail, lanes
        As for `_run_filter`.
    samples
        (n, rows k + 1) target acceleration at the ends of the physics steps.
    states
        (n, rows, filter states) of the ground at the ends of the periods.
    maps
        (1 or N, reference states + outputs, reference states + k + 1).
    """
    width, exogenous, filtered = min(BLOCK, len(lanes)), tail.shape[1], states.shape[2]
    rows, columns, reference = maps.shape[1], maps.shape[2], exogenous - filtered
    substeps = columns - reference - 1
    own = len(maps) > 1
    step = np.empty((columns, rows, width if own else 1))
    x, y = np.empty((columns, width)), np.empty((rows, width))
    for start in range(0, len(lanes), width):
        w = min(width, len(lanes) - start)
        if own or start == 0:
            _gather(maps, lanes, start, w if own else 1, step)
        for n in range(w):
            for i in range(reference):
                x[i, n] = tail[lanes[start + n], filtered + i]
        for row in range(first, len(ground)):
            begin = (row - first) * substeps
            for n in range(w):
                for i in range(substeps + 1):
                    x[reference + i, n] = samples[start + n, begin + i]
            fill(y, 0.0, w)
            add_product(step, x, y, w)
            for n in range(w):
                lane = lanes[start + n]
                for i in range(filtered):
                    ground[row, i, lane] = states[start + n, row - first, i]
                for i in range(reference):
                    ground[row, filtered + i, lane] = x[i, n] = y[i, n]
                for i in range(substeps):
                    ground[row, exogenous + i, lane] = samples[start + n, begin + i + 1]
                for i in range(reference, rows):
                    ground[row, filtered + substeps + i, lane] = y[i, n]
        for n in range(w):
            for i in range(reference):
                tail[lanes[start + n], filtered + i] = x[i, n]


@jit
def _run_yielding(
    ground: FloatArray,
    slipping: FloatArray,
    last: FloatArray,
    maps: FloatArray,
    slopes: FloatArray,
    shears: FloatArray,
    v: FloatArray,
    lanes: IntArray,
    first: int,
    filtered: int,
    substeps: int,
) -> None:
    """Put a yielding reference in the place of the linear one, as `YieldingReference.run` follows it.

    Parameters
    ----------
    ground, lanes
        As for `_run_filter`; the target is read.
    slipping, last
        (N, 3 stories) and (N,): state of the reference and target at the filled end, moved on.
    maps, slopes, shears
        (1 or N, 3 stories, ...) of ``[x, target, next target, slip rates]`` and of the change of the
        rates, and (1 or N, 1, 3 stories) of the base shear.
    v
        Scalars, as `scalars` returns them.
    filtered, substeps
        Filter states, and physics steps k of a period.
    """
    width, order, columns = min(BLOCK, len(lanes)), slipping.shape[1], maps.shape[2]
    stories = order // 3
    target = filtered + 2 * stories
    own = len(maps) > 1
    depth = width if own else 1
    step, change = np.empty((columns, order, depth)), np.empty((stories, order, depth))
    seen = np.empty((order, 1, depth))
    # Four rows of a table at rest in front, for `slip_rates`.
    x, y = np.zeros((4 + columns, width)), np.zeros((4 + order, width))
    later, shear = np.empty((stories, width)), np.empty((1, width))
    state, moved, rates = x[4:], y[4:], x[4 + order + 2 :]
    for start in range(0, len(lanes), width):
        w = min(width, len(lanes) - start)
        if own or start == 0:
            count = w if own else 1
            _gather(maps, lanes, start, count, step)
            _gather(slopes, lanes, start, count, change)
            _gather(shears, lanes, start, count, seen)
        for n in range(w):
            for i in range(order):
                state[i, n] = slipping[lanes[start + n], i]
            state[order, n] = last[lanes[start + n]]
        slip_rates(x, v, stories, rates, w)
        for row in range(first, len(ground)):
            for j in range(substeps):
                for n in range(w):
                    state[order + 1, n] = ground[row, target + j, lanes[start + n]]
                fill(moved, 0.0, w)
                add_product(step, state, moved, w)
                slip_rates(y, v, stories, later, w)
                for i in range(stories):
                    for n in range(w):
                        later[i, n] -= rates[i, n]
                add_product(change, later, moved, w)
                for i in range(order):
                    for n in range(w):
                        state[i, n] = moved[i, n]
                for n in range(w):
                    state[order, n] = state[order + 1, n]
                slip_rates(x, v, stories, rates, w)
                fill(shear, 0.0, w)
                add_product(seen, state, shear, w)
                for n in range(w):
                    ground[row, target + substeps + j, lanes[start + n]] = shear[0, n]
            for n in range(w):
                for i in range(2 * stories):
                    ground[row, filtered + i, lanes[start + n]] = state[i, n]
        for n in range(w):
            for i in range(order):
                slipping[lanes[start + n], i] = state[i, n]
            last[lanes[start + n]] = state[order, n]


_block, _rows = float64[:, :, ::1], float64[:, ::1]
_maps = types.Array(float64, 3, "A", readonly=True)


def _kept(number: int) -> Any:
    """Return the three as numba keeps them on disk, for sources of this `stamp`."""
    keep = {"cache": True, "error_model": "numpy", "nogil": True}

    @njit(
        int64(_block, _block, _rows, _maps, int64[::1], _block, int64[::1], float64[::1], int64), **keep
    )
    def noise_rows(
        ground: FloatArray,
        noise: FloatArray,
        tail: FloatArray,
        maps: FloatArray,
        lanes: IntArray,
        intensity: FloatArray,
        which: IntArray,
        amplitude: FloatArray,
        first: int,
    ) -> int:
        _run_filter(ground, noise, tail, maps, lanes, intensity, which, amplitude, first)
        return number

    @njit(int64(_block, _rows, _block, _rows, _maps, int64[::1], int64), **keep)
    def record_rows(
        ground: FloatArray,
        samples: FloatArray,
        states: FloatArray,
        tail: FloatArray,
        maps: FloatArray,
        lanes: IntArray,
        first: int,
    ) -> int:
        _run_records(ground, samples, states, tail, maps, lanes, first)
        return number

    @njit(
        int64(
            _block, _rows, float64[::1], _maps, _maps, _maps, float64[::1], int64[::1], int64, int64,
            int64,
        ),
        **keep,
    )  # fmt: skip
    def yielding_rows(
        ground: FloatArray,
        slipping: FloatArray,
        last: FloatArray,
        maps: FloatArray,
        slopes: FloatArray,
        shears: FloatArray,
        v: FloatArray,
        lanes: IntArray,
        first: int,
        filtered: int,
        substeps: int,
    ) -> int:
        _run_yielding(ground, slipping, last, maps, slopes, shears, v, lanes, first, filtered, substeps)
        return number

    return noise_rows, record_rows, yielding_rows


def law(yielding: Yielding) -> FloatArray:
    """Return the scalars of a yielding law for `run_yielding`."""
    return scalars(Nonlinearity(yielding=yielding))


run_filter, run_records, run_yielding = _kept(stamp())
