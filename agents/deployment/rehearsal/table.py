"""The table of a rehearsal: simulated, stepped at wall-clock rate, guarded, and logged.

In each control period the measurement is sent, the command awaited until a deadline, the guard asked,
and the table stepped. All that is timed is timed here, by one clock.
"""

from __future__ import annotations

import gc
import itertools
import select
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace

import numpy as np

from agents.deployment.channels import observation_channels
from agents.deployment.rehearsal.clock import longest_gap, wait_until
from agents.deployment.rehearsal.controller_process import LOOPBACK, ControllerProcess
from agents.deployment.rehearsal.datagram import (
    BEGINS,
    COMMAND,
    IGNORED_SHIFT,
    MEASUREMENT,
    REFUSED,
    Datagram,
    unpack,
)
from agents.deployment.rehearsal.exported_table import ExportedTable
from agents.deployment.rehearsal.faults import (
    CONTROLLER_DIES,
    LINK_FAULTS,
    SENSOR_STICKS,
    STUCK_PERIODS,
    Fault,
    FaultyLink,
)
from agents.deployment.rehearsal.guard import HoldThenBrake
from agents.deployment.rehearsal.real_time import real_time
from agents.deployment.rehearsal.rehearsed import IGNORED, NO_COMMAND, Rehearsal
from shake_env.kernels.layout import REPORT
from shake_env.model.parameters import FloatArray
from shake_env.rollout import Earthquake
from shake_env.scenario.limits import REASONS
from shake_env.scenario.observation import STATE_SIGNALS
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.simulation import Simulation

DEADLINE = 0.5  # [-] of a control period, by which a command must have come
UNPACED_DEADLINE = 0.01  # [s] likewise, where a test runs as fast as it can
SIGNALS = {
    "table_displacement": "m", "table_velocity": "m/s", "table_acceleration": "m/s^2",
    "target_acceleration": "m/s^2", "base_shear": "N", "reference_base_shear": "N",
}  # what is logged of the table itself, by its name in a step's report  # fmt: skip
_PLACES = [REPORT.index(name) for name in SIGNALS]
TIMES = (
    "time [s]", "sequence [-]", "jitter [us]", "latency [us]", "asked [A]", "current [A]",
)  # fmt: skip

TEXTS = ("mode", "events", "injected")
BEFORE = 0.5  # [s] for which the clock is read before a test that follows it
# Of tests: a controller tells a start that comes twice from a new test by its number.
_NUMBERS = itertools.count(1)


