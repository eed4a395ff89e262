"""The supervisor with sensors that fail and tables that differ from the nominal one."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.studies.hostile_controllers import Hostile
from agents.studies.sensor_faults import (
    CASES,
    broken_limits,
    main,
    sensor_fault_study,
    sensor_fault_table,
)
from baselines.estimation.lqg import lqg
from shake_env import NoControl, Sensing, Supervised, Uncertainty, Uniform, make_scenario
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.safety.sensor_faults import Channels
from shake_env.safety.supervisor import OTHER_ENTRIES
from shake_env.safety.table_state_observer import TableStateObserver
from shake_env.simulation.simulation import Simulation

REQUIRED = [name for name, case in CASES.items() if case.required]
SHORT = (
    "frozen table displacement", "dead table velocity", "missing table velocity (NaN)",
    "frozen load pressure", "2 % spikes of full scale in every channel",
    "10 % lost samples, the last one shown again", "observation one period late",
    "loop delay 4 physics steps", "valve gain x1.3",
)  # fmt: skip


def without_observer(controller, scenario):
    """A supervisor that believes every reading, and knows of no misfit."""
    supervised = Supervised(controller, scenario)
    observer = supervised.observer

    class Credulous:
        channels = observer.channels
        begin, afresh, predict = observer.begin, observer.afresh, observer.predict

        @staticmethod
        def look(memory, readings):
            estimate, memory = observer.look(memory, readings)
            faultless = replace(
                estimate,
                table=readings[:, :4],
                deviation=0.0 * estimate.deviation,
                faulty=np.zeros_like(estimate.faulty),
            )
            return faultless, replace(memory, misfit=0.0 * memory.misfit)

    supervised.observer = Credulous
    return supervised


def test_nothing_but_its_own_sensor_tells_where_the_table_stands():
    """Why an offset of that sensor that is there from the start cannot be known; docs/safety.md."""
    plant = make_scenario("laboratory").plant
    moved = np.zeros(plant.coupled.order)
    moved[plant.layout.table_displacement] = 0.01
    assert np.any(plant.coupled.A) and not np.any(plant.coupled.A @ moved)


@pytest.mark.parametrize("name", SHORT)
def test_no_limit_is_broken_under_a_fault(name):
    code, _ = broken_limits(CASES[name], 27, 3, 250)
    assert not code.any()


@pytest.mark.slow
@pytest.mark.parametrize("name", REQUIRED)
@pytest.mark.parametrize("seed", [11, 12])
def test_no_limit_is_broken_at_eighty_tables(name, seed):
    code, _ = broken_limits(CASES[name], 80, seed, 600)
    assert not code.any()


@pytest.mark.parametrize("name", ["dead table displacement", "observation one period late"])
def test_without_the_observer_limits_are_broken(name):
    code, _ = broken_limits(CASES[name], 27, 3, 250, without_observer)
    assert np.count_nonzero(code) >= 3


def drive(supervised, scenario, steps, fault=lambda k, observation, entry: None, entry=0):
    """Return the actions (steps, 4) and the supervisor's report; `fault` changes observations."""
    simulation, state = Simulation(scenario, 4), None
    observation = simulation.start(range(4), [np.random.default_rng(i) for i in range(4)])
    actions = []
    for k in range(steps):
        fault(k, observation, entry)
        action, state = supervised.predict(observation, state, np.full(4, k == 0))
        actions.append(action[:, 0])
        observation = simulation.step(action[:, 0].astype(float)).observation
    return np.array(actions), supervised.interventions(state)


@pytest.fixture(scope="module")
def clean():
    scenario = make_scenario("laboratory")
    return drive(Supervised(lqg(scenario), scenario), scenario, 140)[0]


