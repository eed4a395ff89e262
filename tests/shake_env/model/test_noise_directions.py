"""How many directions of a step's noise are drawn: what is kept is exact, what is left out is small."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from baselines.lqr.sampled import sampled_lqr, stationary_performance
from shake_env import FilteredNoise, Scenario, make_scenario
from shake_env.errors import ParameterError
from shake_env.model.discretization import MOST_DIRECTIONS, noise_covariance, noise_factor
from shake_env.model.random_numbers import episode_key
from shake_env.simulation.excitation import Excitation

CASES = [
    {"stories": 2},
    {"stories": 2, "highpass_frequency": 0.5},
    {"stories": 5, "highpass_frequency": 0.5},
    {"stories": 10},
]


def exogenous(discrete):
    """Return A, noise factor and the outputs y~ and f~_s of filter and reference, in scaled states."""
    layout = discrete.layout
    keep = np.r_[layout.ground, layout.reference]
    scale = discrete.plant.state_scale[keep]
    A = discrete.model.A[np.ix_(keep, keep)] * scale / scale[:, None]
    return A, discrete.noise[keep] / scale[:, None], discrete.model.C[2:][:, keep] * scale


def stationary(discrete):
    A, N, _ = exogenous(discrete)
    return solve_discrete_lyapunov(A, N @ N.T)


def spectrum(discrete, frequency):
    """Return the power (frequencies, 2) of target and reference shear, sampled at the physics step."""
    A, N, C = exogenous(discrete)
    z = np.exp(2j * np.pi * frequency * discrete.dt)[:, None, None]
    columns = np.broadcast_to(N.astype(complex), (len(frequency), *N.shape))
    response = C @ np.linalg.solve(z * np.eye(len(A)) - A, columns)
    return np.sum(np.abs(response) ** 2, axis=-1)


def loss(overrides, directions=2):
    """Return the largest error of the stationary covariance, each entry over both states' rms."""
    discrete = make_scenario("linear", overrides).discrete
    exact = stationary(replace(discrete, directions=None))
    rms = np.sqrt(np.diag(exact))
    kept = stationary(replace(discrete, directions=directions))
    return float(np.max(np.abs((kept - exact) / np.outer(rms, rms))))


@pytest.mark.parametrize("overrides", CASES)
def test_what_two_directions_share_with_the_filter_is_exact(overrides):
    """Rows and columns of x_w and x_w' in the covariance of a step; what is left is a covariance."""
    plant = make_scenario("linear", overrides).plant
    T = plant.state_scale
    exact = noise_covariance(plant.coupled.A, plant.coupled.B[:, 1:], 1e-3, T) / np.outer(T, T)
    factor = make_scenario("linear", overrides).discrete.noise / T[:, None]
    assert factor.shape[1] == 2
    left = exact - factor @ factor.T
    # Each over the rms of both states: those of x_w' and x_w lie three decades apart.
    rms = np.sqrt(np.diag(exact)[:2])
    assert np.max(np.abs(left[:2, :2] / np.outer(rms, rms))) < 1e-9
    assert np.max(np.abs(left[:2])) < 1e-15 * np.max(exact)
    assert np.min(np.linalg.eigvalsh(left)) > -1e-15 * np.max(exact)
    assert 1e-14 * np.max(exact) < np.max(left) < 1e-9 * np.max(exact)


@pytest.mark.parametrize("overrides", CASES)
def test_stationary_covariance_of_the_kept_directions(overrides):
    # A third direction is of order dt^4 beside the first, and 1e-8 would take 2e16 samples to be seen.
    two = loss(overrides)
    assert two < 1e-8
    assert loss(overrides, 3) < 1e-12
    assert loss(overrides, 1) > 1e4 * two  # what one of them would lose can be told apart
    assert loss(overrides | {"physics_step": 5e-4}) == pytest.approx(two / 16.0, rel=0.02)


@pytest.mark.parametrize("overrides", CASES)
def test_spectrum_of_the_kept_directions(overrides):
    """Up to Nyquist, against all directions."""
    kept = make_scenario("linear", overrides).discrete
    frequency = np.concatenate([np.geomspace(0.01, 25.0, 200), np.linspace(25.5, 500.0, 400)])
    found, exact = (spectrum(d, frequency) for d in (kept, replace(kept, directions=None)))
    error = np.abs(found / exact - 1.0)
    # x_w and x_w' make the target, to rounding. The high-pass has two more states: what is left of them
    # shows below 0.1 Hz, where of the target there is only what is folded down from above Nyquist.
    assert np.max(error[:, 0]) < (1e-6 if "highpass_frequency" in overrides else 1e-12)
    assert np.max(error[frequency > 0.2, 0]) < 1e-8
    # The shear's goes with (omega dt)^4; below 0.2 Hz it has nothing left either.
    assert np.max(error[(frequency > 0.2) & (frequency <= 25.0), 1]) < 1e-6
    assert np.max(np.abs(found - exact)[:, 1]) < 2e-9 * np.max(exact[:, 1])
    one = spectrum(replace(kept, directions=1), frequency)
    assert np.max(np.abs(one / exact - 1.0)[:, 0]) > 1e-4


