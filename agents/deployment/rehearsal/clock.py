"""Waiting for an instant, to microseconds."""

from __future__ import annotations

import time

SPIN = 3e-4  # [s] before an instant, from which on the clock is read instead of sleeping


def wait_until(instant: float) -> None:
    """Return at an instant of `time.perf_counter`; at once where it has passed."""
    left = instant - time.perf_counter()
    if left > SPIN:
        time.sleep(left - SPIN)
    while time.perf_counter() < instant:
        pass


def longest_gap(seconds: float) -> float:
    """Return the longest time [s] between two readings of the clock by a loop that does nothing else.

    Parameters
    ----------
    seconds
        For which it runs.
    """
    before = time.perf_counter()
    end, longest = before + seconds, 0.0
    while before < end:
        now = time.perf_counter()
        if now - before > longest:
            longest = now - before
        before = now
    return longest
