"""A search of training configurations by workers: the trials of one process, lost by no kill."""

import json
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from small_experiment import TINY, essence, led_study, short_validation

from agents.__main__ import main
from agents.execution.local_executor import LocalExecutor
from agents.execution.options import ExecutionOptions
from agents.experiments import catalogue
from agents.experiments.search import open_search, search_training
from agents.experiments.search_objective import ValidationSet
from agents.experiments.search_space import Search, trial_config
from agents.experiments.search_work import carry_out, stop_sign
from agents.policies.policy_file import load_policy
from agents.run_directory import OWNER, POLICY, RESULT

SEARCH = Search(experiment=TINY, share=0.5, earthquakes=2)
TRIALS = 4  # fewer than the pruner waits for, and than the sampler draws at random


@pytest.fixture(scope="module", autouse=True)
def _short_validation():
    with short_validation():
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The search by this process, and the folder of its runs."""
    folder = tmp_path_factory.mktemp("whole")
    return search_training(SEARCH, folder / "r.db", folder, trials=TRIALS), folder / SEARCH.name


def search_by(processes, folder, engine="local", storage=None, **options):
    if engine != "local":
        pytest.importorskip(engine, reason=f"{engine} is not installed: it is an extra")
    slurm = ("timeout_min=10",) if engine == "submitit" else ()
    execution = ExecutionOptions(
        executor=engine, processes=processes, units=folder / "units", slurm=slurm, worker_memory=2.0
    )
    return search_training(
        SEARCH, storage or folder / "r.db", folder, open_workers=execution.open_workers, **options
    )


def same_policies(trace, home, whole):
    """Whether the policies of trials are those of the whole search, bit for bit."""
    runs = [home / str(row.number) for row in trace.trials]
    for run, row in zip(runs, whole[0].trials, strict=True):
        one, two = load_policy(run / POLICY), load_policy(whole[1] / str(row.number) / POLICY)
        for a, b in zip((*one.weights, *one.biases), (*two.weights, *two.biases), strict=True):
            np.testing.assert_array_equal(a, b)
        assert one.card["command"] == two.card["command"] and one.card["curve"] == two.card["curve"]
    return True


@pytest.mark.slow
@pytest.mark.parametrize(
    ("engine", "processes"),
    [
        ("local", 1),
        ("local", 2),
        ("ray", 2),
        ("submitit", 2),
    ],
)
def test_workers_make_the_trials_of_one_process(whole, tmp_path, engine, processes):
    seen = []
    trace = search_by(processes, tmp_path, engine, trials=TRIALS, on_update=seen.append)
    assert essence(trace) == essence(whole[0])
    assert same_policies(trace, tmp_path / SEARCH.name, whole)
    assert {row.number for row in trace.trials} == set(range(TRIALS))
    assert all(row.seconds > 0.0 for row in trace.trials)
    assert sorted(now.done for now in seen if now.progress is None) == list(range(1, TRIALS + 1))
    if processes == 2:  # two were at work at once
        study = open_search(SEARCH, tmp_path / "r.db")
        one, two = study.get_trials()[:2]
        assert two.datetime_start < one.datetime_complete
    # What is done is not done again, and needs no worker.
    again = search_training(
        SEARCH, tmp_path / "r.db", tmp_path, trials=TRIALS, open_workers=lambda: pytest.fail("opened")
    )
    assert again == trace


@pytest.mark.slow
def test_a_search_by_workers_that_was_interrupted_goes_on_in_this_process(whole, tmp_path):
    running = set()

    def cut(now):
        if now.progress is not None:
            running.add(now.trial)
        if now.done >= 1 and running:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        search_by(2, tmp_path, trials=TRIALS, on_update=cut)
    states = [t.state.name for t in open_search(SEARCH, tmp_path / "r.db").get_trials()]
    assert states.count("COMPLETE") >= 1 and "RUNNING" in states
    trace = search_training(SEARCH, tmp_path / "r.db", tmp_path, trials=TRIALS)
    key = partial(json.dumps, sort_keys=True)
    assert sorted(map(key, essence(trace))) == sorted(map(key, essence(whole[0])))
    states = [t.state.name for t in open_search(SEARCH, tmp_path / "r.db").get_trials()]
    assert states.count("COMPLETE") == TRIALS and set(states) == {"COMPLETE", "FAIL"}


@pytest.mark.slow
def test_a_killed_workers_trial_is_tried_again(whole, tmp_path):
    home, killed = tmp_path / SEARCH.name, []

    def kill(now):
        owner = home / str(now.trial) / OWNER
        if now.progress is not None and not killed and owner.exists():
            pid = json.loads(owner.read_text())["pid"]
            if pid != os.getpid():
                os.kill(pid, signal.SIGKILL)
                killed.append(now.trial)

    trace = search_by(2, tmp_path, trials=TRIALS, on_update=kill)
    assert killed and essence(trace) == essence(whole[0])
    assert same_policies(trace, home, whole)


@pytest.mark.slow
def test_a_trial_of_a_worker_behind_the_others_is_ended(tmp_path):
    search, study = led_study(SEARCH, tmp_path / "r.db")
    trace = search_training(
        search, tmp_path / "r.db", tmp_path, trials=6, open_workers=lambda: LocalExecutor(1)
    )
    last = study.get_trials()[-1]
    assert last.state.name == "PRUNED" and trace.trials[-1].state == "pruned"
    assert last.user_attrs["ratio"] == min(last.intermediate_values.values()) > 1e-3
    run = tmp_path / search.name / str(last.number)
    assert not stop_sign(run).exists() and not (run / "checkpoints").exists()


def test_a_worker_that_is_told_to_stop_stops(whole, tmp_path):
    """The sign alone ends a run; here it is there before the training."""
    run = tmp_path / "run"
    stop_sign(run).parent.mkdir(exist_ok=True)
    stop_sign(run).write_bytes(b"")
    validation = ValidationSet(TINY, 2)
    values = trial_config(TINY, {}, 1.0).to_json()
    found = carry_out(str(run), values, "x", validation, True)
    assert found["outcome"] is None and not (run / RESULT).exists()


@pytest.mark.slow
def test_time_ends_what_workers_do_and_their_trials_stay(tmp_path):
    trace = search_by(2, tmp_path, trials=TRIALS, minutes=1.0 / 60.0)
    assert len(trace.trials) < TRIALS
    states = [t.state.name for t in open_search(SEARCH, tmp_path / "r.db").get_trials()]
    assert states.count("RUNNING") >= 1


@pytest.mark.slow
def test_workers_of_a_shared_study(whole, tmp_path):
    trace = search_by(2, tmp_path, trials=TRIALS, storage=f"journal:{tmp_path / 'study.journal'}")
    assert len(trace.trials) == TRIALS and trace.trials[0].values == whole[0].trials[0].values
    assert {row.state for row in trace.trials} == {"complete"}
    assert len({json.dumps(row.values) for row in trace.trials}) == TRIALS
    assert (tmp_path / SEARCH.name / "worker-0" / "0" / RESULT).exists()


COMMAND = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from small_experiment import TINY, short_validation
from agents.execution.options import ExecutionOptions
from agents.experiments import signs_of_life
from agents.experiments.search import search_training
from agents.experiments.search_space import Search
signs_of_life.HEARTBEAT, signs_of_life.GRACE = 1, 5
folder, trials = Path(sys.argv[2]), int(sys.argv[3])
if __name__ == "__main__":
    execution = ExecutionOptions(processes=2, units=folder / "units")
    with short_validation():
        search_training(
            Search(experiment=TINY, share=0.5, earthquakes=2), f"journal:{folder}/study.journal",
            folder, trials=trials, open_workers=execution.open_workers,
        )
"""


