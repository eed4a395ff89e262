"""The search of an experiment: the same trials however often it is cut, its trace."""

import json
import math
import os
import time
from dataclasses import replace
from types import SimpleNamespace

import pytest
from small_experiment import SMALL, TINY, essence, led_study, short_validation

from agents.__main__ import main
from agents.experiments import catalogue
from agents.experiments.recipes import ExperimentConfig
from agents.experiments.search import find_experiment, open_search, search_training, trace_of
from agents.experiments.search_figure import search_figure
from agents.experiments.search_objective import PrunedError, PruningCallback, ValidationSet
from agents.experiments.search_space import (
    Search,
    own_values,
    search_space,
    trial_config,
)
from agents.experiments.search_trace import (
    Trace,
    TrialRow,
    put_searches,
    read_trace,
    search_markdown,
    write_trace,
)
from agents.run_directory import locked_folder
from agents.training.algorithm_options import SACOptions
from agents.training.config import TrainConfig
from baselines.lqr.sampled import lqr
from shake_env.errors import ParameterError, RunDirectoryError, ScenarioError

SEARCH = Search(experiment=TINY, share=0.5, earthquakes=2)


@pytest.fixture(scope="module", autouse=True)
def _short_validation_without_figures():
    with short_validation():
        yield


# The search


def test_the_reference_costs_what_it_costs():
    validation = ValidationSet(TINY, 2)
    found = validation.judge(lqr(validation.scenario))
    assert found == {"cost": 1.0, "low": 1.0, "high": 1.0, "lost": 0}
    assert validation.reference == "lqr" and validation.reference_lost == 0


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    return search_training(SEARCH, folder / "r.db", folder, trials=3)


def test_the_first_trial_is_the_experiment(whole):
    assert [row.default for row in whole.trials] == [True, False, False]
    assert whole.trials[0].values == whole.own
    assert whole.start.cost == whole.trials[0].cost > 0.0
    assert whole.best.cost == min(row.cost for row in whole.trials)
    assert len({json.dumps(row.values) for row in whole.trials}) == 3
    assert all(row.seconds > 0.0 for row in whole.trials)


@pytest.mark.parametrize(
    ("late", "trials"), [(False, 2), (True, 3)], ids=["at its first step", "at its last"]
)
def test_a_search_that_was_cut_ends_as_one_that_was_not(whole, tmp_path, late, trials):
    storage = tmp_path / "r.db"

    def cut(now):
        told = now.progress
        if now.done == 1 and told is not None and (told.steps > 0) == late:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        search_training(SEARCH, storage, tmp_path, trials=trials, on_update=cut)
    assert len(search_training(SEARCH, storage, tmp_path, trials=1).trials) == 1
    seen = []
    again = search_training(SEARCH, storage, tmp_path, trials=trials, on_update=seen.append)
    assert essence(again) == essence(whole)[:trials]
    assert (tmp_path / SEARCH.name / "1" / "result.json").exists()  # the run that was cut, gone on with
    assert not (tmp_path / SEARCH.name / "2").exists()
    assert not list((tmp_path / SEARCH.name).glob("*/checkpoints"))
    assert [now.done for now in seen if now.progress is None] == list(range(2, trials + 1))
    assert seen[-1].seconds_left == 0.0 and seen[-1].best == again.best.cost
    # What is done is not done again.
    assert search_training(SEARCH, storage, tmp_path, trials=trials) == again


def test_time_ends_a_search_and_the_trial_stays(whole, tmp_path, monkeypatch):
    trace = search_training(SEARCH, tmp_path / "r.db", tmp_path, trials=3, minutes=1e-9)
    assert trace.trials == ()
    monkeypatch.setattr("agents.training.watch.REPORT_PERIOD", 0.0)  # after every roll-out
    over = []
    clock = SimpleNamespace(
        monotonic=lambda: math.inf if over else time.monotonic(), process_time=time.process_time
    )
    with monkeypatch.context() as patch:
        patch.setattr("agents.experiments.search_work.time", clock)
        trace = search_training(
            SEARCH, tmp_path / "r.db", tmp_path, trials=2, minutes=60.0, on_update=over.append
        )
    assert trace.trials == () and len(over) == 1  # it ended at the next report
    assert [t.state.name for t in open_search(SEARCH, tmp_path / "r.db").get_trials()] == ["RUNNING"]
    # A run that is through is not thrown away.
    over.clear()

    def end(now):
        if now.progress is not None and now.progress.steps == now.progress.total_steps:
            over.append(now)

    with monkeypatch.context() as patch:
        patch.setattr("agents.experiments.search_work.time", clock)
        trace = search_training(
            SEARCH, tmp_path / "r.db", tmp_path, trials=2, minutes=60.0, on_update=end
        )
    assert over and essence(trace) == essence(whole)[:1]


