"""Real-time priority of a rehearsal's processes, and stalls of the machine."""

import os
import shutil
import signal
import subprocess
import time
from collections import Counter

import pytest

from agents.deployment.rehearsal.clock import longest_gap
from agents.deployment.rehearsal.real_time import WATCH, Machine, _is_ready, _watch, real_time
from agents.deployment.rehearsal.rehearse import RehearsalPlan, rehearse
from agents.deployment.rehearsal.rehearsed import Rehearsal
from shake_env import make_scenario


def scheduler_is_permitted():
    """Whether this process may take a real-time priority; it is as it was afterwards."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(WATCH))
    except (AttributeError, PermissionError):
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


needs_priority = pytest.mark.skipif(
    not scheduler_is_permitted(), reason="the system permits no real-time priority"
)


@needs_priority
def test_both_processes_have_real_time_priority_within_a_test_and_none_after_it():
    before = os.sched_getaffinity(0)
    with subprocess.Popen(["sleep", "60"]) as other:
        try:
            with real_time(other.pid, 0.01) as machine:
                for pid, core in zip((0, other.pid), machine.cores, strict=True):
                    assert os.sched_getscheduler(pid) == os.SCHED_FIFO
                    assert os.sched_getaffinity(pid) == {core}
            assert machine.watched
            for pid in (0, other.pid):
                assert os.sched_getscheduler(pid) == os.SCHED_OTHER
                assert os.sched_getaffinity(pid) == before
        finally:
            other.kill()


@needs_priority
def test_a_stall_is_seen_by_the_watch():
    core = max(os.sched_getaffinity(0))
    watch = _watch(core, 0.001)
    assert _is_ready(watch)
    watch.send_signal(signal.SIGSTOP)  # as the machine would stop it
    stopped = time.perf_counter()
    time.sleep(0.1)
    started = time.perf_counter()
    watch.send_signal(signal.SIGCONT)
    time.sleep(0.02)
    watch.terminate()
    stalls = [tuple(map(float, line.split())) for line in watch.communicate()[0].splitlines()]
    assert any(before < stopped + 0.05 and after > started - 0.05 for before, after in stalls)


def test_where_no_priority_is_permitted_a_test_runs_as_before(monkeypatch):
    def refuse(*arguments):
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse, raising=False)
    with real_time(os.getpid(), 0.01) as machine:
        pass
    assert machine == Machine() and machine.summary()["longest_stall_us"] is None
    assert 0.0 < longest_gap(0.01) < 1.0


def test_a_miss_is_the_machines_where_a_stall_falls_into_its_wait():
    columns = ("time [s]", "jitter [us]", "events", "injected")
    late = "no command in time"
    rows = [[0.0, 0.0, late, ""], [0.005, 0.0, late, ""], [0.01, 2000.0, late, ""], [0.015, 0.0, "", ""]]
    machine = Machine(cores=(1, 0), watched=True, stalls=[(100.001, 100.002), (100.0125, 100.0126)])
    test = Rehearsal(make_scenario("laboratory"), columns, rows, machine=machine)
    test.mark_stalls(100.0, 0.0025)
    assert [row[2] for row in rows] == [f"{late}; machine stalled", late, f"{late}; machine stalled", ""]
    assert test.own_misses() == [0, 1, 2] and test.stalled_misses() == 2
    assert test.events == Counter({"machine stalled": 2})
    test.machine = Machine()
    assert test.stalled_misses() is None  # nobody knows


@pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler is installed"
)
def test_a_rehearsal_by_the_clock_says_how_the_machine_kept_it():
    plan = RehearsalPlan(seconds=0.4)
    first = rehearse("pid", make_scenario("laboratory"), plan)["first_test"]
    machine = first["machine"]
    assert machine["clock_gap_us"] > 0.0 and first["jitter"]["worst_us"] > 0.0
    assert machine["real_time"] == scheduler_is_permitted() == (machine["stalls"] is not None)
