"""`shake bound` and `shake plan`."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

pytest.importorskip("numba")

from agents.__main__ import main
from agents.cli.planning.plan import Plan, check_durations
from agents.evaluation.bound import causal_bound, default_seeds
from agents.evaluation.bound_store import Bounds, EpisodeBound
from agents.motions.channels import MotionOptions
from baselines.lqr.sampled import sampled_lqr
from baselines.planning.bound import Start
from baselines.planning.planned import RecordPlan
from shake_env import make_scenario
from shake_env.errors import ParameterError, RecordError
from shake_env.motion.targets import FilteredNoise, MotionSet, RecordedMotion
from shake_env.records import RECORD_NAMES, read_motion
from shake_env.rollout import Earthquake

DATA = Path(__file__).parents[2] / "data"


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


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        ("--seeds 5 5", "the second above the first"),
        ("--seeds -3 5", "must be 0 or more"),
        ("--seeds 0 100000000000000000000000", "1e+23 earthquakes: ask for at most 10000"),
        ("--scenario records --seeds 5 8", "has 6 recorded motions, numbered from 0"),
        ("--scenario records --seeds 4000000 4000004", "has 6 recorded motions, numbered from 0"),
    ],
)
def test_seeds_that_are_no_earthquakes_are_refused(words, remedy, capsys):
    assert main(["bound", *words.split(), "--json"]) != 0
    error = capsys.readouterr().err
    assert "seeds" in error and remedy in " ".join(error.split())


def test_without_seeds_every_recorded_motion_is_meant():
    assert default_seeds(make_scenario("records"), 4) == (0, 6)
    assert default_seeds(make_scenario("linear"), 4) == (4_000_000, 4_000_004)


def test_bound_promises_no_attained_cost_where_no_table_stands():
    assert "attained" not in causal_bound(make_scenario("laboratory"), beside_table=False)["text"]
    assert "the best attained stands for it" in causal_bound(make_scenario("laboratory"))["text"]


def test_bound_says_where_the_starts_do_not_establish_it(monkeypatch, capsys, tmp_path):
    apart = Start("", 9.0, 1.0, True, 1, 0.25), Start("", 9.0, 1.07, True, 1, 0.5)
    found = Bounds((EpisodeBound(1.0, apart),))
    monkeypatch.setattr("agents.evaluation.bound.earthquake_bounds", lambda *given, **options: found)
    monkeypatch.setattr("agents.evaluation.bound_store.best_episodes", lambda *given: [None])
    monkeypatch.setattr("agents.reporting.figures.bound.draw_optimum", lambda *given: [])
    words = f"bound --scenario yielding --duration 0.5 --seeds 0 1 --output {tmp_path / 'b'}"
    assert main(words.split()) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "On 1 of 1 earthquakes the starts differ by more than 1 % (at most 7 %)" in shown
    assert "0.75 s" in shown and "attained" not in shown


def test_the_causal_bound_of_the_linear_table_is_lqr():
    scenario = make_scenario("linear")
    known = causal_bound(scenario)
    design = sampled_lqr(scenario.discrete, scenario.stage_cost)
    assert known["exact"] and known["cost"] == pytest.approx(design.analytic_cost)


def earthquakes(record, scenario="laboratory", **options):
    made = make_scenario(scenario) if isinstance(scenario, str) else scenario
    return Plan(record=record, motion_options=MotionOptions(**options)).earthquakes(made, Console())


def test_an_embedded_record_is_planned_in_any_scenario():
    file = DATA / "CICLC_trimmed.v1"
    (own, *_) = read_motion(file)
    others = replace(make_scenario("laboratory"), motion=MotionSet((RecordedMotion(record=own),)))
    (there,), (plain,) = (earthquakes(RECORD_NAMES[1], each) for each in (others, "laboratory"))
    assert there == plain and there.name == RECORD_NAMES[1]
    assert len(earthquakes(str(file), highpass=0.5)) >= 1


def test_options_of_files_are_refused_for_an_embedded_record():
    for option, value in (("highpass", 0.5), ("units", "g"), ("allow_large", True), ("stroke", 0.05)):
        with pytest.raises(ParameterError, match=f"--{option.replace('_', '-')} = .*applies to files"):
            earthquakes(RECORD_NAMES[0], **{option: value})


def test_a_name_that_is_no_record_suggests_one():
    with pytest.raises(RecordError, match=r"is no file; did you mean 'napa2014_68150_hn[en]'"):
        earthquakes("napa2014_68150_hn")
    with pytest.raises(RecordError, match="known: napa2014"):
        earthquakes("kobe")


def test_a_long_motion_is_refused_or_its_time_told(capsys):
    scenario = make_scenario("laboratory")

    def lasting(duration):
        quake = Earthquake("long", FilteredNoise(duration=duration))
        check_durations([quake], scenario, Console(width=200))
        return capsys.readouterr().out

    assert lasting(60.0) == ""
    assert "600 s of motion: planning takes about 5 min" in lasting(600.0)
    with pytest.raises(ParameterError, match=r"lasts 3600 s .*about 30 min.*cut it to 1200 s"):
        lasting(3600.0)


@pytest.mark.slow
def test_a_record_is_planned_and_written(tmp_path, capsys):
    words = f"plan {RECORD_NAMES[0]} --output {tmp_path / 'plan'} --json"
    assert main(words.split()) == 0
    (described,) = json.loads(capsys.readouterr().out)["plans"]
    plan = RecordPlan.read(tmp_path / "plan" / f"{RECORD_NAMES[0]}.npz")
    assert plan.cost == described["cost"] and described["base_shear_rms_error"] < 0.05
    assert (tmp_path / "plan" / f"{RECORD_NAMES[0]}.png").is_file()
