"""The search of a controller's free parameters: budget, resumption, and that it finds what is there."""

import json
import os
import sqlite3
import time
from contextlib import closing, nullcontext
from threading import Timer

import numpy as np
import optuna
import pytest
import unit_calls

from agents.__main__ import main
from agents.execution.local_executor import LocalExecutor
from agents.execution.units import UnitRunner
from agents.execution.worker import Call
from agents.experiments.controller_tuning import FAILED, keep_tuned_values, tune, tune_each
from agents.experiments.parameter_search import search_parameters
from agents.experiments.study_storage import open_study, storage_errors
from baselines import registry
from baselines.baseline import Baseline, Tunable
from baselines.catalogue import BASELINES
from baselines.lqr.sampled import LinearFeedback, sampled_lqr
from baselines.registry import make_baseline
from baselines.tuned_values import read_tuned
from shake_env import make_scenario
from shake_env.errors import NumericalError, ParameterError, RunDirectoryError, ScenarioError

SHORT = make_scenario("linear", {"duration": 0.5})  # 100 control periods


def scaled_lqr(scenario, *, share, offset=0.0):
    """LQR's gain times a share: at 1 it is the optimum, so that a search has something to find."""
    if share > 4.0:
        raise NumericalError("share", share, "too large a gain for this test")
    return LinearFeedback(scenario, share * sampled_lqr(scenario.discrete, scenario.stage_cost).gain)


@pytest.fixture
def bench():
    """A controller of the test's own in the catalogue, which afterwards is as it was, its order too."""
    before = dict(BASELINES)
    tunable = {"share": Tunable(0.1, 8.0, 0.2)}
    BASELINES["scaled"] = Baseline(scaled_lqr, "LQR's gain times a share", tunable)
    yield
    BASELINES.clear()
    BASELINES.update(before)


def test_it_finds_the_optimum_within_its_budget(bench, tmp_path):
    found = tune("scaled", SHORT, tmp_path / "t.db", budget=25 * 800, earthquakes=8)
    assert found.trials == 25 and found.table_steps == 25 * 800
    assert found.cost < 0.5 * found.default_cost < FAILED
    assert 0.6 < found.parameters["share"] < 1.6


def test_a_search_goes_on_where_it_stopped(bench, tmp_path):
    storage = tmp_path / "t.db"
    first = tune("scaled", SHORT, storage, budget=4 * 800, earthquakes=8)
    told = []
    again = tune(
        "scaled", SHORT, storage, budget=6 * 800, earthquakes=8, on_trial=lambda *a: told.append(a[:2])
    )
    assert first.trials == 4 and again.trials == 6 and told == [(5, 6), (6, 6)]
    assert again.cost <= first.cost and again.default_cost == first.default_cost
    same = tune("scaled", SHORT, tmp_path / "u.db", budget=4 * 800, earthquakes=8)
    assert same.parameters == first.parameters  # the seed decides


def test_a_storage_that_is_none_is_named_and_left_as_it_is(bench, tmp_path):
    junk, stranger = tmp_path / "junk.db", tmp_path / "stranger.db"
    junk.write_text("no database" * 100)
    with closing(sqlite3.connect(stranger)) as file:
        file.execute("create table studies (mine int)")
    os.mkfifo(tmp_path / "fifo")
    for path, words in (
        (junk, "not a database"),
        (stranger, "another program's"),
        (tmp_path / "fifo", "pipe"),
    ):
        content = path.read_bytes() if path.is_file() else b""
        with pytest.raises(ParameterError, match=words):
            tune("scaled", SHORT, path, budget=800, earthquakes=8)
        assert not content or path.read_bytes() == content
    odd = tmp_path / "50% of a?b#c{x}.db"  # characters with a meaning in an address
    tune("scaled", SHORT, odd, budget=800, earthquakes=8)
    assert odd.stat().st_size > 10_000
    with storage_errors(odd), pytest.raises(KeyError):
        raise KeyError  # what is no storage's error passes


def test_two_processes_never_search_one_study(bench, tmp_path):
    """The lock is the study's: another study in the same storage goes on."""
    others = []

    def beside(done, total, best):
        for seed in (0, 1):
            try:
                tune("scaled", SHORT, tmp_path / "t.db", budget=800, earthquakes=8, seed=seed)
                others.append(seed)
            except RunDirectoryError as error:
                assert "is in use by process" in str(error) and error.field == "study"

    tune("scaled", SHORT, tmp_path / "t.db", budget=800, earthquakes=8, on_trial=beside)
    assert others == [1]


