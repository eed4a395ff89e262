"""How far a scenario lies from what a policy was trained on, and the warning."""

import math
from dataclasses import replace

import pytest

from agents.evaluation.comparison import compare
from agents.evaluation.entries import find_entry
from agents.evaluation.protocol import evaluate
from agents.evaluation.training_distance import PARAMETERS, training_distance, training_warning
from agents.policies.policy_file import load_policy
from agents.policies.registry import SHIPPED, shipped_policy
from shake_env import SCENARIO_NAMES, make_scenario
from shake_env.errors import PolicyFileError, ScenarioError

LINEAR = make_scenario("linear")


def test_no_scenario_is_far_from_itself():
    for name in SCENARIO_NAMES:
        scenario = make_scenario(name)
        assert training_distance(scenario, scenario) == (0.0, "nothing")


def test_a_departure_is_counted_in_the_parameters_own_step():
    heavier = make_scenario("linear", {"mass_ratio": 0.5 * 1.5**2})
    distance, reason = training_distance(LINEAR, heavier)
    assert distance == pytest.approx(2.0) and "specimen mass" in reason and "1.125" in reason
    lighter = make_scenario("linear", {"mass_ratio": 0.5 / 1.5})
    assert training_distance(LINEAR, lighter)[0] == pytest.approx(1.0)
    rubbing = make_scenario("linear", {"fields": {"nonlinearity.friction.coulomb": 450.0}})
    assert training_distance(LINEAR, rubbing)[0] == pytest.approx(3.0)
    late = make_scenario("linear", {"delay": 6.0})
    assert training_distance(LINEAR, late)[0] == pytest.approx(3.0)


def test_storeys_of_one_storey_frequency_are_alike_whatever_their_number():
    taller = make_scenario("linear", {"stories": 5})
    assert training_distance(LINEAR, taller)[0] < 1e-9


def test_what_was_drawn_in_training_is_inside():
    trained = make_scenario("unknown-specimen")
    inside = make_scenario(trained, {"mass_ratio": 1.0, "uncertainty": LINEAR.uncertainty})
    assert training_distance(trained, inside)[0] == pytest.approx(0.0, abs=1e-9)
    outside = make_scenario(trained, {"fields": {"uncertainty.mass_ratio": [0.1, 1.5**2]}})
    distance, reason = training_distance(trained, outside)
    assert distance == pytest.approx(2.0) and "0.1 to 2.25, trained 0.1 to 1" in reason


def test_what_training_did_not_have_at_all_is_infinitely_far():
    yields = make_scenario("linear", {"fields": {"nonlinearity.yielding.yield_drift": 0.004}})
    assert training_distance(LINEAR, yields)[0] == math.inf
    assert training_distance(LINEAR, make_scenario("as-printed")) == (
        math.inf, "other equations of motion",
    )  # fmt: skip


def test_every_parameter_can_be_the_one_that_is_far():
    changes = {
        "actuator.table_mass": 900.0, "actuator.bulk_modulus": 6e8, "current_limit": 0.08,
        "nonlinearity.valve.supply_pressure": 1e7, "motion.amplitude": 1.0,
        "sensing.sensors.load_pressure.noise": 1e6, "specimen.dampings": [2000.0, 2000.0],
        "specimen.stiffnesses": [1e6, 1e6],
    }  # fmt: skip
    trained = make_scenario("laboratory")
    reasons = set()
    for path, value in changes.items():
        distance, reason = training_distance(trained, make_scenario(trained, {"fields": {path: value}}))
        assert distance > 1.0, path
        reasons.add(next(p.title for p in PARAMETERS if reason.startswith(p.title)))
    assert len(reasons) >= 7


def test_shipped_policies_are_at_home_on_their_scenarios():
    at_home = set()
    for name in ("linear", "laboratory", "unknown-specimen", "yielding", "records"):
        scenario = make_scenario(name)
        for family in SHIPPED:
            try:
                policy = load_policy(shipped_policy(family, name)).reading(scenario)
            except (PolicyFileError, ScenarioError):
                continue
            trained = policy.card["config"]["scenario"]["scenario"]
            if trained in (name, "laboratory"):
                assert training_warning(policy, scenario) == "", (name, family)
                at_home.add((name, family))
    both = {(name, family) for name in ("linear", "laboratory", "records") for family in ("ppo", "apg")}
    assert at_home >= both | {("unknown-specimen", "apg"), ("yielding", "apg")}


def test_compare_and_evaluate_warn():
    far = make_scenario("linear", {"mass_ratio": 2.0, "duration": 0.5})
    found = compare(far, ["ppo"], noise=2, records=False)
    assert len(found.warnings) == 1 and "ppo is driven far outside" in found.warnings[0]
    assert any(note.startswith("Warning: ppo") for note in found.notes())
    near = compare(make_scenario("linear", {"duration": 0.5}), ["ppo"], noise=2, records=False)
    assert near.warnings == []
    result = evaluate(far, [find_entry("ppo", far)], earthquakes=2, repeats=False, resamples=10)
    assert "far outside" in result["warnings"][0]


@pytest.mark.parametrize("card", [{}, {"config": {"scenario": {"set": [1]}}}])
def test_a_card_that_tells_nothing_gives_no_warning(card):
    policy = replace(load_policy(shipped_policy("ppo")), card=card)
    assert training_warning(policy, make_scenario("linear", {"mass_ratio": 2.0})) == ""