@pytest.mark.slow
def test_two_commands_with_two_workers_each_share_a_search_and_one_is_killed(tmp_path):
    (tmp_path / "command.py").write_text(COMMAND)
    helpers, total = str(Path(__file__).parents[2] / "helpers"), 8
    words = [sys.executable, str(tmp_path / "command.py"), helpers, str(tmp_path), str(total)]
    first, second = (subprocess.Popen(words, stderr=subprocess.PIPE, text=True) for _ in range(2))
    home, storage = tmp_path / SEARCH.name, f"journal:{tmp_path / 'study.journal'}"

    def slots():
        return {file.parent.parent.name for file in home.glob("worker-*/*/config.json")}

    end = time.monotonic() + 240.0
    while len(slots()) < 2 and time.monotonic() < end:  # both train
        time.sleep(0.1)
    first.kill()
    first.communicate()
    _, said = second.communicate(timeout=900)
    assert second.returncode == 0, said
    trials = open_search(SEARCH, storage).get_trials()
    lost = [trial.params for trial in trials if trial.state.name == "FAIL"]
    done = [trial.params for trial in trials if trial.state.name in ("COMPLETE", "PRUNED")]
    assert total <= len(done) <= total + 1 and len(done) + len(lost) == len(trials)
    assert 1 <= len(lost) <= 2  # of the killed command's
    assert all(done.count(params) == 1 for params in lost)
    assert len({json.dumps(params, sort_keys=True) for params in done}) == len(done)


def test_the_command_takes_an_executor(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(catalogue, "EXPERIMENTS", (TINY,))
    words = ["tune-training", "linear/ppo", "--step-fraction", "0.5", "--earthquakes", "2", "--json"]
    words += ["--storage", str(tmp_path / "r.db"), "--folder", str(tmp_path / "runs")]
    words += ["--processes", "2", "--units", str(tmp_path / "units")]
    assert main([*words, "--trials", "1"]) == 0
    assert len(json.loads(capsys.readouterr().out)["trials"]) == 1
    try:
        code = main([*words, "--trials", "1", "--ray-address", "auto"])
    except SystemExit as end:  # tyro before 1.0 prints the error itself
        code = end.code
    assert code == 2
    assert "goes with --executor ray" in "".join(capsys.readouterr())
