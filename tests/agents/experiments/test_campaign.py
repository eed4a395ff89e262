"""A campaign: what is done is skipped, what was killed goes on, what fails stops no other."""

import json
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from functools import partial
from typing import get_args, get_type_hints

import numpy as np
import pytest

from agents.__main__ import main
from agents.evaluation.entries import find_entry
from agents.evaluation.protocol import evaluate
from agents.execution.environment import environment
from agents.execution.local_executor import LocalExecutor
from agents.experiments import catalogue
from agents.experiments.catalogue import EXPERIMENTS
from agents.experiments.evaluation_tasks import EVALUATION_TASKS, EvaluationTask
from agents.experiments.recipes import ExperimentConfig
from agents.experiments.results import evaluate_task
from agents.experiments.runner import Campaign, plan_rows, plan_runs
from agents.policies.base_law import base_law
from agents.policies.estimated_law import EstimatedLaw
from agents.policies.policy_file import file_digest, load_policy
from agents.run_directory import locked_folder
from agents.scenario_options import ScenarioOptions
from agents.training.algorithm_options import PPOOptions
from agents.training.checkpoint import checkpoints
from agents.training.config import TrainConfig
from agents.training.run import resume, train, train_or_resume
from shake_env.errors import ParameterError, RunDirectoryError, ScenarioError

SMALL = TrainConfig(
    scenario=ScenarioOptions(duration=1.0),
    ppo=PPOOptions(n_envs=4, n_steps=16, batch_size=64, n_epochs=1),
    net_arch=(8,),
    episode_duration=0.2,
    total_timesteps=2_048,
    evaluations=1,
    evaluation_earthquakes=1,
    checkpoint_interval=1e-9,
)
GOOD = ExperimentConfig(evaluation_task="linear", config=SMALL, minutes=0.1, seeds=1)
BAD = ExperimentConfig(
    evaluation_task="linear",
    label="bad",
    config=TrainConfig(scenario=ScenarioOptions("nowhere")),
    minutes=0.1,
    seeds=1,
)


@pytest.fixture(scope="module")
def campaigned(tmp_path_factory):
    """A campaign that was interrupted once, beside a run that fails."""
    folder = tmp_path_factory.mktemp("campaign")

    def cut(campaign):
        if len(checkpoints(folder / "linear/ppo/0")) == 2:
            raise KeyboardInterrupt

    with LocalExecutor(1) as executor, pytest.raises(KeyboardInterrupt):
        Campaign(plan_runs([GOOD], folder)).run(executor, cut)
    assert not (folder / "linear/ppo/0/result.json").exists()
    begun = plan_runs([GOOD, BAD], folder)
    assert [task.state for task in begun] == ["begun", "waiting"]
    assert 0.0 < begun[0].share < 1.0
    campaign = Campaign(begun)
    seen = []
    with LocalExecutor(2) as executor:
        campaign.run(executor, lambda campaign: seen.append(campaign.seconds_left()))
    return folder, campaign, seen


def test_an_interrupted_campaign_ends_as_if_it_had_not_been(campaigned, tmp_path):
    folder, campaign, seen = campaigned
    assert campaign.tasks[0].state == "done"
    train(SMALL, tmp_path / "whole")
    whole, cut = (
        load_policy(run / "policy.safetensors") for run in (tmp_path / "whole", folder / "linear/ppo/0")
    )
    for one, two in zip((*whole.weights, *whole.biases), (*cut.weights, *cut.biases), strict=True):
        np.testing.assert_array_equal(one, two)
    assert cut.card["command"] == "shake run-experiments --experiments linear/ppo"
    assert cut.card["curve"][-1][0] == 2_048
    assert seen[0] > seen[-1] == 0.0


def test_a_run_that_fails_is_reported_and_stops_no_other(campaigned):
    _, campaign, _ = campaigned
    assert campaign.counts() == {"done": 1, "failed": 1}
    assert list(campaign.failures()) == ["linear/bad/0"]
    assert "nowhere" in campaign.failures()["linear/bad/0"]


def _begins_with(label, seeds=1):
    """An experiment that goes on from another one of the linear table."""
    config = replace(SMALL, init_policy=label)
    return ExperimentConfig(
        evaluation_task="linear", label="later", config=config, minutes=0.1, seeds=seeds
    )


