"""What a rehearsed test was: its periods, what the table noticed, its times."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agents.deployment.rehearsal.faults import CONTROLLER_DIES, LINK_FAULTS, SENSOR_STICKS
from agents.deployment.rehearsal.real_time import Machine
from shake_env.model.parameters import FloatArray
from shake_env.scenario.scenario import Scenario

NO_COMMAND = "no command in time"
IGNORED = "measurement ignored by the controller"
NOTICED = 12  # control periods within which a sensor that sticks must be found
STALLED = "machine stalled"


@dataclass
class Rehearsal:
    """What a rehearsed test was."""

    scenario: Scenario  # with the test's motion
    columns: tuple[str, ...]  # of `rows`, names with units
    rows: list[list[Any]] = field(default_factory=list)  # one a control period
    channels: tuple[str, ...] = ()  # of `samples`: those that a laboratory's recorder measures
    samples: list[list[float]] = field(default_factory=list)  # at each period's end [SI]
    events: Counter[str] = field(default_factory=Counter)  # what the table noticed
    injected: Counter[str] = field(default_factory=Counter)  # what the plan of faults did
    broken_limit: str | None = None
    machine: Machine | None = None  # that kept it to the clock; None: it did not follow the clock

    def column(self, name: str) -> FloatArray:
        """Return a column of numbers; NaN where a period has none."""
        place = [text.split(" [")[0] for text in self.columns].index(name)
        return np.array([np.nan if row[place] == "" else float(row[place]) for row in self.rows])

    def own_misses(self) -> list[int]:
        """Return the periods without a command in time that no injected fault explains."""
        injected, events = (self.columns.index(name) for name in ("injected", "events"))
        alive, found = True, []
        for k, row in enumerate(self.rows):
            alive = alive and CONTROLLER_DIES not in row[injected]
            explained = not alive or any(fault in row[injected] for fault in LINK_FAULTS)
            if NO_COMMAND in row[events] and not explained:
                found.append(k)
        return found

    def stalled_misses(self) -> int | None:
        """Return how many of `own_misses` fall into a stall of the machine; None if nothing watched."""
        if self.machine is None or not self.machine.watched:
            return None
        events = self.columns.index("events")
        return sum(STALLED in self.rows[k][events] for k in self.own_misses())

    def mark_stalls(self, began: float, deadline: float) -> None:
        """Note the machine's stalls among the events of those periods that waited for a command in one.

        Parameters
        ----------
        began
            [s] of the clock, at which the test was to begin.
        deadline
            [s] for which a period waits.
        """
        assert self.machine is not None  # the test followed the clock
        sent = began + self.column("time") + 1e-6 * self.column("jitter")
        stalled = np.zeros(len(sent), dtype=bool)
        for before, after in self.machine.stalls:
            stalled |= (sent < after) & (before < sent + deadline)
        events = self.columns.index("events")
        for k in np.flatnonzero(stalled):
            self.rows[k][events] = "; ".join(filter(None, (self.rows[k][events], STALLED)))
        if stalled.any():
            self.events[STALLED] += int(stalled.sum())

    def summary(self) -> dict[str, Any]:
        """Return counts, and quantiles of latency and jitter [us], as plain values."""
        latency, jitter = self.column("latency"), np.abs(self.column("jitter"))
        latency = latency[np.isfinite(latency)]

        def quantiles(values: FloatArray) -> dict[str, float] | None:
            if not len(values):
                return None
            median, high, most = np.quantile(values, [0.5, 0.99, 1.0])
            return {"median_us": float(median), "p99_us": float(high), "worst_us": float(most)}

        return {
            "scenario": self.scenario.name,
            "periods": len(self.rows),
            "period": self.scenario.control_period,
            "broken_limit": self.broken_limit,
            "deadline_misses": self.events[NO_COMMAND],
            "deadline_misses_not_injected": len(self.own_misses()),
            "while_the_machine_stalled": self.stalled_misses(),
            "machine": None if self.machine is None else self.machine.summary(),
            "events": dict(sorted(self.events.items())),
            "injected": dict(sorted(self.injected.items())),
            "latency": quantiles(latency),
            "jitter": quantiles(jitter),
        }


def unnoticed(test: Rehearsal) -> list[str]:
    """Return the injected faults of a test that the table did not notice by itself, in words.

    A datagram that is lost, late, out of order or corrupt leaves its period without a command; a command
    that comes twice is noticed as that; a measurement that comes twice is ignored once, as the next
    command tells; a dead controller leaves every period without a command; a sensor that sticks is found
    faulty within `NOTICED` periods. Of a test's last periods nothing can tell what the next would have
    shown.
    """
    injected, events = (test.columns.index(name) for name in ("injected", "events"))
    missed = []
    for k, row in enumerate(test.rows):
        for fault in filter(None, row[injected].split("; ")):
            later = [text for each in test.rows[k : k + NOTICED] for text in each[events].split("; ")]
            if fault == SENSOR_STICKS:
                noticed = any(text.startswith("faulty sensor") for text in later)
                noticed = noticed or len(test.rows) < k + NOTICED
            elif fault == "command duplicated":
                noticed = "command repeated" in later
            elif fault == "measurement duplicated":
                answered = (
                    each[events] for each in test.rows[k + 1 :] if NO_COMMAND not in each[events]
                )
                noticed = IGNORED in next(answered, IGNORED)
            else:
                noticed = NO_COMMAND in row[events] or "corrupt datagram" in row[events]
            if not noticed:
                missed.append(f"{fault} in period {k}")
    return missed
