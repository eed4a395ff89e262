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