@pytest.mark.parametrize(
    ("value", "place"),
    [*((np.nan, place) for place in range(5)), (np.inf, 0), (-np.inf, 2), (1e3, 1), (1e3, 4)],
)
def test_one_bad_reading_is_bridged_reported_and_forgotten(value, place, clean):
    scenario = make_scenario("laboratory")

    def spoil(k, observation, entry):
        if k == 60:
            observation[1, entry] = value

    supervised = Supervised(lqg(scenario), scenario)
    channels = Channels.from_scenario(scenario)
    actions, report = drive(supervised, scenario, 140, spoil, channels.places[place])
    assert np.isfinite(actions).all()
    counts = {name: count.tolist() for name, count in report.faults.items()}
    expected = {name: [0, int(at == place), 0, 0] for at, name in enumerate(channels.names)}
    assert counts == {**expected, OTHER_ENTRIES: [0, 0, 0, 0]}
    assert report.not_finite.sum() == 0
    assert f"{channels.names[place]} 1 at 1 tables" in str(report)
    assert np.array_equal(actions[:, [0, 2, 3]], clean[:, [0, 2, 3]])
    assert report.braked[1] <= 1 and np.abs(actions[100:, 1] - clean[100:, 1]).max() < 0.02


@pytest.mark.parametrize("which", ["ground filter", "preview", "all"])
def test_any_entry_that_is_not_a_number_is_held_and_counted(which, clean):
    scenario = make_scenario("laboratory")
    layout, places = scenario.observation, Channels.from_scenario(scenario).places
    other = np.setdiff1d(np.arange(layout.size), places)
    entry = {"ground filter": 1, "preview": other[-1], "all": np.arange(layout.size)}[which]

    def spoil(k, observation, chosen):
        if k == 60:
            observation[1, chosen] = np.nan

    actions, report = drive(Supervised(lqg(scenario), scenario), scenario, 140, spoil, entry)
    assert np.isfinite(actions).all() and report.not_finite.sum() == 0
    assert report.faults[OTHER_ENTRIES].tolist() == [0, 1, 0, 0]
    assert np.array_equal(actions[:, [0, 2, 3]], clean[:, [0, 2, 3]])
    # The controller's memory holds no NaN: its actions come back to those without the fault.
    assert report.braked[1] <= 1 and np.abs(actions[120:, 1] - clean[120:, 1]).max() < 0.05


def test_a_good_controller_raises_no_fault():
    scenario = make_scenario("laboratory", {"duration": 4.0})
    quakes = noise_earthquakes(scenario, 4, 40)
    supervised = Supervised(lqg(scenario), scenario)
    assert rollout(supervised, scenario, quakes)[0] == rollout(lqg(scenario), scenario, quakes)[0]
    report = supervised.interventions()
    assert report.acted.sum() == 0
    assert not any(count.any() for count in report.faults.values())


@pytest.mark.parametrize("noiseless", ["full state", "sensors"])
def test_constant_readings_of_a_table_at_rest_are_no_fault(noiseless):
    scenario = make_scenario("laboratory", {"sensing": "full"})
    if noiseless == "sensors":
        scenario = make_scenario("laboratory")
        quiet = tuple(replace(s, noise=0.0, bias=0.0) for s in scenario.sensing.sensors)
        scenario = replace(scenario, sensing=replace(scenario.sensing, sensors=quiet))
    _, report = drive(Supervised(NoControl(), scenario), scenario, 100)
    assert not any(count.any() for count in report.faults.values())


@pytest.mark.parametrize("signal", range(4))
def test_a_frozen_reading_without_noise_is_found_once_the_table_moves(signal):
    scenario = make_scenario("laboratory")
    quiet = tuple(replace(s, noise=0.0, bias=0.0) for s in scenario.sensing.sensors)
    scenario = replace(scenario, sensing=replace(scenario.sensing, sensors=quiet))
    channels, first = Channels.from_scenario(scenario), {}

    def freeze(k, observation, entry):
        observation[:, entry] = first.setdefault("value", observation[:, entry].copy())

    supervised = Supervised(Hostile(scenario, 4, 0), scenario)
    _, report = drive(supervised, scenario, 200, freeze, channels.places[signal])
    assert (report.faults[channels.names[signal]] > 5).any()


