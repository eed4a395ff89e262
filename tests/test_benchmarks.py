"""What the benchmarks say of their numbers; the numbers themselves are a machine's."""

import inspect
import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from agents.policies.policy_file import load_policy
from agents.policies.registry import shipped_policy

pytest.importorskip("torch")

ROOT = Path(__file__).parents[1]


@pytest.fixture(autouse=True)
def checkout(monkeypatch):
    """Benchmarks are run from a checkout, and not installed."""
    monkeypatch.syspath_prepend(str(ROOT))


def test_the_exponent_is_a_power_laws_over_the_largest_sizes():
    from benchmarks.scaling import exponent

    costs = {str(n): 3.0 * n**1.5 for n in (4, 8, 16, 32)}
    assert exponent(costs, 4) == pytest.approx(1.5, abs=1e-12)
    assert exponent({"1": 100.0, **costs}, 3) == pytest.approx(1.5, abs=1e-12)


@pytest.mark.parametrize("at_least", [True, False])
def test_a_goal_is_met_on_its_side_of_the_bound_and_on_it(at_least):
    from benchmarks.goals import Goal

    verdicts = [
        Goal(what="x", bound=2.0, value=found, at_least=at_least).met for found in (1.9, 2.0, 2.1)
    ]
    assert verdicts == ([False, True, True] if at_least else [True, True, False])


@pytest.mark.parametrize(
    ("value", "text"),
    [(1_512_345.0, "1 512 345"), (12.34, "12.3"), (0.034, "0.034"), (3e-13, "3.0e-13")],
)
def test_numbers_are_short(value, text):
    from benchmarks.goals import number

    assert number(value) == text


def test_the_page_has_a_place_for_every_table(tmp_path):
    from agents.reporting.markdown_blocks import put_block
    from benchmarks.__main__ import groups

    copy = tmp_path / "page.md"
    copy.write_text((ROOT / "docs" / "performance.md").read_text(encoding="utf-8"), encoding="utf-8")
    names = ["goals", *groups(quick=True)]
    for _ in range(2):  # again: what was put is replaced
        for name in names:
            put_block(copy, name, f"of {name} here")
    text = copy.read_text(encoding="utf-8")
    assert [text.count(f"of {name} here") for name in names] == [1] * len(names)


def test_a_missed_goal_says_why_and_a_met_one_does_not():
    from benchmarks.page import tables

    rates = {"CartPole-v1": 100.0, "linear, n_m = 5": 290.0, "laboratory": 210.0}
    rates |= {"linear, n_m = 2": 300.0, "linear, n_m = 10": 280.0}
    lines = tables({"single": rates})["goals"]
    assert [line.count("**no**") for line in lines if line.startswith("| one ")] == [1, 0]
    first = next(i for i, line in enumerate(lines) if line.startswith("Missed"))
    told = " ".join(lines[first:])
    assert "CartPole-v1" in told and "laboratory" not in told


def test_peers_that_cannot_be_installed_are_said_to_be_missing(monkeypatch, tmp_path):
    from benchmarks import peers
    from benchmarks.page import tables

    def refused(folder):
        raise subprocess.CalledProcessError(1, ["pip"], stderr="ERROR: one\nERROR: no such package\n")

    monkeypatch.setattr(peers, "environment", refused)
    found = peers.peers(0.0, 1, tmp_path)
    made = tables({"peers": found})
    (line,) = made["peers"]
    assert "gymnax" in line and "no such package" in line
    assert len(made["goals"]) == 2  # a head without rows


def test_an_sb3_model_of_a_shipped_policys_weights_acts_as_its_file():
    from benchmarks.decision import SHIPPED, largest_difference, sb3_model

    for name in SHIPPED.values():
        policy = load_policy(shipped_policy(*name))
        model, env = sb3_model(policy)
        # Single precision: 1e-7 of sums of some tens of terms of order 1.
        assert largest_difference(policy, model, env) < 1e-6
        assert np.abs(model.predict(env.reset(), deterministic=True)[0]).max() < 1.0


def test_the_sb3_guides_settings_exist_and_its_results_are_of_them():
    from benchmarks.sb3_guide import VARIANTS, train

    known = {*inspect.signature(train).parameters}
    assert all(known >= {*options} for options in VARIANTS.values())
    runs = json.loads((ROOT / "docs" / "results" / "sb3_guide.json").read_text(encoding="utf-8"))
    assert {run["variant"] for run in runs} <= {*VARIANTS}
    assert len({(run["variant"], run["seed"]) for run in runs}) == len(runs)
