"""A thread that makes one compiled call whenever it is told to."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray


class _Turns:
    """What a helper and its thread share."""

    def __init__(self, call: Callable[[int], int], table: NDArray[np.int64]) -> None:
        self.call, self.table = call, table
        self.go, self.done = threading.Lock(), threading.Lock()
        self.go.acquire()
        self.done.acquire()
        self.over, self.ended = False, 0

    def run(self) -> None:
        while True:
            self.go.acquire()
            if self.over:
                return
            self.ended = self.call(self.table.ctypes.data)
            self.done.release()

    def stop(self) -> None:
        self.over = True
        self.go.release()


class Helper:
    """Calls a function of an address in a thread of its own; numba lets go of Python meanwhile.

    Parameters
    ----------
    call
        The compiled function.
    table
        What its argument is the address of.
    """

    def __init__(self, call: Callable[[int], int], table: NDArray[np.int64]) -> None:
        self._turns = _Turns(call, table)
        self._thread: threading.Thread | None = None

    def begin(self) -> None:
        """Make the call."""
        if self._thread is None or not self._thread.is_alive():  # not yet, or left behind by a fork
            if self._thread is not None:
                self._turns = _Turns(self._turns.call, self._turns.table)
            self._thread = threading.Thread(target=self._turns.run, daemon=True)
            self._thread.start()
            weakref.finalize(self, self._turns.stop)
        self._turns.go.release()

    def end(self) -> int:
        """Wait for the call, and return what it returned."""
        self._turns.done.acquire()
        return self._turns.ended
