"""Rehearsals: one paced test with its log and figure, or many short ones with faults drawn at random."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from agents.deployment.rehearsal.controller_process import Runs, start_controller
from agents.deployment.rehearsal.faults import CONTROLLER_DIES, draw_faults
from agents.deployment.rehearsal.log import draw_timing, recorded_log, write_periods
from agents.deployment.rehearsal.rehearsed import Rehearsal, unnoticed
from agents.deployment.rehearsal.table import TableProcess
from agents.laboratory.logs.hdf5_file import import_library
from agents.laboratory.logs.log_file import write_log
from shake_env.errors import ParameterError
from shake_env.motion.targets import FilteredNoise, whole_periods
from shake_env.rollout import Earthquake, noise_earthquakes
from shake_env.scenario.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class RehearsalPlan:
    """What is rehearsed.

    Raises
    ------
    ParameterError
        If a number is not in its range.
    """

    runs: Runs = "c"  # what the controller's process is
    table: Runs = "python"  # what steps the table: the simulation, or the exported program
    supervised: bool = False  # the safety supervisor around the controller, in its process
    seconds: float | None = None  # [s] of each test; None: the scenario's motion
    tests: int = 1
    faults: tuple[str, ...] = ()  # kinds that are drawn
    fault_rate: float = 0.01  # [-] of datagrams
    hold: int = 2  # control periods that the last command is held for
    paced: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        if self.tests < 1:
            raise ParameterError("tests", self.tests, "must be at least 1")
        if self.hold < 0:
            raise ParameterError("hold", self.hold, "must be at least 0")
        if self.seconds is not None and not 0.0 < self.seconds < float("inf"):
            raise ParameterError("seconds", self.seconds, "must be above 0")


def rehearse(
    name: str,
    scenario: Scenario,
    plan: RehearsalPlan,
    folder: Path | None = None,
    on_progress: Callable[[float], None] = lambda share: None,
) -> dict[str, Any]:
    """Rehearse a controller; return counts and times as plain values.

    Parameters
    ----------
    name
        Of the controller.
    scenario
        Of the table.
    plan
        How.
    folder
        For logs and the figure of the first test; None: nothing is written.
    on_progress
        Told the share of the work that is done.

    Raises
    ------
    ParameterError
        If a test is shorter than one control period.
    LogError
        If logs are to be written and h5py is missing.
    """
    periods = None
    if plan.seconds is not None:
        periods = whole_periods(plan.seconds, scenario.control_period, "seconds")
    if folder is not None:
        import_library("h5py")
    earthquakes = _earthquakes(scenario, plan)
    process = start_controller(name, scenario, plan.runs, plan.supervised)
    tests: list[Rehearsal] = []
    missed: list[dict[str, Any]] = []
    try:
        exported = plan.table == "c"
        table = TableProcess(scenario, process, hold=plan.hold, paced=plan.paced, exported=exported)
        for number, quake in enumerate(earthquakes):
            length = periods or round(quake.motion.duration / scenario.control_period)
            readings = scenario.observation.readings_count
            faults = draw_faults(plan.faults, plan.fault_rate, length, readings, quake.seed)
            test = table.run(
                quake,
                faults,
                periods,
                lambda share, done=number: on_progress((done + share) / plan.tests),  # type: ignore[misc]
            )
            tests.append(test)
            if folder is not None:
                write_periods(test, folder / f"test-{number + 1}.csv")
                log = recorded_log(test, f"{name} {quake.name}")
                if log is not None:
                    write_log(log, folder / f"test-{number + 1}.h5")
            if number == 0 and folder is not None:
                draw_timing(test, folder / "timing.png", table.deadline)
            if missing := unnoticed(test):
                missed.append({"test": number + 1, "faults": missing})
            if any(fault.kind == CONTROLLER_DIES for fault in faults):
                process.restart()
            on_progress((number + 1) / plan.tests)
    finally:
        process.close()
    return _result(name, plan, tests, missed)


@dataclass(frozen=True)
class NoiseEarthquake(Earthquake):
    """An earthquake of filtered noise."""

    motion: FilteredNoise


def _earthquakes(scenario: Scenario, plan: RehearsalPlan) -> list[NoiseEarthquake]:
    """Return the tests' earthquakes, as long as is asked for at least."""
    made = []
    for quake in noise_earthquakes(scenario, plan.tests, plan.seed):
        motion = quake.motion
        assert isinstance(motion, FilteredNoise)  # which it always is
        duration = max(plan.seconds or 0.0, motion.duration)
        made.append(NoiseEarthquake(quake.name, replace(motion, duration=duration), quake.seed))
    return made


def _result(
    name: str, plan: RehearsalPlan, tests: Sequence[Rehearsal], missed: list[dict[str, Any]]
) -> dict[str, Any]:
    events, injected = Counter[str](), Counter[str]()
    for test in tests:
        events += test.events
        injected += test.injected
    stalled = [test.stalled_misses() for test in tests]
    return {
        "controller": name,
        "runs": plan.runs,
        "table": plan.table,
        "tests": len(tests),
        "periods": sum(len(test.rows) for test in tests),
        "hard_limits_broken": sum(test.broken_limit is not None for test in tests),
        "events": dict(sorted(events.items())),
        "injected": dict(sorted(injected.items())),
        "unnoticed": missed,
        "deadline_misses_not_injected": sum(len(test.own_misses()) for test in tests),
        "while_the_machine_stalled": None if None in stalled else sum(filter(None, stalled)),
        "first_test": tests[0].summary(),
    }
