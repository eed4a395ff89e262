"""Cost over time beside the controller that is told the plant."""

import json

import numpy as np
import pytest

from agents.policies.registry import get_controller
from agents.studies.adaptation.costs import INFORMED, ClearedMemory, stage_costs
from agents.studies.adaptation.figure import draw_adaptation
from agents.studies.adaptation.result import AdaptationSettings, adaptation, adaptation_table
from shake_env import make_scenario
from shake_env.errors import ParameterError, ScenarioError
from shake_env.rollout import noise_earthquakes, rollout

pytest.importorskip("numba", reason="nonlinear predictive control is compiled")


@pytest.fixture(scope="module")
def scenario():
    return make_scenario("unknown-specimen", {"duration": 1.0})


@pytest.fixture(scope="module")
def result(scenario):
    settings = AdaptationSettings(
        controllers=("apg", "lqg-searched"), earthquakes=3, seed=5, bin=0.25, clear_time=0.5
    )
    return adaptation(scenario, settings)


def test_stage_costs_are_those_of_a_roll_out(scenario):
    quakes = noise_earthquakes(scenario, 2, 5)
    costs = stage_costs("lqg-searched", scenario, quakes)
    metrics, _ = rollout(get_controller("lqg-searched", scenario), scenario, quakes)
    assert costs.costs.shape == (200, 2) and not costs.lost.any()
    np.testing.assert_allclose(costs.costs.mean(axis=0), [m.cost for m in metrics], rtol=1e-12)


def test_a_result_holds_the_ratios_of_its_definition(result, scenario):
    quakes = noise_earthquakes(scenario, 3, 5)
    ours, told = (stage_costs(name, scenario, quakes).costs for name in ("lqg-searched", INFORMED))
    rows = {row["controller"]: row for row in result["rows"]}
    assert list(rows) == [INFORMED, "apg", "lqg-searched"]
    expected = ours.reshape(4, 50, 3).sum(axis=(1, 2)) / told.reshape(4, 50, 3).sum(axis=(1, 2))
    found = np.array(rows["lqg-searched"]["ratio"])
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-5)
    assert (found[:, 1] <= found[:, 0]).all() and (found[:, 0] <= found[:, 2]).all()
    assert all(ratio == [1.0, 1.0, 1.0] for ratio in rows[INFORMED]["ratio"])


def test_a_cleared_memory_changes_nothing_before_and_something_after(result):
    (cleared,) = result["cleared"]
    assert cleared["policy"] == "apg"
    edges, ratio = np.array(result["clear_edges"]), np.array(cleared["ratio"])[:, 0]
    before = edges[1:] <= 0.5 + 1e-9
    np.testing.assert_array_equal(ratio[before], 1.0)
    assert (ratio[~before] != 1.0).any()


def test_the_estimate_of_the_base_law_stays_where_a_memory_is_cleared(scenario):
    policy = get_controller("apg", scenario)
    observation = np.zeros((2, scenario.observation.size), np.float32)
    observation[:, 6] = 0.3
    state, whole = None, None
    cleared = ClearedMemory(policy, 2)
    for step in range(3):
        kept = whole
        _, state = cleared.predict(observation, state)
        _, whole = policy.predict(observation, whole)
        if step < 2:
            for one, two in zip(state[1:], whole, strict=True):
                np.testing.assert_array_equal(one, two)
    rested = (np.zeros_like(kept[0]), *kept[1:])
    _, expected = policy.predict(observation, rested)
    for one, two in zip(state[1:], expected, strict=True):
        np.testing.assert_array_equal(one, two)


def test_table_and_figure_come_from_the_result_file(result, tmp_path):
    stored = json.loads(json.dumps(result))
    table = adaptation_table(stored)
    assert "`apg`" in table and "0 to 1 s" in table and f"| `{INFORMED}`" not in table
    paths = draw_adaptation(stored, tmp_path)
    assert [path.name for path in paths] == [f"adaptation_unknown-specimen.{k}" for k in ("png", "svg")]
    assert all(path.stat().st_size > 1000 for path in paths)


def test_what_cannot_be_measured_is_refused(scenario):
    quakes = noise_earthquakes(scenario, 1, 5)
    with pytest.raises(ParameterError, match="memory"):
        stage_costs("lqg-searched", scenario, quakes, cleared_at=3)
    with pytest.raises(ScenarioError, match="draws nothing"):
        stage_costs(INFORMED, make_scenario("laboratory", {"duration": 1.0}), quakes)
    for change in ({"bin": 0.007}, {"bin": 3.0}, {"clear_time": 4.0}):
        with pytest.raises(ParameterError, match=next(iter(change))):
            adaptation(scenario, AdaptationSettings(controllers=("lqg-searched",), **change))
