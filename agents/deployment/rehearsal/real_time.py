"""Real-time priority for a rehearsal's two processes, and a watch over the machine that runs them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

PRIORITY, WATCH = 40, 41  # of SCHED_FIFO: table and controller, and what watches the machine


@dataclass
class Machine:
    """How the machine ran a test that followed the clock."""

    cores: tuple[int, ...] = ()  # of table and controller, at real-time priority; (): as other programs
    gap: float = 0.0  # [s] longest of a loop that only read the clock, before the test
    watched: bool = False  # for stalls, which below real-time priority may be other programs' work
    stalls: list[tuple[float, float]] = field(default_factory=list)  # (before, after) [s] of the clock

    def summary(self) -> dict[str, Any]:
        """Return plain values; times in microseconds, of stalls None where nothing watched."""
        lengths = [1e6 * (after - before) for before, after in self.stalls]
        return {
            "real_time": bool(self.cores),
            "cores": list(self.cores),
            "clock_gap_us": 1e6 * self.gap,
            "stalls": len(lengths) if self.watched else None,
            "longest_stall_us": max(lengths, default=0.0) if self.watched else None,
        }


@contextmanager
def real_time(pid: int, deadline: float) -> Iterator[Machine]:
    """Run this thread and a process at real-time priority on a core each, and watch these cores.

    Where the system does not permit it, or has no such priorities, both run as they did and nothing is
    watched.

    Parameters
    ----------
    pid
        Of the other process; it may end within.
    deadline
        [s] that the machine must keep: the clock is looked at twice in it.

    Yields
    ------
    machine
        Complete at the end.
    """
    machine, watches = Machine(), list[subprocess.Popen[str]]()
    with ExitStack() as undo:
        cores = _take(pid, undo)
        try:
            machine.cores = cores
            watches += [_watch(core, 0.5 * deadline) for core in sorted(set(cores))]
            machine.watched = bool(watches) and all(_is_ready(watch) for watch in watches)
            yield machine
        finally:
            for watch in watches:
                watch.terminate()
            for watch in watches:
                printed, _ = watch.communicate()
                lines = (line.split() for line in printed.splitlines())
                machine.stalls += [(float(before), float(after)) for before, after in lines]


def _take(pid: int, undo: ExitStack) -> tuple[int, ...]:
    """Set priorities and cores; return the cores of this thread and of the process, () if refused."""
    if sys.platform != "linux":
        return ()
    cores = sorted(os.sched_getaffinity(0))
    chosen = (cores[-1], cores[-2] if len(cores) > 1 else cores[-1])  # the first serves most interrupts
    normal, first = os.sched_param(0), os.sched_param(PRIORITY)
    taken: list[int] = []
    with suppress(PermissionError):
        for each, core in zip((0, pid), chosen, strict=True):
            os.sched_setscheduler(each, os.SCHED_FIFO, first)
            taken.append(core)
            undo.callback(_try, os.sched_setscheduler, each, os.SCHED_OTHER, normal)
            os.sched_setaffinity(each, {core})
            undo.callback(_try, os.sched_setaffinity, each, set(cores))
        return tuple(taken)
    undo.close()
    return ()


def _try(function: object, *arguments: object) -> None:
    with suppress(ProcessLookupError):  # it has ended
        function(*arguments)  # type: ignore[operator]


def _watch(core: int, interval: float) -> subprocess.Popen[str]:
    script = Path(__file__).with_name("stall_watch.py")
    command = [sys.executable, "-I", "-S", str(script), str(core), str(WATCH), f"{interval}"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)


def _is_ready(watch: subprocess.Popen[str]) -> bool:
    assert watch.stdout is not None  # a pipe was asked for
    return watch.stdout.readline() == "ready\n"  # else it was refused its priority