def test_an_experiment_begins_with_the_policy_of_the_same_seed_of_another(tmp_path):
    first, later = replace(GOOD, label="first"), _begins_with("first", seeds=2)
    last = replace(_begins_with("later", seeds=2), label="last")
    tasks = plan_runs([last, later, first], tmp_path, ["linear/last"])
    assert sorted(task.name for task in tasks) == [
        f"linear/{name}/{seed}" for name in ("first", "last", "later") for seed in (0, 1)
    ]
    campaign = Campaign(tasks)
    with LocalExecutor(2) as executor:
        campaign.run(executor)
    assert campaign.counts() == {"done": 6}, campaign.failures()
    for seed in (0, 1):
        for ahead, name in (("first", "later"), ("later", "last")):
            begun = tmp_path / f"linear/{ahead}/{seed}/policy.safetensors"
            card = load_policy(tmp_path / f"linear/{name}/{seed}/policy.safetensors").card
            assert card["first"]["sha256"] == file_digest(begun)
            assert card["config"]["init_policy"] == ahead  # no path: the folder may be moved
    assert {task.state for task in plan_runs([last, later, first], tmp_path)} == {"done"}


def test_a_run_whose_first_policy_is_not_there_is_a_failure(tmp_path):
    campaign = Campaign(plan_runs([BAD, _begins_with("bad")], tmp_path))
    with LocalExecutor(1) as executor:
        campaign.run(executor)
    assert campaign.counts() == {"failed": 2}
    assert "linear/bad/0, which is not done" in campaign.failures()["linear/later/0"]


def test_what_is_done_is_done_and_another_configuration_is_left_alone(campaigned):
    folder, _, _ = campaigned
    assert plan_runs([GOOD], folder)[0].state == "done"
    changed = ExperimentConfig(
        evaluation_task="linear", config=TrainConfig(total_timesteps=99), minutes=0.1, seeds=1
    )
    tasks = plan_runs([changed], folder)
    assert tasks[0].state == "foreign"
    campaign = Campaign(tasks)
    campaign.run(LocalExecutor(1))
    assert "move it away" in campaign.failures()["linear/ppo/0"]
    assert plan_runs([GOOD], folder)[0].state == "done"


@pytest.mark.parametrize("file", ["result.json", "config.json"])  # of a finished run, and of a begun one
def test_a_run_of_other_code_counts_only_where_that_is_asked_for(campaigned, tmp_path, file):
    folder = tmp_path / "campaign"
    shutil.copytree(campaigned[0], folder)
    run = folder / "linear/ppo/0"
    if file == "config.json":
        (run / "result.json").unlink()
    state = plan_runs([GOOD], folder)[0].state
    assert state == {"result.json": "done", "config.json": "begun"}[file]
    made = json.loads((run / "environment.json").read_text())
    for values in ({**made, "code": "0" * 16}, {**made, "numpy": "1.0"}, None):
        (run / "environment.json").unlink()
        if values is not None:
            (run / "environment.json").write_text(json.dumps(values))
        (task,) = plan_runs([GOOD], folder)
        assert task.state == "foreign" and "--any-code" in task.failure
        assert values is None or next(iter(set(values.values()) - set(made.values()))) in task.failure
    assert plan_runs([GOOD], folder, any_code=True)[0].state == state


def test_a_run_that_other_code_began_and_this_code_ended_counts_for_neither(campaigned, tmp_path):
    folder = tmp_path / "campaign"
    shutil.copytree(campaigned[0], folder)
    run = folder / "linear/ppo/0"
    (run / "result.json").unlink()
    file, own = run / "environment.json", environment()
    file.write_text(json.dumps({**own, "code": "0" * 16}))
    resume(run)
    assert json.loads(file.read_text()) == {**own, "code": f"{'0' * 16}, {own['code']}"}
    resume(run)  # done: nothing is added
    (task,) = plan_runs([GOOD], folder)
    assert task.state == "foreign" and own["code"] in task.failure


def test_an_attempt_of_other_code_without_a_checkpoint_begins_anew(tmp_path):
    run = tmp_path / "linear/ppo/0"
    run.mkdir(parents=True)
    (run / "config.json").write_text(json.dumps(SMALL.to_json()))
    (run / "environment.json").write_text(json.dumps({**environment(), "code": "0" * 16}))
    assert plan_runs([GOOD], tmp_path)[0].state == "waiting"
    train_or_resume(SMALL, run)
    assert plan_runs([GOOD], tmp_path)[0].state == "done"


