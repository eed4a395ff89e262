"""What is wrong with the channels of a log: a sensor that saturates, sticks or is silent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agents.laboratory.logs.test_log import TARGET, TestLog
from shake_env.errors import LogError
from shake_env.model.parameters import FloatArray
from shake_env.simulation.engine import BoolArray, IntArray

AT_THE_END = 3  # samples in a row at a channel's own extreme that make a saturation
STUCK = 0.25  # [s] of one value while the table moves
MOVING = 0.02  # of a channel's rms: a table that moves less than this share of its target's is at rest


@dataclass(frozen=True)
class Finding:
    """A fault of a channel."""

    channel: str
    kind: str  # saturated, stuck, silent
    start: float  # [s]
    length: float  # [s]
    value: float  # SI

    def __str__(self) -> str:
        return (
            f"{self.channel} is {self.kind} at {self.value:.6g} for {1e3 * self.length:.0f} ms "
            f"from {self.start:.3f} s on"
        )


def channel_faults(log: TestLog) -> list[Finding]:
    """Return the faults of the measured channels, at most one of a kind and channel.

    A channel is saturated where three samples in a row or more lie at exactly its largest or smallest
    value, which noise makes improbable, and the value is not that of rest; stuck where it keeps one
    value for `STUCK` while the target moves; silent where it never changes.
    """
    target = log.channels[TARGET]
    moving = np.abs(target) > MOVING * float(np.sqrt(np.mean(target**2)))
    faults = []
    for name in log.measured:
        values, step = log.channels[name], log.sampling_interval
        starts, lengths = _runs(values)
        if len(starts) == 1:
            faults.append(Finding(name, "silent", 0.0, log.duration, float(values[0])))
            continue
        ends = (values[starts] == values.max()) | (values[starts] == values.min())
        spread = values.max() - values.min()
        away = np.abs(values[starts] - np.median(values)) > 0.25 * spread
        saturated = ends & away & (lengths >= AT_THE_END)
        if saturated.any():
            faults.append(_longest(name, "saturated", values, starts, lengths, saturated, step))
        busy = np.add.reduceat(moving.astype(float), starts) / lengths
        stuck = (lengths * step >= STUCK) & (busy > 0.5) & ~saturated
        if stuck.any():
            faults.append(_longest(name, "stuck", values, starts, lengths, stuck, step))
    return faults


def require_sound(log: TestLog, without: Sequence[str] = ()) -> None:
    """Raise LogError where a channel that is used has a fault; `without` are those that are not used."""
    faults = [each for each in channel_faults(log) if each.channel not in without]
    if faults:
        names = " ".join(dict.fromkeys(each.channel for each in faults))
        raise LogError(
            log.name,
            "; ".join(map(str, faults)),
            f"repair the channel, or leave it out: --without {names}",
        )


def _runs(values: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the first samples and the lengths of runs of one value."""
    starts = np.flatnonzero(np.r_[True, np.diff(values) != 0.0])
    return starts, np.diff(np.r_[starts, len(values)])


def _longest(
    name: str,
    kind: str,
    values: FloatArray,
    starts: IntArray,
    lengths: IntArray,
    which: BoolArray,
    step: float,
) -> Finding:
    run = int(np.argmax(np.where(which, lengths, 0)))
    at = int(starts[run])
    return Finding(name, kind, at * step, float(lengths[run] * step), float(values[at]))
