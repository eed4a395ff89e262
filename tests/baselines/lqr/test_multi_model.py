"""Multi-model LQR: gradient, one-model limit, optimality, and the whole set stable."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.lqr import multi_model
from baselines.lqr.multi_model import ModelSet, drawn_models, multi_model_lqr
from baselines.lqr.preview import preview_lqr
from baselines.lqr.sampled import LinearFeedback, ScaledProblem, sampled_lqr, stationary_performance
from shake_env import make_scenario
from shake_env.errors import NumericalError, ParameterError, ScenarioError
from shake_env.model.plant import REFERENCE_CURRENT
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.scenario.uncertainty import Uncertainty, Uniform

SPECIMEN = Uncertainty(mass_ratio=Uniform(0.1, 1.0), storey_frequency=Uniform(5.0, 9.0))
DOUBTFUL = Uncertainty(valve_gain=Uniform(3e-4, 1.5e-3), mass_ratio=Uniform(0.1, 2.0))
NOMINAL = make_scenario("linear", {"mass_ratio": 0.55})


def uncertain(uncertainty=SPECIMEN, **overrides):
    return replace(make_scenario("linear", {"mass_ratio": 0.55, **overrides}), uncertainty=uncertainty)


def exact(models, gain):
    return np.array([stationary_performance(m.discrete, m.stage_cost, gain).cost for m in models])


def scaled(scenario, gain):
    kept = ScaledProblem.from_plant(scenario.discrete).indices
    return (gain[kept] * scenario.plant.state_scale[kept] / REFERENCE_CURRENT)[None, :]


@pytest.fixture(scope="module")
def models():
    return drawn_models(uncertain(), 12, seed=3)


@pytest.fixture(scope="module")
def designs(models):
    return {aim: multi_model_lqr(NOMINAL, models, aim) for aim in ("mean", "worst")}


@pytest.mark.parametrize("discount", [1.0, 0.95])
def test_gradient_against_differences(models, discount):
    problem = ModelSet.from_scenarios(NOMINAL, models)
    K = scaled(NOMINAL, sampled_lqr(NOMINAL.discrete, NOMINAL.stage_cost).gain)
    _, slopes = problem.costs(K, discount)
    for i in range(K.shape[1]):
        step = np.zeros_like(K)
        # Central differences: their error grows with the square of the step, rounding with its inverse.
        step[0, i] = 1e-6 * np.linalg.norm(K)
        up, down = problem.costs(K + step, discount)[0], problem.costs(K - step, discount)[0]
        found = (up - down) / (2.0 * step[0, i])
        assert np.max(np.abs(slopes[:, i] - found)) < 1e-6 * np.max(np.abs(slopes[:, i]))


def test_costs_are_the_exact_stationary_ones(models, designs):
    for design in designs.values():
        assert design.costs == pytest.approx(exact(models, design.gain), rel=1e-8)
        nominal = sampled_lqr(NOMINAL.discrete, NOMINAL.stage_cost).gain
        assert design.nominal_costs == pytest.approx(exact(models, nominal), rel=1e-8)


@pytest.mark.parametrize("overrides", [{}, {"stories": 5, "control_rate": 500.0}], ids=str)
def test_of_one_model_it_is_that_models_lqr(overrides):
    model = make_scenario("linear", {"mass_ratio": 0.2, **overrides})
    nominal = make_scenario("linear", {"mass_ratio": 0.8, **overrides})
    best = sampled_lqr(model.discrete, model.stage_cost).analytic_cost
    for aim in ("mean", "worst"):
        design = multi_model_lqr(nominal, [model], aim)
        assert design.nominal_costs[0] > 1.01 * best
        # The minimum is flat: BFGS stops at a relative gradient of 1e-7, whose square is below this.
        assert design.costs[0] == pytest.approx(best, rel=1e-7)


def test_each_aim_is_best_at_its_own(models, designs):
    mean, worst = designs["mean"].costs, designs["worst"].costs
    assert mean.mean() < worst.mean() and worst.max() < mean.max()
    nominal = designs["mean"].nominal_costs
    assert mean.mean() < 0.85 * nominal.mean() and worst.max() < 0.7 * nominal.max()
    # No gain beats on a model the LQR that knows it.
    known = [sampled_lqr(m.discrete, m.stage_cost).analytic_cost for m in models]
    assert np.all(mean > known) and np.all(worst > known)


def test_no_neighbouring_gain_has_a_smaller_mean(models, designs):
    problem, K = ModelSet.from_scenarios(NOMINAL, models), scaled(NOMINAL, designs["mean"].gain)
    best = problem.costs(K)[0].mean()
    rng = np.random.default_rng(5)
    for size in (1e-5, 1e-3):
        for _ in range(20):
            step = rng.standard_normal(K.shape)
            near = K + size * np.linalg.norm(K) * step / np.linalg.norm(step)
            assert problem.costs(near)[0].mean() > best


def test_worst_costs_are_level(models, designs):
    # At a minimum of the worst cost more than one model attains it, or the gain would favour the one.
    costs = np.sort(designs["worst"].costs)[::-1]
    # The soft maximum may leave log(12) / 300 of it.
    assert costs[1] > (1.0 - np.log(12) / 300) * costs[0]


def test_the_whole_set_is_stabilised_where_the_nominal_lqr_is_not():
    models = drawn_models(uncertain(DOUBTFUL), 16, seed=1)
    design = multi_model_lqr(NOMINAL, models)
    assert np.sum(np.isinf(design.nominal_costs)) >= 3
    assert design.costs == pytest.approx(exact(models, design.gain), rel=1e-8)  # raises if unstable
    assert np.max(design.costs) < 1.0


def test_unseen_specimens_cost_what_the_set_does(designs):
    unseen = drawn_models(uncertain(), 64, seed=100)
    costs = exact(unseen, designs["mean"].gain)
    assert np.mean(costs) == pytest.approx(np.mean(designs["mean"].costs), rel=0.02)
    assert np.max(costs) < 1.15 * np.max(designs["mean"].costs)


def test_it_drives_an_uncertain_fleet(designs):
    scenario = uncertain(duration=10.0)
    quakes = noise_earthquakes(scenario, 60)
    ours, _ = rollout(LinearFeedback(scenario, designs["mean"].gain), scenario, quakes)
    nominal = sampled_lqr(NOMINAL.discrete, NOMINAL.stage_cost).gain
    theirs, _ = rollout(LinearFeedback(scenario, nominal), scenario, quakes)
    # Paired on the same specimens and earthquakes.
    gain = np.array([b.cost - a.cost for a, b in zip(ours, theirs, strict=True)])
    assert np.mean(gain) > 3.0 * np.std(gain, ddof=1) / np.sqrt(len(gain))
    assert np.mean([m.cost for m in ours]) < 0.25


def test_what_does_not_fit_says_why(models):
    with pytest.raises(ParameterError, match="at least one"):
        multi_model_lqr(NOMINAL, [])
    with pytest.raises(ParameterError, match="states and period"):
        multi_model_lqr(NOMINAL, [make_scenario("linear", {"stories": 3})])
    with pytest.raises(ParameterError, match="aim"):
        multi_model_lqr(NOMINAL, models, "median")


def test_a_search_that_ends_unstable_is_no_design(monkeypatch):
    monkeypatch.setattr(multi_model, "HOMOTOPY_STEPS", 1)
    models = drawn_models(uncertain(DOUBTFUL), 16, seed=1)
    with pytest.raises(NumericalError, match="no gain found for the whole set"):
        multi_model_lqr(NOMINAL, models)


def test_of_one_model_with_a_weighed_position_it_is_the_preview_law_without_preview():
    model = make_scenario("linear", {"mass_ratio": 0.2, "highpass_frequency": 0.5})
    nominal = make_scenario("linear", {"mass_ratio": 0.8, "highpass_frequency": 0.5})
    known = preview_lqr(model.discrete, model.stage_cost, 0.0, position=0.03).gain
    design = multi_model_lqr(nominal, [model], position=0.03)
    # The minimum is flat: a relative gradient of 1e-7 leaves the gain its square root times curvature.
    scale = model.plant.state_scale
    assert np.max(np.abs(design.gain - known) * scale) < 1e-3 * np.max(np.abs(known * scale))
    errors = (exact([model], gain) for gain in (design.gain, known))
    assert next(errors) == pytest.approx(next(errors), rel=1e-4)


def test_a_weighed_position_needs_a_ground_that_stays():
    with pytest.raises(ScenarioError, match="highpass_frequency"):
        multi_model_lqr(NOMINAL, [NOMINAL], position=0.03)
