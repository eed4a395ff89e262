"""A controller of one's own by module:Class or file.py:Class, in every command that takes names."""

import json

import numpy as np
import pytest

from agents.__main__ import main
from agents.evaluation.comparison import compare
from agents.evaluation.entries import find_entry
from agents.evaluation.protocol import evaluate
from agents.experiments.controller_tuning import tune
from agents.policies.own_controller import is_own_controller, own_baseline
from agents.policies.registry import get_controller
from shake_env import make_scenario
from shake_env.errors import ScenarioError

SHORT = make_scenario("linear", {"duration": 0.4})
TEXT = '''
from dataclasses import dataclass
import numpy as np

@dataclass
class Settings:
    gain: float

class Scaled:
    """LQR times a share."""

    tunable = {"share": (0.2, 2.0, 0.5)}

    def __init__(self, scenario, share):
        from baselines.lqr.sampled import lqr
        self.inner, self.settings = lqr(scenario), Settings(share)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = self.inner.predict(observation, state, episode_start, deterministic)
        return (self.settings.gain * action).astype(np.float32), state

def still(scenario):
    from shake_env import NoControl
    return NoControl()

class Flat(Scaled):
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros(1), None

class Lost(Scaled):
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full((*observation.shape[:-1], 1), np.nan), None

class Failing:
    def __init__(self, scenario):
        raise KeyError("gain")

class Mute:
    def __init__(self, scenario):
        pass

class Crooked(Scaled):
    tunable = {"share": (2.0, 1.0, 0.5)}

number = 3
'''


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(TEXT)
    return path


def test_what_names_one():
    for name in ("controllers:Mine", "package.module:make", "folder/file.py:Mine", "C:\\x.py:Mine"):
        assert is_own_controller(name), name
    for name in ("lqr", "runs/mine", "policy.safetensors", ":Mine", "module:", "module:not a name"):
        assert not is_own_controller(name), name


def test_a_file_that_is_called_so_is_a_policy(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a:b").write_text("")
    assert not is_own_controller("a:b")


def test_by_file_and_by_module_it_is_the_same(file, monkeypatch):
    monkeypatch.chdir(file.parent)
    observation = np.full((2, SHORT.observation.size), 0.1, dtype=np.float32)
    actions = [
        get_controller(name, SHORT).predict(observation)[0]
        for name in (f"{file}:Scaled", "mine.py:Scaled", "mine:Scaled")
    ]
    half = 0.5 * get_controller("lqr", SHORT).predict(observation)[0]
    for action in actions:
        np.testing.assert_allclose(action, half, rtol=1e-6)


def test_a_changed_file_is_read_again(file):
    name = f"{file}:Scaled"
    assert own_baseline(name).tunable["share"].default == 0.5
    file.write_text(TEXT.replace("(0.2, 2.0, 0.5)", "(0.2, 2.0, 0.7)"))
    assert own_baseline(name).tunable["share"].default == 0.7


@pytest.mark.parametrize(
    ("name", "match"),
    [
        ("absent", "has no absent"),
        ("number", "must be a class or a function"),
        ("Flat", r"an observation \(12,\)|an observation \(2"),
        ("Lost", "finite"),
        ("Failing", r"making it raises KeyError at .*mine.py:\d+"),
        ("Mute", "a method predict"),
        ("Crooked", "low <= default <= high"),
    ],
)
def test_what_does_not_fit_is_told_by_name(file, name, match):
    with pytest.raises(ScenarioError, match=match):
        get_controller(f"{file}:{name}", SHORT)


def test_a_module_that_cannot_be_had_is_told(file, tmp_path):
    (tmp_path / "broken.py").write_text("import numpy\n\n1 / 0\n")
    with pytest.raises(ScenarioError, match=r"ZeroDivisionError at .*broken.py:3"):
        get_controller(f"{tmp_path / 'broken.py'}:X", SHORT)
    with pytest.raises(ScenarioError, match="there is no file"):
        get_controller(f"{tmp_path / 'absent.py'}:X", SHORT)
    with pytest.raises(ScenarioError, match="ModuleNotFoundError"):
        get_controller("no_such_module:X", SHORT)


def test_compare_and_evaluate_run_it(file):
    name = f"{file}:Scaled"
    found = compare(SHORT, [name, f"{file}:still", "none"], noise=2, records=False)
    costs = {each: [m.cost for m in rows] for each, rows in found.episodes.items()}
    assert costs[f"{file}:still"] == costs["none"] and costs[name] != costs["none"]
    assert found.values[name].source == "rule"
    result = evaluate(SHORT, [find_entry(name, SHORT)], earthquakes=2, repeats=False, resamples=10)
    assert name in [row["controller"] for row in result["rows"]]


def test_tune_searches_it_and_compare_takes_the_file(file, tmp_path, capsys):
    name, kept = f"{file}:Scaled", str(tmp_path / "tuned.json")
    found = tune(name, SHORT, tmp_path / "a.db", budget=80 * 6, earthquakes=1)
    assert found.trials == 6 and 0.2 <= found.parameters["share"] <= 2.0
    arguments = ["--duration", "0.4", "--json"]
    search = ["--budget", "240", "--earthquakes", "1", "--storage", str(tmp_path / "b.db")]
    assert main(["tune", name, *search, "--output", kept, *arguments]) == 0
    share = json.loads(capsys.readouterr().out)["parameters"]
    few = ["--num-noise-motions", "2", "--no-records", "--tuned", kept]
    assert main(["compare", "--controllers", name, *few, *arguments]) == 0
    assert json.loads(capsys.readouterr().out)["values"][name]["parameters"] == share


def test_a_search_of_other_code_begins_anew(file, tmp_path):
    name, storage = f"{file}:Scaled", tmp_path / "t.db"
    assert tune(name, SHORT, storage, budget=160, earthquakes=1).trials == 2
    file.write_text(TEXT.replace("self.settings.gain * action", "-self.settings.gain * action"))
    told = []
    tune(name, SHORT, storage, budget=160, earthquakes=1, on_trial=lambda *a: told.append(a[0]))
    assert told == [1, 2]


def test_bench_and_robustness_run_it(file, tmp_path, monkeypatch, capsys):
    name = f"{file}:Scaled"
    monkeypatch.setattr("agents.evaluation.benchmark.make_scenario", lambda scenario: SHORT)
    arguments = [
        "benchmark",
        "--scenarios",
        "linear",
        "--earthquakes",
        "2",
        "--controllers",
        name,
        "none",
    ]
    assert main([*arguments, "--results", str(tmp_path / "bench"), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["linear"]["rows"]
    assert {row["controller"] for row in rows} == {"lqr", name, "none"}
    arguments = ["robustness", "--duration", "0.4", "--controllers", name, "--perturb", "mass_ratio"]
    assert main([*arguments, "--no-maps", "--earthquakes", "1", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert name in result["points"][0]["cost"] and result["values"][name]["source"] == "rule"
