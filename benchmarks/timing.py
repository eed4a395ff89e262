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


def seconds_each(work: dict[str, Callable[[], object]], spell: float, spells: int) -> dict[str, float]:
    """Return the median CPU seconds of a call of each, run in turns of `spell` seconds."""
    calls = {}
    for name, call in work.items():
        call()
        begin = time.process_time()
        call()
        calls[name] = max(1, round(spell / max(time.process_time() - begin, 1e-7)))
    taken: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(spells):
        for name, call in work.items():
            begin = time.process_time()
            for _ in range(calls[name]):
                call()
            taken[name].append((time.process_time() - begin) / calls[name])
    return {name: statistics.median(times) for name, times in taken.items()}
