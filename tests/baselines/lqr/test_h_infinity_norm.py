"""The H-infinity norm against theory, a dense frequency grid and SLICOT's AB13DD."""

import numpy as np
import pytest

from baselines.lqr.h_infinity import GeneralizedPlant, robust_feedback
from baselines.lqr.h_infinity_norm import discrete_h_infinity_norm
from shake_env import make_scenario
from shake_env.errors import NumericalError


def test_a_first_order_lag_has_its_largest_gain_at_rest():
    a, b, c, d = 0.8, 0.3, 2.0, 0.5
    found = discrete_h_infinity_norm(np.array([[a]]), np.array([[b]]), np.array([[c]]), np.array([[d]]))
    assert found == pytest.approx(c * b / (1.0 - a) + d, rel=1e-12)


def test_a_lightly_damped_resonance_is_found_between_the_points_of_a_grid():
    # z^2 - 2 r cos(phi) z + r^2 with b z^0: the gain's largest value has a closed form in cos(theta).
    r, phi = 0.9999, 0.7123456
    A = np.array([[2.0 * r * np.cos(phi), -(r**2)], [1.0, 0.0]])
    B, C, D = np.array([[1.0], [0.0]]), np.array([[0.0, 1.0]]), np.zeros((1, 1))
    cosine = np.cos(phi) * (1.0 + r**2) / (2.0 * r)
    z = np.exp(1j * np.arccos(cosine))
    peak = 1.0 / abs(z**2 - 2.0 * r * np.cos(phi) * z + r**2)
    assert discrete_h_infinity_norm(A, B, C, D) == pytest.approx(peak, rel=1e-7)


@pytest.mark.parametrize("seed", range(8))
def test_random_systems_against_a_dense_grid(seed):
    rng = np.random.default_rng(seed)
    n, m, p = rng.integers(1, 9), rng.integers(1, 4), rng.integers(1, 4)
    A = rng.normal(size=(n, n))
    A *= rng.uniform(0.5, 0.98) / np.max(np.abs(np.linalg.eigvals(A)))
    B, C, D = rng.normal(size=(n, m)), rng.normal(size=(p, n)), rng.normal(size=(p, m))
    angles = np.linspace(0.0, np.pi, 20_001)
    z = np.exp(1j * angles)[:, None, None]
    gains = np.linalg.norm(C @ np.linalg.solve(z * np.eye(n) - A, B + 0j * z) + D, 2, axis=(1, 2))
    found = discrete_h_infinity_norm(A, B, C, D)
    assert found >= gains.max() * (1.0 - 1e-9)
    assert found == pytest.approx(gains.max(), rel=1e-4)  # the grid misses a peak by its step squared


def test_scaling_the_system_scales_the_norm():
    rng = np.random.default_rng(3)
    A = 0.2 * rng.normal(size=(5, 5))
    B, C, D = rng.normal(size=(5, 2)), rng.normal(size=(3, 5)), rng.normal(size=(3, 2))
    one = discrete_h_infinity_norm(A, B, C, D)
    assert discrete_h_infinity_norm(A, B, 7.0 * C, 7.0 * D) == pytest.approx(7.0 * one, rel=1e-9)
    assert discrete_h_infinity_norm(A.T, C.T, B.T, D.T) == pytest.approx(one, rel=1e-9)


def test_feed_through_alone():
    D = np.array([[3.0, 0.0], [0.0, -4.0]])
    assert discrete_h_infinity_norm(
        np.zeros((1, 1)), np.zeros((1, 2)), np.zeros((2, 1)), D
    ) == pytest.approx(4.0)


def test_an_unstable_system_has_none():
    one = np.ones((1, 1))
    with pytest.raises(NumericalError, match="pole radius"):
        discrete_h_infinity_norm(1.01 * one, one, one, one)


# Measured with SLICOT's AB13DD (slycot 0.7.1) on the law of each uncertainty, linear, two storeys.
AB13DD = {0.05: 0.029433493937358692, 0.3: 0.13721622075491, 0.9: 0.23749890174944838}


@pytest.mark.parametrize("rho", sorted(AB13DD))
def test_the_gain_of_a_robust_design_against_slicot(rho):
    assert robust_feedback(make_scenario("linear"), rho).gamma == pytest.approx(AB13DD[rho], rel=1e-6)


def test_the_gain_of_a_game_law_stays_below_the_level_that_it_was_designed_for():
    plant = GeneralizedPlant.from_scenario(make_scenario("linear"))
    K, _ = plant.law(0.5, 1.0)
    assert plant.force_gain(K, 0.5) < 1.0
