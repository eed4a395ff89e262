"""Rates of what is compared, measured in turns.

On a shared machine two numbers are comparable only under the same load: each call runs for a short
spell in turn, and the median over the spells is reported. The clock is the process's own CPU time (one
thread), so that time spent waiting for the processor is not counted; slowdown by contention for caches
and memory is.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable


def seconds_each(
    work: dict[str, Callable[[], object]],
    spell: float,
    spells: int,
    clock: Callable[[], float] = time.process_time,
) -> dict[str, float]:
    """Return the median seconds of a call of each, run in turns of `spell` seconds.

    They are CPU seconds, or those of another clock where a call has threads of its own.
    """
    calls = {}
    for name, call in work.items():
        call()
        begin = clock()
        call()
        calls[name] = max(1, round(spell / max(clock() - begin, 1e-7)))
    taken: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(spells):
        for name, call in work.items():
            begin = clock()
            for _ in range(calls[name]):
                call()
            taken[name].append((clock() - begin) / calls[name])
    return {name: statistics.median(times) for name, times in taken.items()}
