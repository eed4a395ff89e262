"""Datagrams, injected faults, the guard, and a rehearsal over the loopback."""

import csv
import shutil
from collections import Counter

import numpy as np
import pytest

from agents.deployment.channels import identifier, observation_channels
from agents.deployment.rehearsal.controller_process import start_controller
from agents.deployment.rehearsal.datagram import (
    BEGINS,
    COMMAND,
    MEASUREMENT,
    Datagram,
    unpack,
)
from agents.deployment.rehearsal.faults import FAULTS, LINK_FAULTS, Fault, FaultyLink, draw_faults
from agents.deployment.rehearsal.guard import HoldThenBrake
from agents.deployment.rehearsal.log import draw_timing, recorded_log, write_periods
from agents.deployment.rehearsal.rehearse import RehearsalPlan, rehearse
from agents.deployment.rehearsal.rehearsed import Rehearsal, unnoticed
from agents.deployment.rehearsal.table import TableProcess
from agents.laboratory.logs.findings import channel_faults
from agents.laboratory.logs.log_file import read_log
from agents.laboratory.logs.recorder import LogRecorder
from shake_env import make_scenario
from shake_env.errors import ParameterError, ShakeError
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.simulation.simulation import Simulation

needs_compiler = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler is installed"
)

# Datagrams and channels


def test_a_datagram_comes_back_whole():
    sent = Datagram(MEASUREMENT, 7, 0.035, np.array([1.5, -2e-300, np.nan]), BEGINS, 3)
    data = sent.pack()
    assert len(data) == 24 + 3 * 8 + 4
    got = unpack(data)
    np.testing.assert_array_equal(got.channels, sent.channels)
    assert (got.kind, got.sequence, got.time, got.flags, got.test) == (MEASUREMENT, 7, 0.035, BEGINS, 3)


def test_every_changed_bit_is_found():
    data = Datagram(COMMAND, 1, 0.0, np.array([0.01])).pack()
    for place in range(len(data)):
        for bit in range(8):
            changed = bytearray(data)
            changed[place] ^= 1 << bit
            assert unpack(bytes(changed)) is None
    for length in range(len(data)):
        assert unpack(data[:length]) is None
    assert unpack(data + b"\0") is None


@pytest.mark.parametrize("name", ["linear", "laboratory", "yielding"])
def test_channels_are_the_observation_in_si(name):
    scenario = make_scenario(name)
    channels = observation_channels(scenario)
    assert len(channels) == scenario.observation.size
    names = [channel.identifier for channel in channels]
    assert len(set(names)) == len(names) and all(each.isidentifier() for each in names)
    simulation = Simulation(scenario, 1)
    observation = simulation.start([0], [np.random.default_rng(0)])
    for _ in range(50):
        observation = simulation.step(np.array([0.3])).observation
    si = observation[0] * np.array([channel.scale for channel in channels])
    place = next(i for i, each in enumerate(names) if "table_velocity" in each)
    assert si[place] == pytest.approx(simulation.state[0, 2], abs=0.005)
    assert channels[place].unit == "m/s"


def test_an_identifier_is_one():
    assert identifier("2 x-y [m]") == "x_2_x_y_m"
    assert identifier("ground filter x_w'") == "ground_filter_x_w_rate"


# Faults


class Wire:
    """A socket that keeps what is sent."""

    def __init__(self):
        self.sent = []

    def sendto(self, data, peer):
        self.sent.append(data)


def test_the_link_does_what_the_plan_says():
    plan = dict(enumerate(("", "lost", "duplicated", "late", "reordered", "", "corrupt")))
    wire = Wire()
    link = FaultyLink(wire, ("", 0), {(k, "measurement"): v for k, v in plan.items() if v}, 0.5)
    for k in range(8):
        link.flush(float(k))
        link.send(k, bytes([k]) * 20, float(k))
    order = [data[0] for data in wire.sent]
    assert order == [0, 2, 2, 3, 5, 4, 6, 7]
    assert wire.sent[6] != bytes([6]) * 20
    assert link.injected == Counter(
        {"lost": 1, "duplicated": 1, "late": 1, "reordered": 1, "corrupt": 1}
    )


def test_reordered_neighbours_all_come_after_a_later_one():
    wire = Wire()
    plan = {1: "reordered", 2: "reordered", 3: "lost", 5: "reordered"}
    link = FaultyLink(wire, ("", 0), {(k, "measurement"): v for k, v in plan.items()}, 0.5)
    for k in range(7):
        link.send(k, bytes([k]) * 20, float(k))
    assert [data[0] for data in wire.sent] == [0, 4, 1, 2, 6, 5]
    assert link.injected == Counter({"reordered": 3, "lost": 1})


def test_drawn_faults_are_reproducible_and_of_the_rate():
    faults = draw_faults(FAULTS, 0.05, 4000, 5, seed=1)
    assert faults == draw_faults(FAULTS, 0.05, 4000, 5, seed=1)
    link = [fault for fault in faults if fault.kind in LINK_FAULTS]
    assert 0.04 < len(link) / 8000 < 0.06 and {fault.kind for fault in link} == set(LINK_FAULTS)
    assert len(faults) - len(link) == 2
    with pytest.raises(ParameterError, match="known: "):
        draw_faults(("broken",), 0.1, 10, 5)
    with pytest.raises(ParameterError, match="fault_rate"):
        draw_faults((), 1.5, 10, 5)


