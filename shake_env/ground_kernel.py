"""The ground under filtered noise, a block of control periods ahead, compiled; see `excitation`.

Imported on first use only, where numba is installed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import float64, int64, njit, types

from shake_env.block_kernel import BLOCK, IntArray, add_product, fill, jit, stamp
from shake_env.parameters import FloatArray


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
            for n in range(w if own else 1):
                held = maps[lanes[start + n] if own else 0]
                for i in range(rows):
                    for j in range(states + draws):
                        step[j, i, n] = held[i, j]
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


def _kept(number: int) -> Any:
    """Return `_run_filter` as numba keeps it on disk, for sources of this `stamp`."""

    @njit(
        int64(
            float64[:, :, ::1], float64[:, :, ::1], float64[:, ::1],
            types.Array(float64, 3, "A", readonly=True), int64[::1], float64[:, :, ::1], int64[::1],
            float64[::1], int64,
        ),
        cache=True,
        error_model="numpy",
        nogil=True,
    )  # fmt: skip
    def kept(
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

    return kept


run_filter = _kept(stamp())