@pytest.mark.parametrize("overrides", CASES)
def test_cost_of_lqr_under_the_kept_directions(overrides):
    scenario = make_scenario("linear", overrides)
    exact = replace(scenario.discrete, directions=None)
    design = sampled_lqr(scenario.discrete, scenario.stage_cost)
    # No gain depends on the noise.
    assert design.gain == pytest.approx(sampled_lqr(exact, scenario.stage_cost).gain, rel=1e-12)
    full = stationary_performance(exact, scenario.stage_cost, design.gain)
    assert design.analytic_cost == pytest.approx(full.cost, rel=1e-8)
    # The force error is a small difference of large forces, and loses most.
    assert design.performance.base_shear_rms == pytest.approx(full.base_shear_rms, rel=1e-7)
    one = stationary_performance(replace(exact, directions=1), scenario.stage_cost, design.gain)
    assert abs(one.cost / full.cost - 1.0) > 1e-5


def test_a_batch_of_covariances_is_factored_as_each_alone():
    plants = [make_scenario("linear", {"stories": 3, "mass_ratio": mu}).plant for mu in (0.1, 0.5, 1.0)]
    plants.append(make_scenario("linear", {"stories": 3, "storey_frequency": 5.0}).plant)
    scale = np.stack([p.state_scale for p in plants])
    covariance = np.stack(
        [noise_covariance(p.coupled.A, p.coupled.B[:, 1:], 1e-3, p.state_scale) for p in plants]
    )
    for directions in (1, 2, 4, MOST_DIRECTIONS, None):
        together = noise_factor(covariance, scale, directions, first=(1, 0))
        for ours, c, s in zip(together, covariance, scale, strict=True):
            alone = noise_factor(c, s, directions, first=(1, 0))
            width = alone.shape[1]
            assert np.array_equal(ours[:, :width], alone)
            assert not np.any(ours[:, width:])  # of a plant with fewer directions than another
    every = noise_factor(covariance[0], scale[0])
    padded = noise_factor(covariance[0], scale[0], 9)
    assert np.array_equal(padded[:, : every.shape[1]], every) and not np.any(padded[:, every.shape[1] :])


@pytest.mark.parametrize("highpass", [None, 0.5])
def test_a_seed_gives_the_same_earthquake_to_every_specimen(highpass):
    targets = []
    for overrides in ({"stories": 2}, {"stories": 10}, {"stories": 2, "storey_frequency": 9.0}):
        scenario = make_scenario("linear", {**overrides, "highpass_frequency": highpass})
        excitation = Excitation(scenario.discrete, 1)
        excitation.start([0], [FilteredNoise()], [episode_key(np.random.default_rng(1))])
        targets.append(np.array([excitation.advance().target[0].copy() for _ in range(400)]))
    for other in targets[1:]:
        assert np.max(np.abs(other - targets[0])) < 1e-9 * np.max(np.abs(targets[0]))


def test_all_directions_are_there_for_the_asking():
    scenario = make_scenario("linear", {"fields": {"noise_directions": None}})
    covariance = noise_covariance(
        scenario.plant.coupled.A, scenario.plant.coupled.B[:, 1:], 1e-3, scenario.plant.state_scale
    )
    found, T = scenario.discrete.noise, scenario.plant.state_scale
    assert found.shape[1] > make_scenario().discrete.noise.shape[1] == 2
    scaled = np.outer(T, T)
    assert np.max(np.abs(found @ found.T - covariance) / scaled) < 1e-14 * np.max(covariance / scaled)


@pytest.mark.parametrize("directions", [0, -1, MOST_DIRECTIONS + 1, 1.5, True, "all"])
def test_bad_directions_raise_a_parameter_error(directions):
    with pytest.raises(ParameterError, match=r"noise_directions = .*1 to 6, or None"):
        Scenario(noise_directions=directions)
    with pytest.raises(ParameterError, match=r"directions = .*1 to 6, or None"):
        replace(make_scenario().discrete, directions=directions)
