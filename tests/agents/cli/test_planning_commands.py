"""`shake bound` and `shake plan`."""

import json

import numpy as np
import pytest

pytest.importorskip("numba")

from agents.__main__ import main
from agents.evaluation.bound import causal_bound
from baselines.lqr.sampled import sampled_lqr
from baselines.planning.planned import RecordPlan
from shake_env import make_scenario
from shake_env.records import RECORD_NAMES


def test_bound_prints_costs_of_every_seed(capsys):
    words = "bound --scenario yielding --duration 2 --seeds 4000000 4000003 --json --quiet"
    assert main(words.split()) == 0
    result = json.loads(capsys.readouterr().out)
    costs, reference = np.array(result["costs"]), np.array(result["reference_costs"])
    assert costs.shape == reference.shape == (3,)
    assert (costs > 0.0).all() and (costs < reference).all()
    assert max(result["disagreements"]) < 0.01
    assert result["causal_bound"]["cost"] is None


def test_bound_draws_what_the_optimum_does(tmp_path, capsys):
    words = f"bound --scenario linear --duration 1 --seeds 0 1 --output {tmp_path / 'bound'}"
    assert main(words.split()) == 0
    shown = capsys.readouterr().out
    assert "starts differ" in shown and "by analysis" in shown
    assert (tmp_path / "bound" / "optimum.png").stat().st_size > 10_000


def test_seeds_in_disorder_are_refused(capsys):
    assert main(["bound", "--seeds", "5", "5", "--json"]) != 0
    assert "seeds" in capsys.readouterr().err


def test_the_causal_bound_of_the_linear_table_is_lqr():
    scenario = make_scenario("linear")
    known = causal_bound(scenario)
    design = sampled_lqr(scenario.discrete, scenario.stage_cost)
    assert known["exact"] and known["cost"] == pytest.approx(design.analytic_cost)


@pytest.mark.slow
def test_a_record_is_planned_and_written(tmp_path, capsys):
    words = f"plan {RECORD_NAMES[0]} --output {tmp_path / 'plan'} --json"
    assert main(words.split()) == 0
    (described,) = json.loads(capsys.readouterr().out)["plans"]
    plan = RecordPlan.read(tmp_path / "plan" / f"{RECORD_NAMES[0]}.npz")
    assert plan.cost == described["cost"] and described["base_shear_rms_error"] < 0.05
    assert (tmp_path / "plan" / f"{RECORD_NAMES[0]}.png").is_file()
