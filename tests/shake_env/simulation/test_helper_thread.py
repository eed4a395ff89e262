"""Helpers take what work is left, and nobody waits for one that is late."""

import gc
import sys
import threading
import time
from itertools import pairwise

import numpy as np
import pytest

from shake_env.kernels.layout import PLACES
from shake_env.simulation.helper_thread import Helpers

FIRST, LAST = PLACES["first"], PLACES["last"]


def helpers(work, threads, bounds):
    """Return helpers whose call hands `work` the piece of the table at an address."""
    tables = [np.zeros(len(PLACES), dtype=np.int64) for _ in range(threads)]
    by_address = {table.ctypes.data: table for table in tables}

    def call(address):
        table = by_address[address]
        return work(int(table[FIRST]), int(table[LAST]))

    return Helpers(call, tables, bounds)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_every_piece_is_done_once_in_each_call(threads):
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)  # threads take turns often
    try:
        done, names = [], set()

        def work(first, last):
            done.append((first, last))
            names.add(threading.get_ident())
            if len(done) % 3 == 0:
                time.sleep(1e-4)
            return 1 << first if first % 2 else 0

        bounds = [0, 1, 3, 4, 8, 9, 10]
        run = helpers(work, threads, bounds)
        for _ in range(200):
            done.clear()
            assert run() == sum(1 << first for first in bounds[:-1] if first % 2)
            assert sorted(done) == list(pairwise(bounds))
        assert len(names) > 1 or threads == 1
    finally:
        sys.setswitchinterval(interval)


def test_nobody_waits_for_a_helper_that_is_late():
    run = helpers(lambda first, last: 0, 2, [0, 1, 2])
    run()
    turns = run._turns[0]
    time.sleep(0.01)  # it sleeps again
    real, turns.wake = turns.wake, lambda: None
    for _ in range(5):
        assert run() == 0  # without it
    turns.wake = real
    assert run() == 0


def test_threads_end_with_what_they_help():
    before = set(threading.enumerate())
    run = helpers(lambda first, last: 0, 3, [0, 1, 2])
    run()
    own = set(threading.enumerate()) - before
    assert len(own) == 2
    del run
    gc.collect()
    for thread in own:
        thread.join(timeout=10.0)
    assert not any(thread.is_alive() for thread in own)