# The guard


def guarded(commands, stuck_from=None):
    """Currents and modes of the guard under commands, with measured noise."""
    scenario = make_scenario("laboratory")
    guard, rng = HoldThenBrake(scenario, hold=2), np.random.default_rng(0)
    layout = scenario.observation
    found, last = [], None
    for k, command in enumerate(commands):
        observation = np.zeros(layout.size)
        noise = layout.sensor_values("noise") / layout.reading_scale
        observation[layout.readings] = noise * rng.standard_normal(layout.readings_count)
        if stuck_from is not None and k >= stuck_from:
            observation[layout.readings.start] = last
        last = observation[layout.readings.start]
        found.append((*guard.decide(observation, command), guard.faulty))
    return found, scenario


def test_the_last_command_is_held_and_then_braked():
    found, scenario = guarded([0.01, *[None] * 40, 0.02])
    assert [mode for _, mode, _ in found[:4]] == ["command", "hold", "hold", "brake"]
    currents = [current for current, _, _ in found]
    assert currents[:3] == [0.01, 0.01, 0.01]
    share = np.exp(-scenario.control_period / 0.012)
    assert currents[3] == pytest.approx(0.01 * share, rel=0.02)
    assert abs(currents[40]) < 1e-3 * scenario.current_limit
    assert found[-1][:2] == (0.02, "command")


def test_a_stuck_sensor_brakes_and_recovers_no_sooner_than_it_moves():
    found, _ = guarded([0.01] * 30, stuck_from=10)
    modes = [mode for _, mode, _ in found]
    assert set(modes[:10]) == {"command"}
    first = modes.index("brake")
    assert 12 <= first <= 16 and set(modes[first:]) == {"brake"}
    assert found[first][2] == ("table_displacement",)


def test_a_command_beyond_the_limit_is_clipped():
    found, scenario = guarded([1.0])
    assert found[0][0] == scenario.current_limit


# A rehearsal

ALL = RehearsalPlan(seconds=1.0, tests=2, faults=FAULTS, fault_rate=0.05, paced=False)


