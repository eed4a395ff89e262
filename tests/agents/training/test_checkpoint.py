"""Checkpoints hold numbers alone and run no code; a run that was cut loses nothing of anybody."""

import json
import pickle
import re
import shutil
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.numpy import save_file

from agents.__main__ import main
from agents.evaluation.entries import find_entry
from agents.experiments.recipes import ExperimentConfig
from agents.experiments.runner import Task
from agents.policies.registry import get_controller
from agents.run_directory import append_row, evaluations_of_run, locked_folder
from agents.scenario_options import ScenarioOptions
from agents.training.algorithm_options import PPOOptions
from agents.training.checkpoint import checkpoints, load_checkpoint
from agents.training.config import TrainConfig
from agents.training.plain_state import generator_state, join_state, restore_generator, split_state
from agents.training.run import is_finished, resume, train, train_or_resume, training_tables
from shake_env.errors import PolicyFileError, RunDirectoryError, ShakeError
from shake_env.scenario.overrides import make_scenario

CONFIG = TrainConfig(
    scenario=ScenarioOptions(set=("objective.force_weight=1.5",)),
    ppo=PPOOptions(n_envs=2, n_steps=32, batch_size=64, n_epochs=1),
    net_arch=(8,),
    episode_duration=0.2,
    total_timesteps=192,
    evaluations=3,
    evaluation_earthquakes=1,
    checkpoint_interval=1e-9,
)


