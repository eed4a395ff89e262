"""Tuned values: which of three sources a controller's parameters come from, in code and commands."""

import json
from dataclasses import replace

import numpy as np
import pytest

from agents.__main__ import main
from agents.evaluation.controller_set import describe_values, get_controllers, values_to_json
from agents.evaluation.design import design
from agents.evaluation.robustness import controllers_with_sources
from agents.experiments.controller_tuning import keep_tuned_values, tune
from agents.policies.base_law import at_own_cost, base_law
from agents.policies.registry import get_controller
from baselines.registry import make_baseline, parameter_values, tuned_parameters
from baselines.searched_lqg import LQG_SEARCHED
from baselines.tuned_values import (
    FORMAT,
    TunedEntry,
    TunedValues,
    packaged_values,
    read_tuned,
    write_tuned,
)
from shake_env import SCENARIO_NAMES, make_scenario
from shake_env.errors import ParameterError, ScenarioError
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.scenario.digest import scenario_digest

LABORATORY = make_scenario("laboratory")
CHANGED = make_scenario("laboratory", {"fields": {"actuator.table_mass": 420.0}})


def entry(scenario, controller="tvc", **parameters):
    return TunedEntry(
        controller=controller,
        digest=scenario_digest(scenario),
        scenario=scenario.name,
        parameters=parameters or {"bandwidth": 0.5, "damping": 0.3},
    )


def test_packaged_values_belong_to_the_named_scenarios_as_they_stand():
    named = {scenario_digest(make_scenario(name)): name for name in SCENARIO_NAMES}
    for each in packaged_values().entries:
        assert named[each.digest] == each.scenario, each.controller
    assert len(packaged_values().entries) == 61


@pytest.mark.parametrize("name", ["lqg", "tvc", "pid", "inverse-ff-tvc", "lqg-searched"])
def test_a_scenarios_name_decides_nothing(name):
    mine = replace(LABORATORY, name="mytable")
    assert parameter_values(name, mine) == parameter_values(name, LABORATORY)
    assert parameter_values(name, mine).source == "tuned"
    alias = make_scenario("linear", {"fields": {"name": "laboratory"}})
    assert parameter_values(name, alias).source != "tuned" or name in ("tvc", "pid", "inverse-ff-tvc")
    assert tuned_parameters(name, alias) == tuned_parameters(name, make_scenario("linear"))


def test_renamed_scenarios_cost_the_same_to_the_last_bit():
    quakes = noise_earthquakes(make_scenario("laboratory", {"duration": 0.3}), 2, seed=5)
    costs = []
    for scenario in (LABORATORY, replace(LABORATORY, name="mytable")):
        chosen = get_controllers(["tvc", "inverse-ff-tvc"], scenario)
        assert {each.description for each in chosen.values.values()} == {"tuned on this scenario"}
        rows = {name: rollout(c, scenario, quakes)[0] for name, c in chosen.controllers.items()}
        costs.append({name: [row.cost for row in each] for name, each in rows.items()})
    assert costs[0] == costs[1] and set(costs[0]) == {"lqg", "tvc", "inverse-ff-tvc"}


def test_a_changed_scenario_gets_the_written_rule_or_a_files_values():
    assert parameter_values("tvc", CHANGED).source == "rule"
    other = TunedValues("mine.json", (entry(replace(CHANGED, name="mytable")),))
    exact = parameter_values("tvc", CHANGED, other)
    assert exact.source == "file" and exact.description == "mine.json, tuned on this scenario"
    assert exact.parameters == {"bandwidth": 0.5, "damping": 0.3}
    further = parameter_values("tvc", make_scenario(CHANGED, {"delay": 3.0}), other)
    assert further.source == "file"
    assert further.description == "mine.json, tuned on mytable, not this scenario"
    assert parameter_values("pid", CHANGED, other).source == "rule"


def test_what_was_tuned_on_exactly_this_comes_first():
    elsewhere = TunedValues("mine.json", (entry(CHANGED),))
    assert parameter_values("tvc", LABORATORY, elsewhere).source == "tuned"
    again = elsewhere.with_entry(entry(LABORATORY, bandwidth=0.7))
    found = parameter_values("tvc", LABORATORY, again)
    assert found.source == "file" and found.parameters == {"bandwidth": 0.7}


def test_values_of_several_other_scenarios_are_not_guessed_between():
    several = TunedValues("mine.json").with_entry(entry(CHANGED))
    several = several.with_entry(entry(make_scenario(CHANGED, {"delay": 3.0})))
    with pytest.raises(ParameterError, match="several scenarios"):
        parameter_values("tvc", make_scenario(CHANGED, {"delay": 4.0}), several)
    assert parameter_values("tvc", CHANGED, several).source == "file"


def test_the_records_take_the_laboratorys_values_and_a_changed_table_of_them_does_not():
    records = make_scenario("records")
    found = parameter_values("lqg", records)
    assert found.source == "tuned" and "laboratory, the same table" in found.description
    assert parameter_values("lqg", make_scenario(records, {"delay": 3.0})).source == "rule"


def test_a_file_is_read_as_it_was_written(tmp_path):
    values = TunedValues("x").with_entry(entry(CHANGED)).with_entry(entry(LABORATORY))
    write_tuned(values, tmp_path / "sub" / "mine.json")
    assert read_tuned(str(tmp_path / "sub" / "mine.json")).entries == values.entries
    replaced = values.with_entry(entry(CHANGED, bandwidth=0.1))
    assert len(replaced.entries) == 2
    assert replaced.exact("tvc", scenario_digest(CHANGED)).parameters == {"bandwidth": 0.1}


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "is no JSON"),
        ("[" * 100_000, "is no JSON"),
        ("[]", "has no format"),
        ('{"laboratory": {"lqg": {"parameters": {}}}}', "has no format"),
        (json.dumps({"format": FORMAT, "entries": [{"controller": "tvc"}]}), "entry 0 lacks"),
        (
            json.dumps({"format": FORMAT, "entries": [vars(entry(CHANGED, bandwidth=float("nan")))]}),
            "finite numbers",
        ),
    ],
)
def test_a_file_that_is_none_is_refused(tmp_path, text, match):
    file = tmp_path / "mine.json"
    file.write_text(text)
    with pytest.raises(ParameterError, match=match):
        read_tuned(file)


