"""The oracle, and one controller a lane."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.batch_controllers import PerLane
from baselines.lqr.oracle import oracle_controller
from baselines.lqr.preview import PreviewFeedback
from baselines.lqr.sampled import lqr
from shake_env import NoControl, make_scenario
from shake_env.errors import ParameterError
from shake_env.rollout import noise_earthquakes, recorded_earthquakes, rollout, sampled_plants
from shake_env.scenario.uncertainty import Uncertainty, Uniform
from shake_env.simulation.simulation import Simulation


def test_true_plants_are_those_that_the_roll_out_draws():
    scenario = make_scenario("unknown-specimen", {"duration": 1.0})
    quakes = noise_earthquakes(scenario, 5, seed=3)
    simulation = Simulation(scenario, 5)
    simulation.start(
        range(5), [np.random.default_rng(q.seed) for q in quakes], [q.motion for q in quakes]
    )
    for expected, found in zip(
        simulation.plant_batch.plants, sampled_plants(scenario, quakes), strict=True
    ):
        np.testing.assert_allclose(found.specimen.masses, expected.specimen.masses)
        np.testing.assert_allclose(found.specimen.stiffnesses, expected.specimen.stiffnesses)


def test_knowing_the_plant_beats_knowing_its_middle():
    scenario = make_scenario("unknown-specimen", {"duration": 3.0})
    quakes = noise_earthquakes(scenario, 6, seed=3)
    seen, controller = oracle_controller(scenario, quakes)
    knowing, _ = rollout(controller, seen, quakes)
    middle, _ = rollout(PreviewFeedback(seen), seen, quakes)
    # LQR is optimal on the average: under one earthquake, and on a plant near the middle one, the other
    # design may win by a hair. What knowing is worth is that the cost does not depend on the plant.
    costs, others = (np.array([row.cost for row in rows]) for rows in (knowing, middle))
    assert np.mean(costs) < 0.6 * np.mean(others)
    # Earthquakes of 3 s differ by themselves, for both designs alike.
    assert np.ptp(np.log(others)) > 2.0 * np.ptp(np.log(costs))
    assert np.mean([row.base_shear_rms_error for row in knowing]) < 0.05


def test_without_uncertainty_it_is_preview_lqr_and_its_analytic_cost():
    scenario = make_scenario("linear", {"duration": 2.0})
    quakes = noise_earthquakes(scenario, 3)
    seen, controller = oracle_controller(scenario, quakes)
    one, _ = rollout(controller, seen, quakes)
    two, _ = rollout(PreviewFeedback(seen), seen, quakes)
    np.testing.assert_allclose([a.cost for a in one], [b.cost for b in two], rtol=1e-5)


def test_one_controller_a_lane():
    scenario = make_scenario("linear", {"duration": 1.0})
    quakes = noise_earthquakes(scenario, 2)
    mixed, _ = rollout(PerLane([lqr(scenario), NoControl()]), scenario, quakes)
    alone, _ = rollout(lqr(scenario), scenario, quakes[:1])
    idle, _ = rollout(NoControl(), scenario, quakes)
    assert mixed[0].cost == pytest.approx(alone[0].cost) and mixed[1].cost == idle[1].cost
    with pytest.raises(ParameterError, match="2 lanes"):
        PerLane([lqr(scenario), NoControl()]).predict(np.zeros((3, 14), dtype=np.float32))


def test_friction_on_a_table_that_minds_no_place():
    """It knows the friction, the target and the state: far below the LQR that sees the last alone."""
    scenario = make_scenario(
        "linear", {"duration": 4.0, "fields": {"nonlinearity.friction.coulomb": 300.0}}
    )
    quakes = noise_earthquakes(scenario, 4, seed=3)
    seen, controller = oracle_controller(scenario, quakes)
    knowing, _ = rollout(controller, seen, quakes)
    unaware, _ = rollout(lqr(scenario), scenario, quakes)
    assert sum(row.cost for row in knowing) < 0.6 * sum(row.cost for row in unaware)


def test_with_friction_each_lane_has_the_law_of_its_own_plant():
    """A plant drawn from one point, as the oracle finds it, against that plant as the nominal."""
    drawn = Uncertainty(mass_ratio=Uniform(0.8, 0.8), coulomb_friction=Uniform(250.0, 250.0))
    scenario = make_scenario("laboratory", {"uncertainty": drawn, "duration": 3.0})
    quakes = recorded_earthquakes(scenario)[:2]  # a stream that draws a plant has other noise behind
    seen, controller = oracle_controller(scenario, quakes)
    ours, _ = rollout(controller, seen, quakes)
    true = replace(scenario.drawn(np.random.default_rng(0)), uncertainty=Uncertainty())
    seen, controller = oracle_controller(true, quakes)
    theirs, _ = rollout(controller, seen, quakes)
    for mine, other in zip(ours, theirs, strict=True):
        # The observation is rounded to single precision over another scale.
        assert mine.cost == pytest.approx(other.cost, rel=1e-4)