class TableProcess:
    """One simulated table, its guard and its end of the link.

    Parameters
    ----------
    scenario
        What is simulated.
    controller
        What answers.
    hold
        Control periods for which the last command is held, before braking.
    paced
        Whether periods follow the clock; else one begins when the last has ended.
    deadline
        [s] from a measurement to its command; None: half a period, or `UNPACED_DEADLINE`.
    exported
        Whether the exported table stands in the place of the simulated one.
    """

    def __init__(
        self,
        scenario: Scenario,
        controller: ControllerProcess,
        *,
        hold: int = 2,
        paced: bool = True,
        deadline: float | None = None,
        exported: bool = False,
    ) -> None:
        self.scenario, self.controller, self.hold, self.paced = scenario, controller, hold, paced
        usual = DEADLINE * scenario.control_period if paced else UNPACED_DEADLINE
        self.deadline = usual if deadline is None else deadline
        self._channels = observation_channels(scenario)
        self._scales = np.array([channel.scale for channel in self._channels])
        shown, full = scenario.observation, scenario.sensing.full_state
        measured = tuple(STATE_SIGNALS) if full else shown.reading_names
        first = scenario.plant.layout.actuator.start
        places = [first + place for place in STATE_SIGNALS.values()]
        self._measured = places if full else [*range(shown.readings.start, shown.readings.stop)]
        # With the full state, acceleration and base shear are the table's own.
        self._added = ("table_acceleration", "base_shear") if full else ()
        self._recorded = ("target_acceleration", "current", *self._added, *measured)
        self._simulation = Simulation(scenario, 1)
        self._exported = ExportedTable(scenario, self._simulation) if exported else None
        self._test = 0

    def run(
        self,
        earthquake: Earthquake,
        faults: Sequence[Fault] = (),
        periods: int | None = None,
        on_period: Callable[[float], None] = lambda share: None,
    ) -> Rehearsal:
        """Rehearse one test.

        Parameters
        ----------
        earthquake
            Motion and seed.
        faults
            What is to go wrong.
        periods
            At most as many; None: the whole motion.
        on_period
            Told the share of the test that is done, twice a second; not where periods follow the clock,
            which what it does would delay.
        """
        simulation, self._test = self._simulation, next(_NUMBERS)
        simulation.start([0], [np.random.default_rng(earthquake.seed)], [earthquake.motion])
        count = int(simulation.episode_steps[0])
        count = count if periods is None else min(count, periods)
        names = [f"{channel.identifier} [{channel.unit}]" for channel in self._channels]
        signals = [f"{name} [{unit}]" for name, unit in SIGNALS.items()]
        columns = (*TIMES, *TEXTS, *signals, *(f"shown {name}" for name in names))
        driven = replace(self.scenario, motion=earthquake.motion)
        test = Rehearsal(driven, columns, channels=self._recorded)
        simulation.step(np.zeros(1))  # compile and load before the clock runs
        observation = simulation.start(
            [0], [np.random.default_rng(earthquake.seed)], [earthquake.motion]
        )[0]
        if self._exported is not None:
            self._exported.begin()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as endpoint:
            endpoint.bind((LOOPBACK, 0))
            endpoint.setblocking(False)
            period = _Periods(self, test, endpoint, tuple(faults))
            collecting = gc.isenabled()
            gc.collect()
            gc.disable()
            try:
                follows = real_time(self.controller.pid, self.deadline) if self.paced else nullcontext()
                with follows as machine:
                    if machine is not None:
                        machine.gap = longest_gap(BEFORE)
                    began = period.run(observation.astype(float), count, on_period)
            finally:
                if collecting:
                    gc.enable()
        if machine is not None:
            test.machine = machine
            test.mark_stalls(began, self.deadline)
        return test

    @property
    def test(self) -> int:
        """Number of the present test."""
        return self._test

    def step(self, current: float) -> tuple[FloatArray, list[float], str | None, bool]:
        """Step the table; return observation, signals, the limit that broke, and whether it ends."""
        if self._exported is not None:
            return *self._exported.step(current), False
        result = self._simulation.step(np.array([current / self.scenario.current_limit]))
        broken = REASONS[int(result.broken[0]) - 1] if result.terminated[0] else None
        signals = [float(result.report[place, 0]) for place in _PLACES]
        return result.observation[0].astype(float), signals, broken, bool(result.truncated[0])

    def sample(self, observation: FloatArray, signals: Sequence[float], current: float) -> list[float]:
        """Return what a recorder takes at a period's end, in the order of a test's channels.

        Parameters
        ----------
        observation
            (n,) that is shown at its end.
        signals
            Of the table, at its end (`SIGNALS`).
        current
            [A] held over it.
        """
        own = dict(zip(SIGNALS, signals, strict=True))
        readings = self.measured(observation)[self._measured].tolist()
        added = [own[name] for name in self._added]
        return [own["target_acceleration"], current, *added, *readings]

    def measured(self, observation: FloatArray) -> FloatArray:
        """Return an observation in SI."""
        measured: FloatArray = observation * self._scales
        return measured


