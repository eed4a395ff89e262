"""Threads that take a share of a compiled call's work, as much of it as they come to.

The work is cut into pieces that are taken one by one. A helper that wakes late, because the processor
is busy with other work, finds fewer pieces left or none, and nobody waits for it; a piece that it has
begun is waited for. The compiled call releases Python's lock.
"""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from shake_env.kernels.layout import PLACES

IntArray = NDArray[np.int64]
_FIRST, _LAST = PLACES["first"], PLACES["last"]


class _Work:
    """Pieces of one call, which several threads take."""

    def __init__(self, call: Callable[[int], int], bounds: Sequence[int]) -> None:
        self.call = call
        self.pieces = list(pairwise(bounds))
        self.left: list[tuple[int, int]] = []  # of the present call
        self.ended: list[int] = []  # what pieces of it returned, but for zeros

    def do(self, table: IntArray, address: int) -> None:
        """Take pieces until there are none, in a table of this thread's own."""
        left = self.left
        while left:
            try:
                first, last = left.pop()
            except IndexError:  # another thread was faster
                break
            table[_FIRST], table[_LAST] = first, last
            if ended := self.call(address):
                self.ended.append(ended)


class _Turns:
    """What a helper and its thread share; it knows nothing of the helper, which may be forgotten."""

    def __init__(self, work: _Work, table: IntArray) -> None:
        self.work, self.table = work, table
        self.go, self.idle = threading.Lock(), threading.Lock()
        self.go.acquire()
        self.over = False

    def run(self) -> None:
        address = self.table.ctypes.data
        while True:
            self.go.acquire()
            if self.over:
                return
            with self.idle:
                self.work.do(self.table, address)

    def wake(self) -> None:
        if self.go.locked():  # else it has been woken before, and has not come yet
            self.go.release()

    def stop(self) -> None:
        self.over = True
        self.wake()


class Helpers:
    """A compiled call made by several threads.

    Parameters
    ----------
    call
        The compiled function of the address of a table.
    tables
        One for each thread, the caller's first.
    bounds
        Of the pieces: ``first`` and ``last`` of a piece are one of them and the next.
    """

    def __init__(
        self, call: Callable[[int], int], tables: Sequence[IntArray], bounds: Sequence[int]
    ) -> None:
        self._work = _Work(call, bounds)
        self._table, self._address = tables[0], tables[0].ctypes.data
        self._turns = [_Turns(self._work, table) for table in tables[1:]]
        self._threads: list[threading.Thread | None] = [None] * len(self._turns)

    def __call__(self) -> int:
        """Make the call for all pieces, and return what any of them returned."""
        work = self._work
        work.ended.clear()
        work.left = work.pieces.copy()
        for i, thread in enumerate(self._threads):
            if thread is None or not thread.is_alive():  # not yet, or left behind by a fork
                self._begin(i)
            self._turns[i].wake()
        work.do(self._table, self._address)
        for turns in self._turns:
            with turns.idle:  # whoever has begun a piece ends it
                pass
        ended = 0
        for each in work.ended:
            ended |= each
        return ended

    def _begin(self, i: int) -> None:
        if self._threads[i] is not None:
            self._turns[i] = _Turns(self._work, self._turns[i].table)
        turns = self._turns[i]
        thread = threading.Thread(target=turns.run, daemon=True)
        self._threads[i] = thread
        thread.start()
        weakref.finalize(self, turns.stop)