def test_runs_that_are_refused_are_named_by_a_plan_and_not_evaluated(
    campaigned, tmp_path, monkeypatch, capsys
):
    folder = tmp_path / "campaign"
    shutil.copytree(campaigned[0], folder)
    (folder / "linear/ppo/0/environment.json").write_text(json.dumps({**environment(), "code": "0"}))
    monkeypatch.setattr(catalogue, "EXPERIMENTS", (GOOD,))
    words = ["run-experiments", "--folder", str(folder), "--results", str(tmp_path / "out"), "--json"]
    assert main([*words, "--dry-run"]) == 0
    plan = json.loads(capsys.readouterr().out)
    assert list(plan["refused"]) == ["linear/ppo/0"]
    assert plan["minutes_left"] == plan["plan"][0]["minutes_left"] == 0.0
    assert main(words) == 1
    assert list(json.loads(capsys.readouterr().out)["failures"]) == [
        "linear/ppo/0",
        "evaluation of linear",
    ]
    assert not list((tmp_path / "out").glob("*"))


def test_an_evaluation_holds_until_its_policies_change(campaigned, tmp_path, monkeypatch):
    monkeypatch.setattr("agents.experiments.results.evaluate", partial(evaluate, resamples=50))
    folder = tmp_path / "campaign"
    shutil.copytree(campaigned[0], folder)
    task = EvaluationTask(
        name="linear", options=ScenarioOptions(duration=1.0), baselines=("none",), earthquakes=2
    )
    file, result, made = evaluate_task(task, folder, tmp_path / "results")
    assert made
    assert {row["controller"] for row in result["rows"]} == {"lqr", "ppo", "none"}
    assert not evaluate_task(task, folder, tmp_path / "results")[2]
    assert json.loads(file.read_text())["identity"] == result["identity"]
    shutil.copytree(folder / "linear/ppo/0", folder / "linear/ppo/1")
    _, result, made = evaluate_task(task, folder, tmp_path / "results")
    assert made
    assert next(row for row in result["rows"] if row["controller"] == "ppo")["runs"] == 2

    # A row whose policies are gone stays beside a new one, and so does a row of whose policies some are
    # gone: both keep the figures of what they were made of.
    (folder / "linear/ppo/1").rename(folder / "linear/other")
    assert not evaluate_task(task, folder, tmp_path / "results")[2]
    shutil.rmtree(folder / "linear/ppo")
    (folder / "linear/sac").mkdir()
    (folder / "linear/other").rename(folder / "linear/sac/0")
    _, later, made = evaluate_task(task, folder, tmp_path / "results")
    assert made
    before, after = ({row["controller"]: row for row in r["rows"]} for r in (result, later))
    assert after.pop("sac")["run_costs"] == before["ppo"]["run_costs"][:1]
    assert later["episodes"]["ppo"] == result["episodes"]["ppo"]
    for figure, value in before["ppo"].items():
        # Figures of costs come of those that are kept, to seven digits.
        number = figure != "sources" and not isinstance(value, str | type(None))
        assert after["ppo"][figure] == (pytest.approx(value, rel=1e-5) if number else value), figure
    assert after["lqr"]["relative_cost"] == before["lqr"]["relative_cost"]

    # Fewer others do not take the place of a row, and nothing stays of what was asked otherwise, or of
    # what was run on tables that do otherwise now.
    fewer = later["identity"]["rows"]["ppo"]
    later["identity"]["rows"]["sac"] = ["0" * 64, "1" * 64]
    file.write_text(json.dumps(later))
    with pytest.raises(ParameterError, match="1 in the folder, not all of them among the 2"):
        evaluate_task(task, folder, tmp_path / "results")
    later["identity"]["rows"] = {"ppo": fewer}
    later["episodes"]["none"]["cost"][0][0] *= 1.01
    file.write_text(json.dumps(later))
    with pytest.raises(ParameterError, match="its costs differ"):
        evaluate_task(task, folder, tmp_path / "results")
    other = replace(task, options=ScenarioOptions(duration=1.0, set=("objective.force_weight=2",)))
    with pytest.raises(ParameterError, match="no result of linear as it is asked for now"):
        evaluate_task(other, folder, tmp_path / "results")
    assert evaluate_task(other, folder, tmp_path / "results", again=True)[2]


def test_a_run_of_another_version_is_foreign_and_never_touched(tmp_path):
    run = tmp_path / "linear/ppo/0"
    run.mkdir(parents=True)
    (run / "config.json").write_text(json.dumps({**SMALL.to_json(), "an_option_of_then": 1}))
    (run / "policy.safetensors").write_bytes(b"weights")
    (task,) = plan_runs([GOOD], tmp_path)
    assert task.state == "foreign"
    with pytest.raises(RunDirectoryError):
        train_or_resume(SMALL, run)
    assert (run / "policy.safetensors").read_bytes() == b"weights"