@pytest.fixture
def led(tmp_path):
    """A study, in Optuna's own storage, of five trials that reached a thousandth of the cost."""
    return led_study(SEARCH, tmp_path / "r.db")


def test_a_trial_behind_the_others_is_ended(led, tmp_path):
    search, study = led
    search_training(search, tmp_path / "r.db", tmp_path, trials=6)
    last = study.get_trials()[-1]
    assert last.state.name == "PRUNED" and "cost" not in last.user_attrs
    assert last.user_attrs["ratio"] == min(last.intermediate_values.values()) > 1e-3
    assert not (tmp_path / search.name / str(last.number) / "result.json").exists()
    assert trace_of(search, study).trials[-1].state == "pruned"


def test_what_is_judged_is_the_policy_that_a_run_keeps(led, tmp_path):
    _, study = led
    config = trial_config(TINY, {}, 1.0)

    def evaluated(*rows):
        lines = [json.dumps({"steps": s, "cost_ratio": c}) for s, c in rows]
        (tmp_path / "evaluations.jsonl").write_text("\n".join(lines))
        return PruningCallback(study.ask(), config, tmp_path)

    judge = evaluated((0, 1e-4), (512, math.nan), (640, 9.0))
    judge.report()  # its first is ahead of every other trial
    assert judge.best == 1e-4
    with pytest.raises(PrunedError):  # it caught up, but was behind before
        evaluated((0, 2e-3), (512, 2e-3), (768, 1e-4)).report()
    evaluated((0, 2e-3), (128, 2e-3), (512, 1e-4)).report()  # a beginning is let be
    evaluated((0, 2e-3), (1_024, 2e-3)).report()  # so is an end


def test_a_storage_with_another_recipe_and_a_foreign_run_are_left_alone(tmp_path):
    storage = tmp_path / "r.db"
    open_search(SEARCH, storage)
    other = replace(SEARCH, experiment=replace(TINY, config=replace(SMALL, net_arch=(16,))))
    with pytest.raises(ParameterError, match="another --storage"):
        open_search(other, storage)
    config, knobs = json.loads(SEARCH.identity())
    del config["episode_duration"]
    assert not SEARCH.same(json.dumps([config, knobs]))
    del config["threads"]  # as of a version before there was that option: its default is this search's
    config["episode_duration"] = 0.2
    assert SEARCH.same(json.dumps([config, knobs]))
    run = tmp_path / SEARCH.name / "0"
    run.mkdir(parents=True)
    (run / "config.json").write_text(json.dumps(SMALL.to_json()))
    with pytest.raises(RunDirectoryError, match="move it away"):
        search_training(SEARCH, storage, tmp_path, trials=1)
    assert trace_of(SEARCH, open_search(SEARCH, storage)).trials == ()


def test_two_processes_do_not_run_one_search(tmp_path):
    with (
        locked_folder(tmp_path / SEARCH.name),
        pytest.raises(RunDirectoryError, match=f"in use by process {os.getpid()}"),
    ):
        search_training(SEARCH, tmp_path / "r.db", tmp_path, trials=1)


@pytest.mark.parametrize(
    ("changed", "remedy"),
    [
        ({"share": 0.0}, "at most 1"),
        ({"share": 1.5}, "at most 1"),
        ({"seed": -1}, "at least 0"),
        ({"earthquakes": 0}, "at least 1"),
    ],
)
def test_what_cannot_be_searched_is_named(changed, remedy):
    with pytest.raises(ParameterError, match=remedy):
        replace(SEARCH, **changed)


def test_a_share_that_ends_within_the_warm_up_is_named():
    config = TrainConfig(algorithm="sac", sac=SACOptions(learning_starts=20_000))
    with pytest.raises(ParameterError, match=r"above 0\.08"):
        Search(
            experiment=ExperimentConfig(evaluation_task="linear", config=config, minutes=1.0), share=0.05
        )


# The trace