@pytest.mark.parametrize("total", [1, 3, 5])
def test_a_search_that_was_cut_in_its_first_trial_keeps_the_defaults_cost(tmp_path, total):
    tunable = {"x": Tunable(0.0, 10.0, 5.0, logarithmic=False)}
    starts = [{"x": 5.0}, {"x": 1.0}, {"x": 9.0}]

    def cost(values):
        return (values["x"] - 1.0) ** 2

    def cut(values):
        raise KeyboardInterrupt

    def run(name, cost):
        with storage_errors(tmp_path / "t.db"):
            return search_parameters(
                cost, tunable, tmp_path / "t.db", name, total, 0, lambda *a: None, starts
            )

    whole = run("whole", cost)
    with pytest.raises(KeyboardInterrupt):
        run("cut", cut)
    resumed = run("cut", cost)
    assert resumed.default_cost == whole.default_cost == 16.0
    assert (resumed.trials, resumed.cost, resumed.parameters) == (total, whole.cost, whole.parameters)
    # Cut in the second one, too, and as earlier versions left it: the others queued, the first lost.
    study, _ = open_study(tmp_path / "t.db", "queued")
    for start in starts:
        study.enqueue_trial(start)
    study.ask()
    assert run("queued", cost).default_cost == 16.0


def test_kept_results_are_what_the_registry_takes(bench, tmp_path, monkeypatch):
    file = tmp_path / "tuned.json"
    found = tune("scaled", SHORT, tmp_path / "t.db", budget=3 * 800, earthquakes=8)
    keep_tuned_values(found, file)
    monkeypatch.setattr(registry, "packaged_values", lambda: read_tuned(file))
    row = make_baseline("scaled", SHORT).row
    expected = scaled_lqr(SHORT, **found.parameters).row
    np.testing.assert_array_equal(row, expected)
    with pytest.raises(ScenarioError, match="parameter of scaled"):
        make_baseline("scaled", SHORT, {"shar": 1.0})


