"""Arrays that a step returns, whose memory is reused once no reference to them is left."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.kernels.layout import REPORT
from shake_env.model.parameters import FloatArray

MOST = 8  # memories kept
SLACK = 64  # [bytes] behind the observations, which the step writes over

DOUBLE, SINGLE, TRUTH = (np.dtype(kind) for kind in (np.float64, np.float32, np.bool_))


class OutputPool:
    """Memory for the observations, reports and ends of N tables.

    Each array that is handed out refers to the memory that it lies in. Memory to which nothing but the
    pool refers is nobody's, and the next step may have it.

    Parameters
    ----------
    lanes
        Number of tables N.
    padded
        With those that fill up the last block.
    shown
        Length n of an observation.
    """

    def __init__(self, lanes: int, padded: int, shown: int) -> None:
        self._lanes, self._padded, self._shown = lanes, padded, shown
        self._seen = 8 * len(REPORT) * padded
        self._ends = self._seen + 4 * shown * padded + SLACK
        self._size = self._ends + 2 * padded
        self._kept: list[Any] = []
        self._free = self._references(self._new())  # of a memory that nobody holds

    def _new(self) -> list[Any]:
        memory = np.empty(self._size, dtype=np.uint8)
        return [memory, memory.ctypes.data]

    @staticmethod
    def _references(entry: list[Any]) -> int:
        return sys.getrefcount(entry[0])

    def take(self) -> tuple[NDArray[np.uint8], int]:
        """Return memory that nobody holds, and its address."""
        for entry in self._kept:
            if self._references(entry) == self._free:
                return entry[0], entry[1]
        entry = self._new()
        if len(self._kept) < MOST:
            self._kept.append(entry)
        return entry[0], entry[1]

    def addresses(self, address: int) -> tuple[int, int, int]:
        """Return where report, observations and ends lie in memory at an address."""
        return address, address + self._seen, address + self._ends

    def views(self, memory: NDArray[np.uint8]) -> tuple[FloatArray, NDArray[np.float32], Any, Any]:
        """Return the report (15, N), observations (N, n), terminated and truncated (N,) in a memory."""
        lanes, padded, shown = self._lanes, self._padded, self._shown
        shape = (lanes,)
        return (
            np.ndarray((len(REPORT), lanes), DOUBLE, memory, 0, (8 * padded, 8)),
            np.ndarray((lanes, shown), SINGLE, memory, self._seen),
            np.ndarray(shape, TRUTH, memory, self._ends),
            np.ndarray(shape, TRUTH, memory, self._ends + padded),
        )
