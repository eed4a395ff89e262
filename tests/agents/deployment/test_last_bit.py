"""Runs whose actions differ in the last bit: what costs in single precision are compared with."""

from dataclasses import replace

import numpy as np
import pytest

from agents.deployment.accuracy import COST, PERTURBED, Agreement, perturbed_costs
from baselines.registry import make_baseline
from shake_env import Supervised, make_scenario
from shake_env.rollout import noise_earthquakes, rollout


def test_the_last_bit_of_an_action_changes_a_smooth_loops_cost_by_as_little():
    scenario = make_scenario("laboratory", {"duration": 0.5})
    controller, earthquakes = make_baseline("pid", scenario), noise_earthquakes(scenario, 2)
    own = [row.cost for row in rollout(controller, scenario, earthquakes)[0]]
    costs = perturbed_costs(controller, scenario, earthquakes)
    assert costs.shape == (PERTURBED, 2) and (np.ptp(costs, axis=0) > 0.0).all()
    assert np.abs(costs / own - 1.0).max() < 1e-4


def test_a_cost_is_good_only_where_double_precision_has_it_too():
    found = Agreement(
        scenario="field", controller="lqg", decisions=10, largest=0.0, exceptions=0, single=1e-6,
        cost=0.04, nearest=1e-4, costs=2, parted=0.05, random=1, random_largest=0.0, random_refused=0,
        checked=(),
    )  # fmt: skip
    assert found.good and not replace(found, nearest=0.01).good


@pytest.mark.slow
def test_at_the_supervisors_gate_double_precision_parts_from_itself():
    scenario = make_scenario("field")
    controller = Supervised(make_baseline("lqg", scenario), scenario)
    earthquakes = noise_earthquakes(scenario, 1)
    own = rollout(controller, scenario, earthquakes)[0][0].cost
    parted = np.abs(perturbed_costs(controller, scenario, earthquakes) / own - 1.0)
    assert parted.max() > 10.0 * COST and parted.min() < 2.0 * COST