class _Periods:
    """The loop over one test's control periods."""

    def __init__(
        self, table: TableProcess, test: Rehearsal, endpoint: socket.socket, faults: tuple[Fault, ...]
    ) -> None:
        self._table, self._test, self._endpoint = table, test, endpoint
        self._guard = HoldThenBrake(table.scenario, table.hold)
        link: dict[tuple[int, str], str] = {
            (fault.period, fault.way): fault.kind for fault in faults if fault.kind in LINK_FAULTS
        }
        self._link = FaultyLink(endpoint, (LOOPBACK, table.controller.port), link, 1.5 * table.deadline)
        self._deaths = {fault.period for fault in faults if fault.kind == CONTROLLER_DIES}
        self._sticks = {fault.period: fault.channel for fault in faults if fault.kind == SENSOR_STICKS}
        self._stuck: dict[int, tuple[int, float]] = {}  # place: (until, value)
        self._newest = -1
        self._ignored = 0  # measurements, as the newest command tells
        self._happened: list[str] = []

    def run(self, observation: FloatArray, count: int, on_period: Callable[[float], None]) -> float:
        """Run them; return the instant of the clock at which the first was to begin [s]."""
        table, test, period = self._table, self._test, self._table.scenario.control_period
        began = time.perf_counter() + period
        shown_at = began
        ended: tuple[list[float], float] | None = None  # signals and current of the last period
        for k in range(count):
            planned = began + k * period
            if table.paced:
                wait_until(planned)
            now = time.perf_counter()
            injected, self._happened = [], []
            self._link.flush(now)
            if k in self._deaths:
                table.controller.kill()
                test.injected[CONTROLLER_DIES] += 1
                injected.append(CONTROLLER_DIES)
            self._begin_sticking(observation, k, injected)
            shown = self._stuck_at(observation, k)
            if ended is not None:
                test.samples.append(table.sample(shown, *ended))
            flags = BEGINS if k == 0 else 0
            channels = table.measured(shown)
            measurement = Datagram(MEASUREMENT, k, k * period, channels, flags, table.test)
            jitter = now - planned if table.paced else 0.0
            if fault := self._link.send(k, measurement.pack(), now):
                injected.append(f"measurement {fault}")
            command, latency = self._await(k, now, injected)
            current, mode = self._guard.decide(shown, command)
            for sensor in self._guard.faulty:
                self._note(f"faulty sensor {sensor}")
            if command is None:
                self._note(NO_COMMAND)
            if mode != "command":
                self._note(mode)
            if table.paced and jitter > table.deadline:
                self._note("table late")
            observation, signals, broken, ends = table.step(current)
            ended = signals, current
            test.rows.append([
                k * period, k, 1e6 * jitter, "" if latency is None else 1e6 * latency,
                "" if command is None else command, current, mode, "; ".join(self._happened),
                "; ".join(injected), *signals, *channels,
            ])  # fmt: skip
            if broken is not None:
                test.broken_limit = broken
            if broken is not None or ends:
                break
            if not table.paced and now - shown_at > 0.5:
                shown_at = now
                on_period((k + 1) / count)
        if ended is not None:
            test.samples.append(table.sample(self._stuck_at(observation, len(test.rows)), *ended))
        test.injected += self._link.injected
        return began

    def _note(self, event: str) -> None:
        self._happened.append(event)
        self._test.events[event] += 1

    def _begin_sticking(self, observation: FloatArray, k: int, injected: list[str]) -> None:
        """Let the sensor stick that is to stick from this period on."""
        readings = self._table.scenario.observation.readings
        if k in self._sticks:
            place = readings.start + self._sticks[k]
            self._stuck[place] = (k + STUCK_PERIODS, float(observation[place]))
            self._test.injected[SENSOR_STICKS] += 1
            injected.append(SENSOR_STICKS)

    def _stuck_at(self, observation: FloatArray, k: int) -> FloatArray:
        """Return the observation of a period with the readings that stick as they were."""
        shown = observation.copy()
        for place, (until, value) in self._stuck.items():
            if k < until:
                shown[place] = value
        return shown

    def _await(self, k: int, sent: float, injected: list[str]) -> tuple[float | None, float | None]:
        """Return the command of period k [A] and its latency [s]; None where none comes in time."""
        until = sent + self._table.deadline
        answer: tuple[float | None, float | None] = (None, None)
        while True:
            now = time.perf_counter()
            if now >= until:  # what is found from now on is late, and told by its number
                return answer
            self._link.flush(now)
            arrived = self._link.overdue(now)
            while True:
                try:
                    data = self._endpoint.recv(65536)
                except (BlockingIOError, ConnectionRefusedError):
                    break
                passed, fault = self._link.received(k, data, now)
                if fault:
                    injected.append(f"command {fault}")
                arrived += passed
            for data in arrived:
                taken = self._take(data, k)
                if taken is not None:
                    answer = (taken, now - sent)
            if answer[0] is not None:
                return answer
            select.select([self._endpoint], [], [], max(0.0, min(until - now, 0.0005)))

    def _take(self, data: bytes, k: int) -> float | None:
        """Return the command that a datagram holds for period k; count what else it is."""
        given = unpack(data)
        if given is None or given.kind != COMMAND or len(given.channels) != 1:
            self._note("corrupt datagram")
        elif given.test != self._table.test & 0xFFFF:
            self._note("command of an earlier test")
        elif given.flags & REFUSED:
            self._note("refused by the controller")
        elif not np.isfinite(given.channels[0]):
            self._note("command not finite")
        elif given.sequence == self._newest:
            self._note("command repeated")
        elif given.sequence < k:
            self._note("command late")
        else:
            self._newest = given.sequence
            ignored = given.flags >> IGNORED_SHIFT
            if ignored != self._ignored:
                self._note(IGNORED)
            self._ignored = ignored
            return float(given.channels[0])
        return None
