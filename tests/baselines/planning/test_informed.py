"""A plan on the plant of each episode: told the nominal one it is `nmpc`, told the truth cheaper."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba")

from baselines.planning.episodes import driven
from baselines.planning.informed import InformedPredictiveControl
from baselines.planning.nmpc import NonlinearPredictiveControl
from shake_env import make_scenario
from shake_env.errors import ScenarioError
from shake_env.rollout import noise_earthquakes, sampled_plants
from shake_env.scenario.uncertainty import Uncertainty


def test_told_the_nominal_plant_it_is_nmpc():
    scenario = make_scenario("field", {"duration": 1.5})
    nominal = replace(scenario, uncertainty=Uncertainty())
    quakes = noise_earthquakes(scenario, 2, 3_000_000)
    told = driven(InformedPredictiveControl(scenario, lambda n: nominal), scenario, quakes)[0]
    plain = driven(NonlinearPredictiveControl(scenario), scenario, quakes)[0]
    assert np.abs(plain).max() > 1e-4
    # Equal but for the order of sums: the design of all tables, and one for each.
    assert np.array(told) == pytest.approx(np.array(plain), abs=1e-9)


def test_told_the_truth_it_costs_less():
    scenario = make_scenario("field", {"duration": 3.0})
    quakes = noise_earthquakes(scenario, 2, 3_000_000)
    plants = sampled_plants(scenario, quakes)
    told = driven(InformedPredictiveControl(scenario, plants.__getitem__), scenario, quakes)
    plain = driven(NonlinearPredictiveControl(scenario), scenario, quakes)
    assert not any(told[2])
    assert all(mine < 0.8 * other for mine, other in zip(told[1], plain[1], strict=True))


def test_it_refuses_a_scenario_that_draws_nothing():
    scenario = make_scenario("laboratory")
    with pytest.raises(ScenarioError, match="no parameter is drawn"):
        InformedPredictiveControl(scenario, lambda n: scenario)