def test_command_prints_one_json_object(bench, tmp_path, capsys):
    arguments = ["tune", "scaled", "--duration", "0.5", "--budget", "1600", "--earthquakes", "8"]
    assert main([*arguments, "--storage", str(tmp_path / "t.db"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["trials"] == 2 and found["controller"] == "scaled"


def test_a_repeated_test_is_paid_for(tmp_path):
    # 100 periods, ten tests.
    found = tune("tf-iteration", SHORT, tmp_path / "t.db", budget=3_000, earthquakes=1)
    assert found.trials == 3 and found.table_steps == 3_000


def test_all_tunes_whatever_has_something_to_tune(bench, tmp_path, capsys):
    for name in set(BASELINES) - {"scaled", "lqr", "mpc"}:
        del BASELINES[name]
    arguments = ["tune", "all", "--duration", "0.5", "--budget", "1600", "--earthquakes", "8"]
    assert main([*arguments, "--storage", str(tmp_path / "t.db"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["scaled"]["trials"] == 2
    assert "no free parameter" in found["lqr"]["left_out"]
    assert "without limits" in found["mpc"]["left_out"]


@pytest.mark.parametrize(
    ("name", "budget", "error"),
    [("absent", 10_000, ScenarioError), ("lqr", 10_000, ParameterError), ("scaled", 10, ParameterError)],
)
def test_what_cannot_be_searched_is_named(bench, tmp_path, name, budget, error):
    with pytest.raises(error):
        tune(name, SHORT, tmp_path / "t.db", budget=budget, earthquakes=8)


def test_a_tunable_range_must_hold_its_default():
    for values in ((2.0, 1.0, 1.5), (0.0, 1.0, 0.5), (1.0, 2.0, 3.0)):
        with pytest.raises(ParameterError, match="tunable range"):
            Tunable(*values)


def test_workers_search_as_one_process_does(tmp_path, capsys):
    arguments = ["tune", "preview-lqr", "--duration", "0.5", "--earthquakes", "1", "--budget", "1800"]

    def trials(name, *options):
        storage = str(tmp_path / f"{name}.db")
        assert main([*arguments, "--storage", storage, *options, "--json"]) == 0
        result = json.loads(capsys.readouterr().out)
        study = optuna.load_study(study_name=None, storage=f"sqlite:///{storage}")
        return result, [(t.params, t.value, t.state.name) for t in study.get_trials(deepcopy=False)]

    here, alone = trials("here")
    units = ["--units", str(tmp_path / "units")]
    # A bound on its memory makes one process a worker.
    assert trials("one", *units, "--worker-memory", "8") == (here, alone)
    result, several = trials("two", *units, "--processes", "2")
    assert len(several) == len(alone) == here["trials"] == result["trials"]
    assert {state for *_, state in several} == {"COMPLETE"}
    assert several[0] == alone[0] and result["default_cost"] == here["default_cost"]


def test_workers_fill_a_study_that_others_may_share(tmp_path):
    storage = f"journal:{tmp_path / 'study'}"
    with storage_errors(storage), LocalExecutor(2) as executor:
        found = search_parameters(
            None, {"x": Tunable(0.0, 10.0, 5.0, logarithmic=False)}, storage, "study", 12, 0,
            lambda *told: None, [{"x": 5.0}, {"x": 1.0}], executor,
            lambda number, values: Call(f"trial {number}", unit_calls.distance, (values["x"], 1.0)),
        )  # fmt: skip
        study, made = open_study(storage, "study")
    assert not made and found.trials == 12
    states = [t.state.name for t in study.get_trials(deepcopy=False)]
    assert states == ["COMPLETE"] * 12
    assert (found.default_cost, found.cost, found.parameters) == (16.0, 0.0, {"x": 1.0})


@pytest.mark.parametrize("workers", [0, 2])
def test_an_interruption_leaves_no_trial_that_others_wait_for(workers, tmp_path):
    storage = f"journal:{tmp_path / 'study'}"

    def search(cost, seconds=0.0, on_trial=lambda *told: None):
        def call(number, values):
            return Call("x", unit_calls.distance, (values["x"], 1.0, seconds * number))

        x, starts = Tunable(0.0, 10.0, 5.0, logarithmic=False), [{"x": 5.0}, {"x": 1.0}, {"x": 2.0}]
        with LocalExecutor(workers) if workers else nullcontext() as executor:
            return search_parameters(
                cost, {"x": x}, storage, "study", 4, 0, on_trial, starts, executor, call
            )

    def cut(*told):
        raise KeyboardInterrupt

    with storage_errors(storage):
        with pytest.raises(KeyboardInterrupt):
            search(cut, 60.0, cut)
        study, _ = open_study(storage, "study")
        states = [t.state.name for t in study.get_trials(deepcopy=False)]
        assert "RUNNING" not in states and states.count("FAIL") == 1
        began = time.monotonic()
        found = search(lambda values: (values["x"] - 1.0) ** 2)
        assert time.monotonic() - began < 60.0  # without the time after which a sign of life is missed
        values = [t.params["x"] for t in study.get_trials(deepcopy=False) if t.value is not None]
    assert found.trials == 4 == len(values) and {5.0, 1.0, 2.0} < set(values)


def test_the_defaults_cost_is_waited_for_where_another_process_computes_it(tmp_path):
    x, storage = Tunable(0.0, 10.0, 5.0, logarithmic=False), f"journal:{tmp_path / 'study'}"
    with storage_errors(storage):
        study, _ = open_study(storage, "study")
        study.enqueue_trial({"x": 5.0})
        other = study.ask()
        values = [other.suggest_float("x", x.low, x.high), study.ask().suggest_float("x", x.low, x.high)]
        study.tell(1, (values[1] - 1.0) ** 2)
        later = Timer(1.2, lambda: study.tell(other, 16.0))
        later.start()
        found = search_parameters(
            lambda values: pytest.fail(f"computed {values}"), {"x": x}, storage, "study", 1, 0,
            lambda *told: None, [{"x": 5.0}],
        )  # fmt: skip
        later.join()
    assert (found.default_cost, found.trials) == (16.0, 2)


def test_a_storage_that_no_controller_can_use_ends_the_search_of_all(tmp_path):
    (tmp_path / "notes.txt").write_text("no journal")
    for storage in ("foo://bar", f"journal:{tmp_path / 'notes.txt'}", "journal:"):
        with pytest.raises(ParameterError, match="storage"):
            tune_each(
                ["preview-lqr"], make_scenario(), storage, budget=20_000, earthquakes=1, seed=0,
                tuned=None, runner=UnitRunner(), on_progress=lambda name, share: None,
            )  # fmt: skip


def test_workers_of_other_machines_need_a_storage_that_they_share(tmp_path):
    class Elsewhere(LocalExecutor):
        on_this_machine = False

    with (
        Elsewhere(1) as executor,
        pytest.raises(ParameterError, match=r"file of this machine.*journal:FILE"),
    ):
        tune_each(
            ["preview-lqr"], make_scenario(), tmp_path / "t.db", budget=20_000, earthquakes=1, seed=0,
            tuned=None, runner=UnitRunner(executor), on_progress=lambda name, share: None,
        )  # fmt: skip
    assert not (tmp_path / "t.db").exists()