def test_a_run_that_was_interrupted_before_its_first_checkpoint_begins_anew(tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    (run / "config.json").write_text(json.dumps(SMALL.to_json()))
    assert resume(run).steps == SMALL.steps
    assert (run / "policy.safetensors").exists()


def test_policies_cannot_take_a_controllers_name(campaigned):
    scenario = ScenarioOptions(duration=0.5).build()
    row = find_entry(f"lqr={campaigned[0] / 'linear/ppo/0'}", scenario)
    with pytest.raises(ParameterError, match="NAME=PATH"):
        evaluate(scenario, [row], earthquakes=2)


def test_a_worker_whose_campaign_was_killed_ends(tmp_path):
    config = replace(SMALL, total_timesteps=100_000_000)
    code = (
        "import os, signal, sys\n"
        "from agents.execution.local_executor import LocalExecutor\n"
        "from agents.experiments.recipes import ExperimentConfig\n"
        "from agents.experiments.runner import Campaign, plan_runs\n"
        "from agents.run_directory import parse_json\n"
        "from agents.training.config import config_of\n"
        "from agents.training.checkpoint import checkpoints\n"
        "def cut(campaign):\n"
        "    if checkpoints(campaign.tasks[0].run):\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
        "if __name__ == '__main__':\n"
        "    config = config_of(parse_json(sys.argv[2]))\n"
        "    one = ExperimentConfig(evaluation_task='linear', config=config, minutes=1.0, seeds=1)\n"
        "    Campaign(plan_runs([one], sys.argv[1])).run(LocalExecutor(1), cut)\n"
    )
    script = tmp_path / "campaign.py"
    script.write_text(code)
    ended = subprocess.run(
        [sys.executable, str(script), str(tmp_path / "runs"), json.dumps(config.to_json())],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    # The pipes that it inherited close when it ends: subprocess.run returned, so that it has ended.
    assert ended.returncode == -signal.SIGKILL, ended.stderr
    run = tmp_path / "runs/linear/ppo/0"
    with locked_folder(run, wait=10.0):  # which the worker held
        assert checkpoints(run)


# What learns on the linear table, whose best controller needs no distillation.
FROM_NOTHING = set(get_args(get_type_hints(TrainConfig)["algorithm"])) - {"dagger"}


def test_recipes_are_sound():
    names = [experiment.name for experiment in EXPERIMENTS]
    assert len(set(names)) == len(names)
    tasks = {task.name: task for task in EVALUATION_TASKS}
    for experiment in EXPERIMENTS:
        scenario = experiment.config.scenario.build()
        tested = tasks[experiment.evaluation_task].options
        trained = experiment.config.scenario
        assert replace(trained, set=tested.set) == tested
        assert trained.set[: len(tested.set)] == tested.set  # what differs in training is named behind
        law = base_law(experiment.config.chosen.base_controller, scenario)
        size = law.observation_size if isinstance(law, EstimatedLaw) else len(law)
        assert size == scenario.observation.size
    for task in EVALUATION_TASKS:
        scenario = task.options.build()
        assert (task.trained_on or task.name) in {
            experiment.evaluation_task for experiment in EXPERIMENTS
        }
        for rival in task.baselines:
            assert find_entry(rival, scenario).name == rival
    assert {
        experiment.config.algorithm
        for experiment in EXPERIMENTS
        if experiment.evaluation_task == "linear"
    } == FROM_NOTHING


def test_seeds_stay_below_those_of_evaluation():
    assert GOOD.with_seed(9).seed == 9
    with pytest.raises(ParameterError, match="seed = 10"):
        GOOD.with_seed(10)


def test_the_plan_is_printed_with_minutes(tmp_path, capsys):
    words = [
        "run-experiments",
        "--dry-run",
        "--folder",
        str(tmp_path),
        "--experiments",
        "linear/*",
        "--seeds",
        "2",
    ]
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    linear = [each for each in EXPERIMENTS if each.evaluation_task == "linear"]
    assert [row["runs"] for row in found["plan"]] == [2] * len(linear)
    minutes = sum(row["minutes_left"] for row in found["plan"])
    assert found["minutes_left"] == pytest.approx(minutes / 2)
    assert list(tmp_path.iterdir()) == []
    assert main(words) == 0
    assert "linear/tqc" in capsys.readouterr().out


def test_only_names_recipes(tmp_path):
    assert len(plan_runs(EXPERIMENTS, tmp_path, ["linear/ppo"], 3)) == 3
    with pytest.raises(ScenarioError, match="did you mean 'linear/ppo'"):
        plan_runs(EXPERIMENTS, tmp_path, ["linear/pp"])
    assert {row["experiment"] for row in plan_rows(plan_runs(EXPERIMENTS, tmp_path, ["*/sac"]))} == {
        "linear/sac",
        "yielding/sac",
    }
