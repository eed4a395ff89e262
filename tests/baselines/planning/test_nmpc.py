"""Nonlinear predictive control: preview LQR on a linear table, and better than LQG on a real one."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba")

from baselines.lqr.preview import preview_lqr
from baselines.planning.bound import optimal_episodes
from baselines.planning.episodes import driven
from baselines.planning.nmpc import NMPCSettings, NonlinearPredictiveControl
from baselines.registry import make_baseline
from shake_env import make_scenario
from shake_env.rollout import noise_earthquakes, recorded_earthquakes
from shake_env.scenario.limits import Limits
from shake_env.scenario.observation import Sensing
from shake_env.simulation.simulation import Simulation


@pytest.mark.parametrize(("spacing", "position"), [(None, None), (0.001, 0.05)])
@pytest.mark.parametrize("horizon", [0.005, 0.06, 0.2])
def test_on_a_linear_table_it_is_preview_lqr(spacing, position, horizon):
    scenario = make_scenario("laboratory", {"fields": {"nonlinearity.friction.coulomb": 0.0}})
    scenario = replace(
        scenario,
        nonlinearity=make_scenario("linear").nonlinearity,
        delay=0.0,
        limits=Limits(),
        sensing=Sensing(preview=0.1, preview_spacing=spacing),
        current_limit=1.0,
    )
    settings = NMPCSettings(horizon=horizon, displacement_tolerance=position)
    law = NonlinearPredictiveControl(scenario, settings)
    design = preview_lqr(scenario.discrete, scenario.stage_cost, 0.1, spacing, position)
    observed = scenario.observation
    rms = np.sqrt(scenario.plant.target_variance)
    simulation, quake = Simulation(scenario, 1), noise_earthquakes(scenario, 1, 3)[0]
    shown = simulation.start([0], [np.random.default_rng(quake.seed)], [quake.motion])
    memory = None
    for _ in range(40):
        action, memory = law.predict(shown, memory, np.zeros(1, dtype=bool))
        x = shown[0, : scenario.plant.layout.order] * scenario.plant.state_scale
        expected = -design.gain @ x + design.preview_gain @ (shown[0, observed.preview] * rms)
        assert memory[0].current[0] == pytest.approx(expected, abs=1e-7)
        shown = simulation.step(action[:, 0].astype(float)).observation


def test_the_delay_is_planned_for():
    """With a delay of a period it is LQG on a linear table, but predicts the disturbances."""
    scenario = make_scenario("laboratory", {"duration": 5.0, "delay": 5.0})
    scenario = replace(scenario, nonlinearity=make_scenario("linear").nonlinearity)
    quakes = noise_earthquakes(scenario, 2, 4_000_000)
    ours = driven(NonlinearPredictiveControl(scenario), scenario, quakes)[1]
    theirs = driven(
        make_baseline("lqg", scenario, {"displacement_tolerance": 0.2, "model_error_scale": 0.1}),
        scenario,
        quakes,
    )[1]
    assert 0.95 * np.mean(theirs) < np.mean(ours) < np.mean(theirs)


def test_in_the_laboratory_it_leaves_the_linear_laws_behind():
    scenario = make_scenario("laboratory", {"duration": 6.0})
    quakes = noise_earthquakes(scenario, 3, 4_000_000)
    _, costs, lost = driven(NonlinearPredictiveControl(scenario), scenario, quakes)
    reference = driven(make_baseline("lqg", scenario), scenario, quakes)[1]
    least = [each.cost for each in optimal_episodes(scenario, quakes)]
    assert not any(lost)
    assert (np.array(least) < costs).all()
    assert np.mean(costs) < 0.75 * np.mean(reference)


def test_a_table_does_not_depend_on_its_batch():
    scenario = make_scenario("laboratory", {"duration": 1.0})
    quakes = noise_earthquakes(scenario, 3, 7)
    together = driven(NonlinearPredictiveControl(scenario), scenario, quakes)[0]
    alone = driven(NonlinearPredictiveControl(scenario), scenario, quakes[1:2])[0]
    np.testing.assert_allclose(together[1], alone[0], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "spacing", "ratio"),
    [
        ("laboratory", None, 1.62),
        ("laboratory", 0.001, 1.10),
        ("records", 0.001, 1.25),
        ("yielding", 0.001, 1.03),
    ],
)
def test_what_it_costs_over_the_bound(name, spacing, ratio):
    scenario = make_scenario(name, {"fields": {"sensing.preview_spacing": spacing}})
    recorded = name == "records"
    quakes = recorded_earthquakes(scenario) if recorded else noise_earthquakes(scenario, 16, 4_000_000)
    _, costs, lost = driven(NonlinearPredictiveControl(scenario), scenario, quakes)
    least = [each.cost for each in optimal_episodes(scenario, quakes)]
    assert not any(lost)
    assert np.mean(costs) <= ratio * np.mean(least)