def cut_at(steps):
    def report(progress):
        if progress.steps >= steps:
            raise KeyboardInterrupt

    return report


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A run that is done, and one that was cut."""
    folder = tmp_path_factory.mktemp("runs")
    train(CONFIG, folder / "whole")
    with pytest.raises(KeyboardInterrupt):
        train(CONFIG, folder / "cut", report=cut_at(64))
    return folder


@pytest.fixture
def cut(trained, tmp_path):
    shutil.copytree(trained / "cut", tmp_path / "cut")
    return tmp_path / "cut"


class Trap:
    """Writes a file when it is unpickled."""

    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return open, (self.path, "w")


def test_no_file_of_a_run_is_unpickled(cut, tmp_path):
    sprung = tmp_path / "sprung"
    trap = pickle.dumps(Trap(sprung))
    for file in checkpoints(cut):
        file.write_bytes(trap)
    with pytest.raises(RunDirectoryError, match="no readable checkpoint"):
        resume(cut)
    for file in checkpoints(cut):
        torch.save({"state": Trap(sprung)}, file)
    with pytest.raises(RunDirectoryError, match="no readable checkpoint"):
        resume(cut)
    # As an earlier version wrote them.
    shutil.rmtree(cut / "checkpoints")
    earlier = cut / "checkpoints" / "step-000000000064"
    earlier.mkdir(parents=True)
    for name in ("state.pt", "model.zip"):
        torch.save(Trap(sprung), earlier / name)
    for again in (lambda: resume(cut), lambda: train_or_resume(CONFIG, cut), lambda: train(CONFIG, cut)):
        with pytest.raises(RunDirectoryError, match=r"hold pickles, which run code.*new directory"):
            again()
    assert not sprung.exists()
    assert (earlier / "state.pt").exists()
    pickle.loads(trap).close()
    assert sprung.exists()  # what any of it would have done


def test_no_other_file_of_a_run_is_unpickled_either(trained, tmp_path):
    sprung, run = tmp_path / "sprung", tmp_path / "run"
    for name in ("config.json", "evaluations.jsonl", "best.safetensors"):
        shutil.copytree(trained / "cut", run)
        (run / name).write_bytes(pickle.dumps(Trap(sprung)))
        with suppress(ShakeError):  # a single line of rows counts as half a one, and is dropped
            resume(run)
        shutil.rmtree(run)
    assert not sprung.exists()


def test_no_module_reads_pickles(request):
    """numba's own cache, in its own folder, is the one place where a pickle is read.

    And what travels between a command and its own workers: no file of a user's is read so.
    """
    travels = {"worker.py", "controller_set.py"}
    banned = re.compile(
        r"\b(pickle|cloudpickle|dill|joblib|shelve|marshal)\b|torch\.load\(|allow_pickle(?!=False)|load_from_zip|"
        r"\b(PPO|SAC|TD3|TQC|RecurrentPPO|AnalyticPolicyGradient|kind|cls)\.load\(|"
        r"np\.load\((?!(\w+|io\.BytesIO\([\w.]+\)), allow_pickle=False\))"
    )
    for package in ("agents", "baselines", "shake_env"):
        for file in (request.config.rootpath / package).rglob("*.py"):
            code = re.sub(r'"""(?s:.*?)"""|#.*|"[^"\n]*"', "", file.read_text(encoding="utf-8"))
            if file.name in travels:
                code = code.replace("cloudpickle", "")
            assert not banned.search(code), f"{file.name}: {banned.search(code)[0]}"
    assert banned.search("np.load(file)") and banned.search("np.load(file, allow_pickle=True)")


def altered(file, change):
    """Write a checkpoint again with a change of its JSON or arrays."""
    with safe_open(str(file), framework="np") as opened:
        header = json.loads(opened.metadata()["shake"])
        arrays = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118
    change(header["state"], arrays)
    save_file(arrays, file, {"shake": json.dumps(header)})


@pytest.mark.parametrize(
    "change",
    [
        lambda state, arrays: state.pop("tables"),
        lambda state, arrays: state["counters"].update(num_timesteps=-1),
        lambda state, arrays: state["counters"].update(num_timesteps="64"),
        lambda state, arrays: arrays.update({n: a - 99 for n, a in arrays.items() if "period" in n}),
        lambda state, arrays: state["tables"].update(motion=[7, 7]),
        lambda state, arrays: state["tables"]["stream"].pop(),
        lambda state, arrays: state["tables"]["stream"][0].update(bits="MT19937"),
        lambda state, arrays: state["generators"]["numpy"].update(pos=-5),
        lambda state, arrays: state.update(action_space=None),
        lambda state, arrays: arrays.update(
            {"state.tables.returns": np.zeros(3)} if "state.tables.returns" in arrays else {}
        ),
        lambda state, arrays: arrays.update({n: a[..., :-1] for n, a in arrays.items() if a.ndim == 2}),
        lambda state, arrays: state.update(last_observation=[[0.0]]),
        lambda state, arrays: state["optimisers"]["policy.optimizer"].update(moments={"999": {}}),
        lambda state, arrays: state["optimisers"]["policy.optimizer"].update(rates=[]),
    ],
)
def test_what_does_not_fit_is_refused_before_it_is_used(cut, change):
    for file in checkpoints(cut):
        altered(file, change)
    with pytest.raises(RunDirectoryError, match="no readable checkpoint"):
        resume(cut)


def test_a_checkpoint_of_other_tables_is_refused(cut):
    other = replace(CONFIG, ppo=replace(CONFIG.ppo, n_envs=4, n_steps=16))
    with pytest.raises(RunDirectoryError, match="no readable checkpoint"):
        load_checkpoint(cut, other, training_tables(other, other.scenario.build()))


def test_a_generator_goes_on_and_its_children_too():
    one = np.random.default_rng([3, 1])
    one.spawn(2)
    one.standard_normal(5)
    one.integers(0, 5, dtype=np.uint32)
    state = json.loads(json.dumps(split_state(generator_state(one))[0]))
    two = restore_generator(join_state(state, {}))
    assert np.array_equal(one.standard_normal(4), two.standard_normal(4))
    assert np.array_equal(one.integers(0, 9, 7, np.uint32), two.integers(0, 9, 7, np.uint32))
    assert np.array_equal(one.spawn(1)[0].random(3), two.spawn(1)[0].random(3))


def test_only_plain_values_are_written():
    with pytest.raises(TypeError, match=r"state\.a\.0 is a object"):
        split_state({"a": [object()]})
    values = {"a": np.float32(0.5), "b": (1, [True, None]), "c": np.zeros(()), "d": torch.ones(2)}
    plain, arrays = split_state(values)
    back = join_state(json.loads(json.dumps(plain)), arrays)
    assert (back["a"], back["b"], back["c"].shape) == (0.5, [1, [True, None]], ())


# Run directories


def test_nothing_that_a_person_put_there_is_deleted(cut):
    shutil.rmtree(cut / "checkpoints")
    (cut / "notes.txt").write_text("mine")
    (cut / "data").mkdir()
    (cut / "data" / "raw.csv").write_text("1")
    assert resume(cut).steps == 192
    assert (cut / "notes.txt").read_text() == "mine" and (cut / "data" / "raw.csv").exists()
    assert is_finished(cut)


def test_a_run_that_was_killed_as_it_began_begins_or_goes_on(trained, tmp_path):
    short = replace(CONFIG, total_timesteps=64)
    (tmp_path / "a").mkdir()  # killed just after mkdir
    train(short, tmp_path / "a")
    for again in (lambda run: train(short, run), resume, lambda run: train_or_resume(short, run)):
        run = tmp_path / "b"
        run.mkdir()
        shutil.copy(tmp_path / "a" / "config.json", run)
        append_row(run / "evaluations.jsonl", {"steps": 64, "cost_ratio": 1e-9})  # and no checkpoint
        again(run)
        assert evaluations_of_run(run) == evaluations_of_run(tmp_path / "a") and is_finished(run)
        shutil.rmtree(run)
    (tmp_path / "c").mkdir()
    words = [
        "train",
        "--run-dir",
        str(tmp_path / "c"),
        "--resume",
        "--json",
        "--config.total-timesteps",
        "64",
    ]
    words += ["--config.ppo.n-envs", "2", "--config.ppo.n-steps", "32", "--config.ppo.batch-size"]
    words += ["64", "--config.evaluation-earthquakes", "1", "--config.episode-duration", "0.2"]
    assert main(words) == 0
    assert is_finished(tmp_path / "c")


def test_a_result_counts_only_when_it_is_complete(trained, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(trained / "whole", run)
    text = (run / "result.json").read_text()
    task = Task(ExperimentConfig(evaluation_task="linear", config=CONFIG, minutes=0.1), CONFIG, run)
    task.look()
    assert task.state == "done"
    for half in (text[: len(text) // 2], "{}", text.replace('"steps": 192', '"steps": "192"'), ""):
        (run / "result.json").write_text(half)
        assert not is_finished(run)
        task.state = "waiting"
        task.look()
        assert task.state == "begun"
    train_or_resume(CONFIG, run)
    assert is_finished(run)
    assert json.loads((run / "result.json").read_text())["cost"] == json.loads(text)["cost"]


def test_a_second_process_is_refused(cut):
    before = evaluations_of_run(cut)
    with locked_folder(cut):
        for again in (lambda: resume(cut), lambda: train_or_resume(CONFIG, cut)):
            with pytest.raises(RunDirectoryError, match="in use by process"):
                again()
    assert evaluations_of_run(cut) == before


def test_half_an_evaluation_changes_no_result(cut, trained):
    file = cut / "evaluations.jsonl"
    file.write_bytes(file.read_bytes()[:-9])
    resume(cut)
    results = [json.loads((run / "result.json").read_text()) for run in (cut, trained / "whole")]
    assert results[0]["cost"] == results[1]["cost"]
    assert results[0]["best_steps"] == results[1]["best_steps"]
    assert dict(evaluations_of_run(cut)) == dict(evaluations_of_run(trained / "whole"))


def test_options_that_differ_from_the_runs_own_are_refused_by_name(cut, capsys):
    words = ["train", "--run-dir", str(cut), "--resume", "--json"]
    for given, reason in (
        (["--config.seed", "4"], "seed is 0, given 4"),
        (["--config.total-timesteps", "4000000"], "total_timesteps is 192, given 4000000"),
        (["--config.ppo.n-envs", "64"], "ppo.n_envs is 2, given 64"),  # the default, but given
        (["--config.scenario.set", "objective.force_weight=2"], "scenario.set"),
    ):
        assert main([*words, *given]) == 2
        assert reason in capsys.readouterr().err
    same = ["--config.seed", "0", "--config.scenario.set", "objective.force_weight=1.5"]
    assert main([*words, *same]) == 0
    assert json.loads(capsys.readouterr().out)["steps"] == 192
    with pytest.raises(RunDirectoryError, match="seed is 0, given 5"):
        train_or_resume(replace(CONFIG, seed=5), cut)


def test_an_unfinished_runs_best_policy_can_be_compared(cut):
    scenario = CONFIG.scenario.build()
    policy = get_controller(str(cut), scenario)
    assert policy.card["config"]["seed"] == 0
    assert find_entry(str(cut), scenario).sources[0]["algorithm"] == "ppo"
    with pytest.raises(PolicyFileError, match="control rate"):
        get_controller(str(cut), make_scenario("linear", {"control_rate": 500.0}))
    (cut / "best.safetensors").unlink()
    with pytest.raises(PolicyFileError, match=r"holds no policy\.safetensors or best\.safetensors"):
        find_entry(str(cut), scenario)
