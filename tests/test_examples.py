"""Every example runs, shortened by the option that it documents, and prints what it is about."""

import importlib.metadata
import re
import runpy
import sys
import warnings
from pathlib import Path

import gymnasium
import nbformat
import pytest
import torch
import yaml
from nbclient import NotebookClient
from packaging.version import Version

EXAMPLES = Path(__file__).parents[1] / "examples"
SHORT = {
    "lqr_against_ppo.py": ["--steps", "8192"],
    "custom_specimen.py": ["--earthquakes", "2"],
    "peer_record.py": ["--seconds", "10"],
    "sb3_evaluate_policy.py": ["--steps", "512", "--duration", "1"],
    "sb3_ppo.py": ["--steps", "8192"],
    "cleanrl_ppo.py": ["--steps", "2048", "--tables", "8"],
}


def run(name, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [name, *SHORT[name]])
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    return capsys.readouterr().out


def number(pattern, text):
    return float(re.search(pattern, text)[1])


def test_every_example_is_tested_and_says_how_it_is_shortened():
    assert {path.name for path in EXAMPLES.glob("*.py")} == set(SHORT)
    for name, options in SHORT.items():
        text = (EXAMPLES / name).read_text(encoding="utf-8")
        assert f"python examples/{name} {options[0]}" in text


def test_lqr_against_ppo(monkeypatch, capsys):
    out = run("lqr_against_ppo.py", monkeypatch, capsys)
    theory = number(r"analytic cost of LQR: ([\d.]+)", out)
    measured = number(r"LQR +mean stage cost +([\d.]+)", out)
    # 16 earthquakes of 20 s scatter by 2 % about the expectation (their standard error).
    assert measured == pytest.approx(theory, rel=0.06)
    assert number(r"PPO +mean stage cost +([\d.]+)", out) > measured  # nothing beats it
    assert len((EXAMPLES / "lqr_against_ppo.py").read_text().splitlines()) <= 40


def test_custom_specimen(monkeypatch, capsys):
    out = run("custom_specimen.py", monkeypatch, capsys)
    knows = number(r"knows the specimen +cost ([\d.]+)", out)
    assert knows < number(r"guesses equal storeys +cost ([\d.]+)", out)


def test_peer_record(monkeypatch, capsys):
    out = run("peer_record.py", monkeypatch, capsys)
    assert "NAPA2014_68150_HNE: 10.0 s" in out
    assert number(r"lqg-dac +acceleration error +([\d.]+)", out) < 100.0


def test_sb3_evaluate_policy(monkeypatch, capsys):
    out = run("sb3_evaluate_policy.py", monkeypatch, capsys)
    costs = [float(c) for c in re.findall(r"mean stage cost +([\d.]+)", out)]
    assert len(costs) == 4
    assert costs[0] < costs[1] < costs[3]  # LQR, the policy that ships, a table that stands still


def test_sb3_ppo(monkeypatch, capsys):
    threads = torch.get_num_threads()
    out = run("sb3_ppo.py", monkeypatch, capsys)
    torch.set_num_threads(threads)
    assert number(r"ratio ([\d.]+)", out) > 1.0  # no controller beats LQR here
    assert "8192 steps" in out


@pytest.mark.slow
def test_sb3_ppo_ends_near_lqr(monkeypatch, capsys):
    """Four minutes of one core; the table in the guide has three seeds."""
    monkeypatch.setitem(SHORT, "sb3_ppo.py", ["--steps", "4000000"])
    threads = torch.get_num_threads()
    out = run("sb3_ppo.py", monkeypatch, capsys)
    torch.set_num_threads(threads)
    assert 1.0 < number(r"ratio ([\d.]+)", out) < 1.2
    assert " 0 episodes ended by a limit" in out


def test_cleanrl_loop(monkeypatch, capsys):
    out = run("cleanrl_ppo.py", monkeypatch, capsys)
    assert "2048 steps" in out
    assert len((EXAMPLES / "cleanrl_ppo.py").read_text().splitlines()) < 150


def test_the_notebook_runs(monkeypatch):
    monkeypatch.setenv("SHAKE_NOTEBOOK_SECONDS", "2")
    monkeypatch.setenv("PYTHONPATH", str(EXAMPLES.parent))
    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    notebook = nbformat.read(EXAMPLES / "first_look.ipynb", as_version=4)
    assert all(not cell.get("outputs") for cell in notebook.cells)  # committed clean
    with warnings.catch_warnings():
        # Kernel clients leave sockets to the garbage collector, which says so.
        warnings.simplefilter("ignore", ResourceWarning)
        warnings.simplefilter("ignore", DeprecationWarning)
        NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
    texts = [
        output["text"]
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if "text" in output
    ]
    assert number(r"expected stage cost +([\d.]+)", "".join(texts)) == pytest.approx(0.2085, abs=1e-4)
    assert re.search(r"^1 : 1 +44\.1 % +7\.3 %$", "".join(texts), re.MULTILINE)


@pytest.mark.skipif(
    Version(importlib.metadata.version("rl_zoo3")) < Version("2.9"),
    reason="rl_zoo3 2.7 takes env_kwargs from the command line alone, not from the file",
)
def test_rl_zoo_trains_with_the_file(tmp_path, monkeypatch, capsys):
    options = [
        "--algo", "ppo", "--env", "ShakeTable-linear-v0", "--gym-packages", "shake_env",
        "--conf-file", str(EXAMPLES / "rl_zoo3" / "shake.yml"), "--log-folder", str(tmp_path),
        "--eval-freq", "-1", "-n", "256", "--device", "cpu",
        "-params", "n_envs:2", "n_steps:64", "batch_size:128", "n_epochs:1",
    ]  # fmt: skip
    monkeypatch.setattr(sys, "argv", ["rl_zoo3.train", *options])
    threads = torch.get_num_threads()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # rl-zoo3's own imports warn of what other packages lack
        runpy.run_module("rl_zoo3.train", run_name="__main__")
    torch.set_num_threads(threads)
    assert "Saving to" in capsys.readouterr().out
    assert list(tmp_path.glob("ppo/*/ShakeTable-linear-v0.zip"))


def test_the_zoo_file_names_environments_that_exist():
    for name, options in yaml.safe_load((EXAMPLES / "rl_zoo3" / "shake.yml").read_text()).items():
        env = gymnasium.make(f"shake_env:{name}", **options["env_kwargs"])
        assert env.unwrapped.scenario.control_rate == 200.0
        # exp(-1 / 50): the discount looks 0.25 s ahead, as the comment says.
        assert 0.005 / (1.0 - options["gamma"]) == pytest.approx(0.25)