def test_equal_readings_are_a_fault_only_where_noise_makes_them_rare():
    channels = Channels.from_scenario(make_scenario("laboratory"))
    readings = 1e-3 * channels.reach[None].clip(max=1e6)
    moving = readings * np.array([[1.0, 0.9, 0.9, 0.9, 0.9]])
    equal, found = np.zeros((1, 5), dtype=np.int64), []
    for _ in range(8):
        impossible, _, equal = channels.incredible(readings, moving, equal)
        found.append(impossible[0].tolist())
    # Two readings are equal with a chance of 1e-3/32.768 over 2 sqrt(pi) 1e-3: five in a row, 1e-10.
    assert [row[0] for row in found] == [False] * 4 + [True] * 4
    assert not any(any(row[1:]) for row in found)
    # All five at once: the sample was lost.
    impossible, _, _ = channels.incredible(readings, readings, np.zeros((1, 5), dtype=np.int64))
    assert impossible.all()
    quiet = replace(channels, rarity=np.zeros(5))
    impossible, _, _ = quiet.incredible(readings, readings, np.full((1, 5), 99))
    assert not impossible.any()


def test_what_the_scenario_does_not_know_widens_the_covariance():
    scenario = make_scenario("laboratory")
    beta = scenario.actuator.bulk_modulus
    unsure = replace(
        scenario,
        uncertainty=Uncertainty(
            valve_gain=Uniform(1e-4, 9e-4), delay=Uniform(0.0, 10.0),
            bulk_modulus=Uniform(0.2 * beta, 1.8 * beta),
        ),
    )  # fmt: skip
    known, wide = TableStateObserver.from_scenario(scenario), TableStateObserver.from_scenario(unsure)
    commands, still = np.array([[0.0, 0.04]]), np.zeros(1)
    one, two = (
        each.predict(each.look(each.begin(1), np.zeros((1, 5)))[1], commands, still).covariance[0]
        for each in (known, wide)
    )
    assert (np.diagonal(two)[:4] > 1.5 * np.diagonal(one)[:4])[[0, 3]].all()


def test_an_observer_does_without_an_accelerometer():
    scenario = make_scenario("laboratory")
    four = tuple(s for s in scenario.sensing.sensors if s.signal != "table_acceleration")
    blind = replace(scenario, sensing=Sensing(sensors=four, preview=0.1, last_action=True))
    _, report = drive(Supervised(lqg(blind), blind), blind, 100)
    assert set(report.faults) == {s.signal for s in four} | {OTHER_ENTRIES}
    assert not any(count.any() for count in report.faults.values())


def test_the_study_writes_what_the_docs_show(tmp_path, capsys):
    cases = [CASES["no fault"], CASES["valve gain x2.0"]]
    result = sensor_fault_study(cases, lanes=9, seed=1, steps=30)
    assert list(result["cases"]) == [case.name for case in cases]
    assert result["cases"]["no fault"]["broken"] == 0
    file = tmp_path / "faults.json"
    file.write_text(json.dumps(result))
    assert main(["--table", str(file)]) == 0
    assert "| no fault | 0 |" in capsys.readouterr().out


def test_a_table_may_begin_off_the_middle_of_its_stroke():
    scenario = make_scenario("laboratory")
    place = Channels.from_scenario(scenario).places[1]
    offset = 0.02 / scenario.observation.reading_scale[0]

    def shift(k, observation, entry):
        observation[:, entry] += offset

    assert scenario.observation.reading_names[0] == "table_displacement"
    _, report = drive(Supervised(NoControl(), scenario), scenario, 60, shift, place)
    assert not any(count.any() for count in report.faults.values())


def test_the_page_shows_the_study():
    root = Path(__file__).parents[3]
    result = json.loads((root / "docs" / "results" / "fault_study.json").read_text(encoding="utf-8"))
    assert set(result["cases"]) == set(CASES)
    assert not any(row["broken"] for row in result["cases"].values() if row["required"])
    assert sensor_fault_table(result) in (root / "docs" / "safety.md").read_text(encoding="utf-8")
