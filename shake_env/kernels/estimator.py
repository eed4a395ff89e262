"""A period of an estimator behind a linear law, for a batch of tables in one compiled call.

Beside `agents.policies.estimated_law.EstimatedLaw`, and equal to it to rounding. Tables are taken in
blocks: their memories and observations are turned into rows, and a matrix times the rows is the product
of :mod:`shake_env.kernels.products`, so that a table gets the same bits in any batch.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import boolean, float32, float64, int64, types
from numba.core.typing import signature
from numba.extending import intrinsic
from numpy.typing import NDArray

from shake_env.kernels.compiling import cached, stamp
from shake_env.kernels.products import multiply
from shake_env.kernels.vectors import BLOCK, NUMBERS, TABLE, Code, Rows, whole
from shake_env.model.parameters import FloatArray

IntArray = NDArray[np.int64]


@intrinsic
def _product(_context: Any, matrix: Any, x: Any, columns: Any, rows: Any, y: Any) -> Any:
    """Write the product of a matrix (columns, rows) and rows x to rows y, given by their addresses."""

    def generate(_target: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        code = Code(builder, BLOCK, ir.Constant(TABLE, None))
        at_matrix, at_x, at_y = (builder.inttoptr(arguments[i], NUMBERS) for i in (0, 1, 4))
        given = (arguments[2], arguments[3], Rows(code, at_y))
        multiply(code, at_matrix, whole(0), Rows(code, at_x), *given)
        return arguments[2]

    return signature(types.int64, matrix, x, columns, rows, y), generate


def _made() -> tuple[Any, Any]:
    """Return the functions as numba keeps them on disk."""
    number = stamp()

    def act(
        correction: NDArray[np.float32], authority: float, shown: NDArray[np.float32], out: FloatArray
    ) -> int:
        """Write the actions (N,): corrections (N, 1) times an authority, and the last of `shown`."""
        for lane in range(len(out) if number else 0):
            out[lane] = authority * correction[lane, 0] + shown[lane, shown.shape[1] - 1]
        return 0

    def look(
        lanes: IntArray,
        keeps: bool,
        actions: int,
        given: FloatArray,
        age: IntArray,
        observation: NDArray[np.float32],
        places: IntArray,
        advance: FloatArray,
        gains: FloatArray,
        begins: FloatArray,
        show: FloatArray,
        bound: float,
        memory: FloatArray,
        known: FloatArray,
        shown: NDArray[np.float32],
    ) -> int:
        """Weigh the readings of some tables' observations; see `EstimatedLaw.look`.

        Parameters
        ----------
        lanes
            (P,) indices of the tables, rows of all arrays of N.
        keeps, actions, given
            Whether a memory is first made of what is known, `actions` own actions and the one `given`
            (N,), held within [-1, 1]; see `EstimatedLaw.keep`. At age 0 it is zero.
        age
            (N,) periods since the start of the episode.
        observation
            (N, n)
        places
            (columns,) entries of an observation that are read, those of `advance` first.
        advance, gains, begins, show
            The law's matrices, `advance` and `show` transposed, their columns in the order of `places`.
        bound
            Of what is shown.
        memory, known
            (N, M), written.
        shown
            (N, n + e), written: the observation, and what the law shows.

        Returns
        -------
        0.
        """
        size, entries = memory.shape[1], observation.shape[1]
        estimates, readings, last = gains.shape[1], gains.shape[2], gains.shape[0] - 1
        tall, beliefs, used = advance.shape[1], show.shape[1], advance.shape[0] - size
        forgets = estimates + actions
        x = np.empty((size + len(places), BLOCK))
        y = np.empty((max(tall, beliefs), BLOCK))
        for first in range(0, len(lanes) if number else 0, BLOCK):
            count = min(BLOCK, len(lanes) - first)
            if count < BLOCK:
                x[:] = 0.0
            for i in range(count):
                lane = lanes[first + i]
                held, before, seen = memory[lane], known[lane], observation[lane]
                if age[lane] == 0:
                    held[:] = 0.0
                elif keeps:
                    held[:estimates] = before[:estimates]
                    held[estimates : forgets - 1] = before[estimates + 1 : forgets]
                    held[forgets - 1] = min(max(given[lane], -1.0), 1.0)
                    held[forgets:] = before[forgets:]
                for m in range(size):
                    x[m, i] = held[m]
                for j in range(len(places)):
                    x[size + j, i] = seen[places[j]]
            _product(advance.ctypes.data, x.ctypes.data, size + used, tall, y.ctypes.data)
            for i in range(count):
                lane = lanes[first + i]
                if age[lane] == 0:
                    for m in range(tall):
                        y[m, i] *= begins[m]
                gain, after = gains[min(age[lane], last)], known[lane]
                for m in range(estimates):
                    change = 0.0
                    for r in range(readings):
                        change += gain[m, r] * y[size + r, i]
                    y[m, i] += change
                for m in range(size):
                    x[m, i] = after[m] = y[m, i]
            _product(show.ctypes.data, x.ctypes.data, size + len(places), beliefs, y.ctypes.data)
            for i in range(count):
                row, seen = shown[lanes[first + i]], observation[lanes[first + i]]
                for j in range(entries):
                    row[j] = seen[j]
                for m in range(beliefs):
                    value = y[m, i]
                    row[entries + m] = min(max(value, -bound), bound) if value == value else 0.0
        return 0

    flat, rows, seen = float64[::1], float64[:, ::1], float32[:, ::1]
    law = (int64[::1], rows, float64[:, :, ::1], flat, rows)
    batch = (int64[::1], boolean, int64, flat, int64[::1], seen)
    return (
        cached(int64(seen, float64, seen, flat), act),
        cached(int64(*batch, *law, float64, rows, rows, seen), look),
    )


act, look = _made()