def test_a_missing_file_and_an_unknown_parameter_are_refused(tmp_path):
    with pytest.raises(ParameterError, match="there is no such file"):
        read_tuned(tmp_path / "absent.json")
    wrong = TunedValues("mine.json", (entry(CHANGED, "lqg-searched", bandwith=1.0),))
    with pytest.raises(ScenarioError, match="parameter of lqg-searched"):
        get_controllers(["lqg-searched"], CHANGED, tuned=wrong)


def test_tune_compare_and_evaluate_share_a_file_on_a_changed_table(tmp_path, capsys):
    file = str(tmp_path / "mine.json")
    table = ["--duration", "0.3", "--set", "actuator.table_mass=420"]
    search = ["--budget", "120", "--earthquakes", "1", "--storage", str(tmp_path / "t.db")]
    assert main(["tune", "tvc", *table, *search, "--output", file, "--json"]) == 0
    tuned = json.loads(capsys.readouterr().out)["parameters"]
    few = ["--num-noise-motions", "2", "--no-records", "--json"]
    assert main(["compare", *table, "--controllers", "tvc", "--tuned", file, *few]) == 0
    values = json.loads(capsys.readouterr().out)["values"]
    assert values["tvc"]["source"] == "file" and values["tvc"]["parameters"] == tuned
    assert values["lqr"]["source"] == "rule"
    arguments = ["evaluate", "tvc", *table, "--tuned", file, "--earthquakes", "2", "--no-fidelity"]
    assert main([*arguments, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["values"]["tvc"]["parameters"] == tuned
    renamed = [*table, "--set", "name=another"]
    shown = ["--tuned", file, *few[:3], "--output", str(tmp_path / "out")]
    assert main(["compare", *renamed, "--controllers", "tvc", *shown]) == 0
    assert f"tvc: {file}, tuned on this scenario" in capsys.readouterr().out


def test_robustness_designs_on_the_scenario_as_it_stands():
    """What is changed, no controller knows; the values are looked up before anything is changed."""
    chosen, _ = controllers_with_sources(["tvc"], LABORATORY)
    assert {each.source for each in chosen.values.values()} == {"tuned"}
    mine = TunedValues("mine.json", (entry(CHANGED),))
    chosen, _ = controllers_with_sources(["tvc"], CHANGED, mine)
    assert chosen.values["tvc"].parameters == {"bandwidth": 0.5, "damping": 0.3}
    sentence = describe_values(values_to_json(chosen.values))
    lqg, tvc = sentence.split("lqg:")[1].split("tvc:")
    assert "mine.json" not in lqg and "mine.json" in tvc


def test_a_recipe_that_charges_otherwise_corrects_the_same_law():
    """Training with soft limits and another weight starts from the law of the named scenario."""
    fields = {"limits.soft_share": 0.8, "limits.soft_weight": 0.05, "objective.force_weight": 30.0}
    charged = make_scenario("yielding", {"fields": fields})
    named = make_scenario("yielding")
    assert at_own_cost(charged, "yielding") == named
    assert parameter_values(LQG_SEARCHED, charged).source == "rule"
    tuned = parameter_values(LQG_SEARCHED, named).parameters
    expected = make_baseline(LQG_SEARCHED, charged, tuned).row
    np.testing.assert_array_equal(
        base_law(LQG_SEARCHED, charged, at_own_cost(charged, "yielding")), expected
    )


def test_design_says_what_the_scenario_really_runs():
    scenario = make_scenario("yielding", {"duration": 1.0, "mass_ratio": 0.4})
    found = design(scenario, earthquakes=2)
    assert (found["controller"], found["method"], found["earthquakes"]) == (
        "preview-lqr", "simulation", 2,
    )  # fmt: skip
    assert found["bound"]["controller"] == "preview-lqr"
    assert found["values"]["preview-lqr"]["source"] == "rule"
    exact = design(make_scenario("linear", {"fields": {"sensing.preview": 0.1}}))
    assert (exact["controller"], exact["method"]) == ("preview-lqr", "analysis")
    assert exact["base_shear_rms_ratio"] < 0.5 * design(make_scenario())["base_shear_rms_ratio"]


def test_keep_refuses_another_kind_of_file(tmp_path):
    file = tmp_path / "mine.json"
    file.write_text('{"laboratory": {}}')
    linear = make_scenario("linear", {"duration": 0.2})
    found = tune("tvc", linear, tmp_path / "t.db", budget=100, earthquakes=1)
    with pytest.raises(ParameterError, match="has no format"):
        keep_tuned_values(found, file)
    assert file.read_text() == '{"laboratory": {}}'


def test_parameters_that_are_given_win():
    given = {"bandwidth": 0.4, "damping": 0.25}
    one = get_controller("tvc", LABORATORY, parameters=given)
    other = make_baseline("tvc", LABORATORY, given)
    np.testing.assert_equal(vars(one).keys(), vars(other).keys())
    observation = np.full((1, LABORATORY.observation.size), 0.1, dtype=np.float32)
    np.testing.assert_array_equal(one.predict(observation)[0], other.predict(observation)[0])
