"""Faults of a link, of a controller and of a sensor, drawn ahead; and a link that has them."""

from __future__ import annotations

import heapq
import socket
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import Literal, get_args

import numpy as np

from agents.deployment.rehearsal.datagram import unpack
from shake_env.errors import ParameterError, unknown

LinkFault = Literal["lost", "late", "duplicated", "reordered", "corrupt"]
LINK_FAULTS: tuple[str, ...] = get_args(LinkFault)
CONTROLLER_DIES, SENSOR_STICKS = "controller dies", "sensor sticks"
FAULTS = (*LINK_FAULTS, CONTROLLER_DIES, SENSOR_STICKS)
STUCK_PERIODS = 60  # that a sensor sticks for


@dataclass(frozen=True)
class Fault:
    """One fault, in one control period."""

    period: int
    kind: str  # of `FAULTS`
    way: Literal["measurement", "command", ""] = ""  # of a datagram
    channel: int = 0  # of a sensor: place among the readings


def draw_faults(
    kinds: Sequence[str], rate: float, periods: int, readings: int, seed: int = 0
) -> tuple[Fault, ...]:
    """Return random faults of a test.

    Parameters
    ----------
    kinds
        Of `FAULTS`. A controller dies at most once, in the test's second half; a sensor sticks once.
    rate
        [-] share of datagrams that one of the link's faults befalls, 0 to 1.
    periods
        Of the test.
    readings
        Number of sensors; none sticks where there is none.
    seed
        Of the draws.

    Raises
    ------
    ParameterError
        If a kind is unknown, or the rate not within 0 and 1.
    """
    for kind in kinds:
        if kind not in FAULTS:
            raise unknown(ParameterError, "faults", kind, FAULTS)
    if not 0.0 <= rate <= 1.0:
        raise ParameterError("fault_rate", rate, "must lie within 0 and 1")
    rng = np.random.default_rng(seed)
    link = [kind for kind in kinds if kind in LINK_FAULTS]
    drawn: list[Fault] = []
    ways: tuple[Literal["measurement", "command"], ...] = ("measurement", "command")
    for way in ways if link else ():
        for period in np.flatnonzero(rng.random(periods) < rate):
            if period > 0:  # the first measurement begins the test
                kind = link[int(rng.integers(len(link)))]
                drawn.append(Fault(int(period), kind, way))
    if CONTROLLER_DIES in kinds:
        drawn.append(
            Fault(int(rng.integers(periods // 2, max(periods - 1, periods // 2 + 1))), CONTROLLER_DIES)
        )
    if SENSOR_STICKS in kinds and readings:
        at = int(rng.integers(1, max(periods // 2, 2)))
        drawn.append(Fault(at, SENSOR_STICKS, channel=int(rng.integers(readings))))
    return tuple(sorted(drawn, key=lambda fault: fault.period))


@dataclass
class FaultyLink:
    """A datagram socket that does to datagrams what a plan of faults says.

    A late datagram is kept back by `late_by` seconds; a reordered one until one that is not has passed,
    so that reordered neighbours both come after a later one.
    """

    endpoint: socket.socket
    peer: tuple[str, int]
    faults: Mapping[tuple[int, str], str]  # by period and way
    late_by: float  # [s]
    injected: Counter[str] = field(default_factory=Counter)
    _waiting: dict[str, list[tuple[float, int, bytes]]] = field(
        default_factory=lambda: {"measurement": [], "command": []}
    )
    _held: dict[str, list[bytes]] = field(default_factory=lambda: {"measurement": [], "command": []})
    _order: count[int] = field(default_factory=count)

    def send(self, period: int, data: bytes, now: float) -> str:
        """Send the measurement of a period; return its fault, or nothing."""
        fault = self.faults.get((period, "measurement"), "")
        for each in self._pass(fault, data, "measurement", now):
            self.endpoint.sendto(each, self.peer)
        return fault

    def flush(self, now: float) -> None:
        """Send the measurements that have been kept back for long enough."""
        for each in self._due("measurement", now):
            self.endpoint.sendto(each, self.peer)

    def received(self, period: int, data: bytes, now: float) -> tuple[list[bytes], str]:
        """Return what becomes of a command that has arrived in a period, and its fault.

        A command has the faults of its own period; one that is late by itself passes.
        """
        given = unpack(data)
        own = given is not None and given.sequence == period
        fault = self.faults.get((period, "command"), "") if own else ""
        return self._pass(fault, data, "command", now), fault

    def overdue(self, now: float) -> list[bytes]:
        """Return the commands that have been kept back for long enough."""
        return self._due("command", now)

    def _due(self, way: str, now: float) -> list[bytes]:
        waiting, due = self._waiting[way], []
        while waiting and waiting[0][0] <= now:
            due.append(heapq.heappop(waiting)[2])
        return due

    def _pass(self, fault: str, data: bytes, way: str, now: float) -> list[bytes]:
        if fault:
            self.injected[fault] += 1
        held, passed = self._held[way], [data]
        if fault == "reordered":
            held.append(data)
            return []
        if fault == "lost":
            passed = []
        elif fault == "late":
            heapq.heappush(self._waiting[way], (now + self.late_by, next(self._order), data))
            passed = []
        elif fault == "duplicated":
            passed = [data, data]
        elif fault == "corrupt":
            passed = [data[:-9] + bytes([data[-9] ^ 0x40]) + data[-8:]]
        if passed:
            passed += held
            held.clear()
        return passed
