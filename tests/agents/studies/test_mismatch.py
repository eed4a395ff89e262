"""What one mismatch at a time costs: the scenarios that are run, and the numbers against roll-outs."""

from dataclasses import replace

import numpy as np
import pytest

from agents.policies.registry import get_controller
from agents.studies.mismatch import ALL, NONE, SENSORS, mismatch_costs, mismatched
from shake_env import make_scenario
from shake_env.errors import ScenarioError
from shake_env.rollout import noise_earthquakes, rollout

SHORT = {"duration": 1.0}


@pytest.fixture(scope="module")
def field():
    return make_scenario("field", SHORT)


def test_each_scenario_has_one_mismatch(field):
    runs = mismatched(field)
    drawn = [name for name, spread in vars(field.uncertainty).items() if spread is not None]
    assert list(runs) == [NONE, *drawn, SENSORS, ALL]
    for name in drawn:
        uncertainty = runs[name].uncertainty
        assert [n for n, spread in vars(uncertainty).items() if spread is not None] == [name]
        assert getattr(uncertainty, name) == getattr(field.uncertainty, name)
        assert not any(s.gain_error or s.bias for s in runs[name].sensing.sensors)
    assert not runs[NONE].uncertainty.active and not runs[SENSORS].uncertainty.active
    assert runs[SENSORS].sensing == field.sensing and runs[ALL] == field


def test_costs_are_those_of_a_controller_designed_on_the_nominal_table(field):
    few = replace(field, uncertainty=replace(field.uncertainty, **{
        name: None for name, spread in vars(field.uncertainty).items()
        if spread is not None and name not in ("mass_ratio", "coulomb_friction")
    }))  # fmt: skip
    rows = {row.name: row for row in mismatch_costs(few, ["lqg"], earthquakes=2, seed=5)}
    metrics, _ = rollout(get_controller("lqg", few), few, noise_earthquakes(few, 2, 5))
    assert rows[ALL].costs["lqg"] == np.mean([m.cost for m in metrics])
    assert rows["mass_ratio"].costs != rows[NONE].costs != rows["coulomb_friction"].costs


def test_a_scenario_that_draws_nothing_is_refused():
    with pytest.raises(ScenarioError, match="field"):
        mismatched(make_scenario("linear"))
