"""Parameters as states: found from the table's signals, and worth what knowing them is."""

import numpy as np
import pytest

pytest.importorskip("numba")

from baselines.planning.adaptive import AdaptivePredictiveControl, UncertainParameters
from baselines.planning.bound import optimal_episodes
from baselines.planning.episodes import driven
from baselines.planning.nmpc import NonlinearPredictiveControl
from shake_env import make_scenario
from shake_env.controller import decide
from shake_env.errors import ScenarioError
from shake_env.rollout import noise_earthquakes, rollout, sampled_plants
from shake_env.scenario.uncertainty import Uniform


class Watched:
    """A controller whose last memory is kept."""

    def __init__(self, law):
        self.law, self.memory = law, None

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, self.memory = decide(self.law, observation, state, episode_start)
        return action, self.memory


def test_the_specimen_is_found():
    scenario = make_scenario("unknown-specimen", {"duration": 3.5})
    quakes = noise_earthquakes(scenario, 1, 4_000_002)
    law = Watched(AdaptivePredictiveControl(scenario))
    rows, _ = rollout(law, scenario, quakes)
    plants = sampled_plants(scenario, quakes)
    truth = [[p.specimen.mass / p.actuator.table_mass, uniform_frequency(p)] for p in plants]
    found = law.memory[0].estimate.rest[:, -2:] * law.law.parameters.unit
    assert found == pytest.approx(np.array(truth), rel=0.1)
    assert not any(row.broken_limit for row in rows)


@pytest.mark.slow
def test_over_a_whole_test_it_costs_less_than_the_nominal_specimen():
    """Within a quarter of the bound, without being told the specimen."""
    scenario = make_scenario("unknown-specimen", {"fields": {"sensing.preview_spacing": 0.001}})
    quakes = noise_earthquakes(scenario, 4, 4_000_000)
    _, costs, lost = driven(AdaptivePredictiveControl(scenario), scenario, quakes)
    unaware = driven(NonlinearPredictiveControl(scenario), scenario, quakes)[1]
    least = [each.cost for each in optimal_episodes(scenario, quakes)]
    assert not any(lost)
    assert np.mean(costs) < 1.25 * np.mean(least)
    assert np.mean(costs) < 0.8 * np.mean(unaware)


def uniform_frequency(plant):
    return float(np.sqrt(plant.specimen.stiffnesses[0] / plant.specimen.masses[0]) / (2.0 * np.pi))


@pytest.mark.slow
def test_friction_and_bulk_modulus_are_found():
    fields = {
        "uncertainty.coulomb_friction": Uniform(50.0, 400.0),
        "uncertainty.bulk_modulus": Uniform(1.0e8, 1.8e8),
    }
    scenario = make_scenario("laboratory", {"duration": 5.0, "fields": fields})
    quakes = noise_earthquakes(scenario, 2, 4_000_000)
    law = Watched(AdaptivePredictiveControl(scenario))
    rollout(law, scenario, quakes)
    known = law.law.parameters
    for row, plant in zip(law.memory[0].estimate.rest, sampled_plants(scenario, quakes), strict=True):
        found = dict(zip(known.names, row[-2:] * known.unit, strict=True))
        assert found["coulomb_friction"] == pytest.approx(plant.nonlinearity.friction.coulomb, rel=0.15)
        assert found["bulk_modulus"] == pytest.approx(plant.actuator.bulk_modulus, rel=0.05)


def test_it_refuses_what_it_cannot_identify():
    with pytest.raises(ScenarioError, match="uncertainty = 'none': no parameter is drawn"):
        AdaptivePredictiveControl(make_scenario("laboratory"))
    fields = {"uncertainty.delay": Uniform(1.5, 3.5)}
    words = r"uncertainty = 'delay': is not estimated: draw one of mass_ratio, .*bulk_modulus.*nmpc"
    with pytest.raises(ScenarioError, match=words) as raised:
        AdaptivePredictiveControl(make_scenario("laboratory", {"fields": fields}))
    assert "storey_factor" not in raised.value.remedy
    fields = {"uncertainty.mass_ratio": Uniform(0.1, 1.0)}
    with pytest.raises(ScenarioError, match="yielding"):
        AdaptivePredictiveControl(make_scenario("yielding", {"fields": fields}))


def test_a_range_may_begin_at_zero():
    fields = {"uncertainty.leakage": Uniform(0.0, 1e-12)}
    known = UncertainParameters.from_scenario(make_scenario("laboratory", {"fields": fields}))
    assert (known.low > 0.0).all() and (known.low < 1.0).all() and (known.high > 1.0).all()
    assert known.plant(known.nominal).actuator.leakage > 0.0