@needs_compiler
def test_c_survives_every_fault_and_each_is_noticed(tmp_path):
    found = rehearse("pid", make_scenario("laboratory"), ALL, tmp_path)
    assert found["hard_limits_broken"] == 0 and found["unnoticed"] == []
    assert set(found["injected"]) == set(FAULTS)
    assert found["events"]["brake"] > 0 and found["events"]["hold"] > 0
    with (tmp_path / "test-1.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 200
    assert "table_displacement [m]" in rows[0] and "command" in {row["mode"] for row in rows}
    assert any(row["injected"] == "controller dies" for row in rows)
    assert (tmp_path / "timing.png").is_file()
    log = read_log(tmp_path / "test-1.h5")
    assert log.samples == 200 and log.scenario.specimen == make_scenario("laboratory").specimen
    np.testing.assert_allclose(
        log.channels["current"], [float(row["current [A]"]) for row in rows], rtol=1e-8
    )
    # What the controller is shown in a period is what a recorder takes at the end of the one before.
    shown = [float(row["shown measured_table_displacement [m]"]) for row in rows]
    np.testing.assert_allclose(log.channels["table_displacement"][:-1], shown[1:], rtol=1e-8)
    assert any(
        each.kind == "stuck" for each in channel_faults(log)
    )  # the sensor that stuck, as in any log


@needs_compiler
def test_faults_of_neighbouring_datagrams_are_each_in_the_log():
    scenario = make_scenario("laboratory", {"duration": 0.5})
    plan = {
        "command": {5: "reordered", 6: "reordered", 12: "reordered", 13: "lost", 14: "duplicated"},
        "measurement": {
            20: "reordered",
            21: "reordered",
            22: "duplicated",
            30: "duplicated",
            31: "lost",
        },
    }
    faults = tuple(
        Fault(period, kind, way) for way, kinds in plan.items() for period, kind in kinds.items()
    )
    process = start_controller("pid", scenario, "c", supervised=False)
    try:
        table = TableProcess(scenario, process, paced=False, deadline=0.2)
        test = table.run(noise_earthquakes(scenario, 1)[0], faults, 40)
    finally:
        process.close()
    assert unnoticed(test) == [] and sum(test.injected.values()) == len(faults)
    events = [row[test.columns.index("events")] for row in test.rows]
    missed = [k for k, text in enumerate(events) if "no command in time" in text]
    assert missed == [5, 6, 12, 13, 20, 21, 31]
    # 22 comes twice and then 20 and 21, of which the command of 23 tells; the second 30, that of 32.
    assert [k for k, text in enumerate(events) if "measurement ignored" in text] == [23, 32]
    assert test.own_misses() == []


@needs_compiler
@pytest.mark.parametrize("name", ["laboratory", "linear"])
def test_without_faults_the_rehearsal_is_the_simulation(name):
    """The same currents as the controller gives in a roll-out, and the same log: nothing is lost."""
    from agents.deployment.recorded import record_decisions
    from baselines.registry import make_baseline

    scenario = make_scenario(name, {"duration": 0.5})
    quakes = noise_earthquakes(scenario, 1)
    process = start_controller("pid", scenario, "c", supervised=False)
    try:
        table = TableProcess(scenario, process, paced=False, deadline=5.0)
        test = table.run(quakes[0])
    finally:
        process.close()
    controller, recorder = make_baseline("pid", scenario), LogRecorder(scenario, quakes)
    decisions = record_decisions(controller, scenario, quakes)
    rollout(controller, scenario, quakes, log=recorder)
    assert test.events == Counter()
    np.testing.assert_allclose(
        test.column("current") / scenario.current_limit, decisions.actions[:, 0], atol=2e-7
    )
    ours, theirs = recorded_log(test, "rehearsed"), recorder.logs()[0]
    assert ours.digest == theirs.digest and set(ours.channels) == set(theirs.channels)
    for channel, values in theirs.channels.items():  # states are shown in float32
        scale = np.abs(values).max()
        np.testing.assert_allclose(ours.channels[channel] / scale, values / scale, atol=1e-5)


def test_a_test_of_a_few_periods_leaves_no_log():
    assert recorded_log(Rehearsal(make_scenario("laboratory"), ("mode",)), "short") is None


@needs_compiler
def test_the_exported_table_takes_the_simulated_ones_place():
    """Both programs in C: the same test, but for the order in which noise and rounding come."""
    scenario = make_scenario("laboratory", {"duration": 1.0})
    quake, columns = noise_earthquakes(scenario, 1)[0], []
    process = start_controller("pid", scenario, "c", supervised=False)
    try:
        for exported in (False, True):
            table = TableProcess(scenario, process, paced=False, deadline=5.0, exported=exported)
            test = table.run(quake)
            assert test.broken_limit is None and test.events == Counter()
            columns.append(test.column("table_velocity"))
    finally:
        process.close()
    simulated, exported = np.array(columns)
    assert np.std(exported) > 0.003  # m/s, in the first second
    assert np.max(np.abs(exported - simulated)) < 0.02 * np.max(np.abs(simulated))
    with pytest.raises(ShakeError, match="full state"):
        plan = RehearsalPlan(seconds=0.1, paced=False, table="c")
        rehearse("lqr", make_scenario("linear"), plan)


@pytest.mark.slow
def test_python_survives_every_fault_too(tmp_path):
    plan = RehearsalPlan(runs="python", seconds=1.0, faults=FAULTS, fault_rate=0.05, paced=False)
    found = rehearse("pid", make_scenario("laboratory"), plan, tmp_path)
    assert found["hard_limits_broken"] == 0 and found["unnoticed"] == []


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("name", ["lqg", "apg"])
def test_a_hundred_tests_with_faults_break_no_limit(name):
    plan = RehearsalPlan(seconds=2.0, tests=100, faults=FAULTS, paced=False)
    found = rehearse(name, make_scenario("laboratory"), plan)
    assert found["hard_limits_broken"] == 0 and found["unnoticed"] == []


def test_a_fault_that_nobody_noticed_is_named():
    columns = ("mode", "events", "injected")
    rows = [["command", "", "command lost"], ["hold", "no command in time; hold", "measurement late"]]
    test = Rehearsal(make_scenario("laboratory"), columns, rows)
    assert unnoticed(test) == ["command lost in period 0"]
    assert test.own_misses() == []  # the one miss was injected
    rows += [["hold", "no command in time; hold", ""], ["command", "", "controller dies"]]
    rows += [["hold", "no command in time; hold", ""]]
    assert test.own_misses() == [2]  # the first of these, before the controller died
    rows[:] = [["command", "", "measurement duplicated"], ["hold", "no command in time", ""]]
    assert unnoticed(test) == []  # no command came after it, which would have told
    rows.append(["command", "", ""])
    assert unnoticed(test) == ["measurement duplicated in period 0"]


def test_a_plan_out_of_range_is_refused():
    for wrong in ({"tests": 0}, {"hold": -1}, {"seconds": 0.0}):
        with pytest.raises(ParameterError, match=next(iter(wrong))):
            RehearsalPlan(**wrong)


def test_a_controller_that_has_no_c_form_is_refused():
    with pytest.raises(ShakeError, match="no C form"):
        rehearse("mpc", make_scenario("laboratory"), RehearsalPlan(seconds=0.1))


def test_log_and_figure_of_a_made_test(tmp_path):
    columns = ("time [s]", "jitter [us]", "latency [us]", "mode")
    rows = [[0.0, 3.0, 40.0, "command"], [0.005, 2.0, "", "hold"]]
    test = Rehearsal(make_scenario("laboratory"), columns, rows)
    text = write_periods(test, tmp_path / "log.csv").read_text(encoding="utf-8")
    assert text == "time [s],jitter [us],latency [us],mode\n0,3,40,command\n0.005,2,,hold\n"
    assert draw_timing(test, tmp_path / "timing.png", 0.0025).stat().st_size > 5000
