"""A program that only sleeps and reads the clock: what delays it is the machine.

    python -I -S stall_watch.py CORE PRIORITY INTERVAL

It runs on one core at a real-time priority above that of what it watches, prints `ready`, and when it is
terminated one line for each stall: the last reading of the clock before it and the first after it [s].
The clock is `time.perf_counter`, which all processes of a machine share. It needs no package.
"""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import sys
import time

LATE = 1e-4  # [s] beyond it, from which on a delay is a stall


def main() -> None:
    """Watch until terminated, and print."""
    core, priority, interval = int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
    os.sched_setaffinity(0, {core})
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    stalls: list[tuple[float, float]] = []
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    gc.disable()
    ctypes.CDLL(None).mlockall(3)  # what it is made of, and will be: no page is fetched
    print("ready", flush=True)
    clock, sleep, longest = time.perf_counter, time.sleep, interval + LATE
    try:
        before = clock()
        while True:
            sleep(interval)
            now = clock()
            if now - before > longest:
                stalls.append((before, now))
            before = now
    finally:
        for stall in stalls:
            print(*stall)


if __name__ == "__main__":
    main()