def made(**changed):
    """A trace with a trial of each kind."""
    knobs = search_space(find_experiment("yielding/sac"))
    own = {k.name: own_values(find_experiment("yielding/sac"))[k.name] for k in knobs}
    held = {"low": 0.9, "high": 1.1, "lost": 0, "ratio": 1.0, "seconds": 3_600.0, "code": "abc"}
    rows = [
        TrialRow(number=0, state="complete", values=own, cost=1.0, default=True, **held),
        TrialRow(
            number=1, state="pruned", values={**own, "discount_horizon": 1.5}, cost=None, ratio=4.0
        ),
        TrialRow(number=3, state="complete", values={**own, "residual_scale": 0.4}, cost=0.8, **held),
        TrialRow(
            number=4,
            state="complete",
            values={**own, "base_controller": "lqr"},
            cost=50.0,
            **{**held, "lost": 3},
        ),
        TrialRow(number=5, state="failed", values=own, cost=None, failure="ValueError: nan"),
    ]
    values = {
        "experiment": "yielding/sac", "share": 0.3, "steps": 75_000, "seed": 0, "train_seed": 9,
        "earthquakes": 64, "validation_seed": 3_000_000, "reference": "preview-lqr",
        "reference_lost": 0, "version": "1", "machine": "m", "space": knobs, "own": own,
        "trials": tuple(rows),
    }  # fmt: skip
    return Trace(**{**values, **changed})


def test_a_trace_comes_back_as_it_was(whole, tmp_path):
    for trace in (whole, made()):
        write_trace(trace, tmp_path / "training_search_x.json")
        assert read_trace(tmp_path / "training_search_x.json") == trace
    plain = json.loads((tmp_path / "training_search_x.json").read_text())
    counts = {"complete": 3, "failed": 1, "pruned": 1, "processor_seconds": 10_800.0}
    assert plain["budget"] == counts
    assert [row["lost"] for row in plain["trials"]] == [0, None, 0, 3, None]
    assert plain["trials"][4]["failure"] == "ValueError: nan"


def test_a_trace_that_cannot_be_is_named(tmp_path):
    with pytest.raises(ParameterError, match="nothing to keep"):
        write_trace(made(trials=()), tmp_path / "x.json")
    with pytest.raises(ParameterError, match="training_search_linear_ppo"):
        write_trace(made(), tmp_path / "x.txt")
    for text in ("", "[]", '{"format": "other"}'):
        (tmp_path / "x.json").write_text(text)
        with pytest.raises(ParameterError, match="no trace"):
            read_trace(tmp_path / "x.json")


def test_a_page_gets_its_searches_between_the_markers(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- training searches -->\nold\n<!-- end training searches -->\nafter\n")
    put_searches(page, [made()])
    first = page.read_text()
    put_searches(page, [made()])
    assert page.read_text() == first  # made anew, the same
    assert first.startswith("before\n") and first.endswith("\nafter\n") and "old" not in first
    assert "| cost [95 %] | | 1 [0.9, 1.1] | 0.8 [0.9, 1.1] | to 0.8 |" in first
    assert "3 complete, 1 failed, 1 pruned" in first and "3.0 hours" in first
    assert "figures/training_search_yielding_sac.png" in first
    assert "No trial came to be judged" in search_markdown(made(trials=made().trials[1:2]), "figures")
    put_searches(page, [])
    assert page.read_text() == (
        "before\n<!-- training searches -->\n<!-- end training searches -->\nafter\n"
    )
    page.write_text("nothing\n")
    with pytest.raises(ParameterError, match="put the lines"):
        put_searches(page, [made()])


def test_a_figure_has_a_panel_for_each_value(tmp_path):
    file = search_figure(made(), tmp_path)
    assert file.name == "training_search_yielding_sac.png" and file.read_bytes()[:4] == b"\x89PNG"


def test_the_command_goes_on_keeps_and_renews(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(catalogue, "EXPERIMENTS", (TINY,))
    kept, page = tmp_path / "kept" / "training_search_linear_ppo.json", tmp_path / "page.md"
    page.write_text("<!-- training searches -->\n<!-- end training searches -->\n")
    words = ["tune-training", "linear/ppo", "--step-fraction", "0.5", "--earthquakes", "2", "--json"]
    words += ["--storage", str(tmp_path / "r.db"), "--folder", str(tmp_path / "runs")]
    assert main([*words, "--trials", "1"]) == 0
    first = json.loads(capsys.readouterr().out)
    assert main([*words, "--trials", "2"]) == 0
    second = json.loads(capsys.readouterr().out)
    assert second["trials"][0] == first["trials"][0] and len(second["trials"]) == 2
    words += ["--trials", "0", "--output", str(kept), "--page", str(page), "--results", str(kept.parent)]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out) == second
    assert read_trace(kept).to_json() == second
    assert "### linear/ppo" in page.read_text()
    assert (tmp_path / "figures" / "training_search_linear_ppo.png").is_file()
    assert main(["tune-training", "linear/pop"]) == 2
    assert "linear/ppo" in capsys.readouterr().err
    with pytest.raises(ScenarioError):
        find_experiment("linear/sac")
