"""The normal posterior: in values along a straight ridge, in logarithms where the prior rules."""

import numpy as np
import pytest

from agents.laboratory.identification.laplace import Laplace, laplace
from agents.laboratory.identification.parameters import Prior

NAMES = ("leakage", "table_damping")


def log_posterior_of(prior, sum_noise, first_noise):
    """Log density of points for a reading of the values' sum, 10, and one of the first, 2."""

    def log_posterior(points):
        values = np.exp(points)
        white = (points - prior.mean) @ prior.root.T
        errors = (values.sum(axis=1) - 10.0) / sum_noise, (values[:, 0] - 2.0) / first_noise
        return -0.5 * (errors[0] ** 2 + errors[1] ** 2 + np.sum(white**2, axis=1))

    return log_posterior


def mode_of(prior, sum_noise, first_noise):
    """Mode and inverse of the Gauss-Newton curvature."""
    point = prior.mean.copy()
    for _ in range(200):
        a, b = np.exp(point)
        errors = [(a + b - 10.0) / sum_noise, (a - 2.0) / first_noise]
        residual = np.append(errors, prior.root @ (point - prior.mean))
        rows = [[a / sum_noise, b / sum_noise], [a / first_noise, 0.0]]
        slopes = np.vstack([rows, prior.root])
        point = point - 0.5 * np.linalg.lstsq(slopes, residual, rcond=None)[0]
    return point, np.linalg.inv(slopes.T @ slopes)


def quadrature(log_posterior):
    """Mean and deviation of the first value, and of the sum, from a fine grid of both."""
    first, total = np.meshgrid(
        np.linspace(0.02, 4.0, 1601), np.linspace(9.94, 10.06, 601), indexing="ij"
    )
    points = np.log(np.stack([first.ravel(), (total - first).ravel()], axis=1))
    logs = (log_posterior(points) - points.sum(axis=1)).reshape(first.shape)  # density of values
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()

    def moments(values):
        mean = np.sum(weight * values)
        return mean, np.sqrt(np.sum(weight * (values - mean) ** 2))

    return moments(first), moments(total)


def test_along_a_ridge_of_values_draws_are_those_of_the_true_posterior():
    prior = Prior(NAMES, np.log([1.5, 6.0]), np.diag([1.0, 0.5]) ** 2)
    log_posterior = log_posterior_of(prior, 0.01, 0.4)
    mode, covariance = mode_of(prior, 0.01, 0.4)
    normal = laplace(mode, covariance, prior, log_posterior, seed=3)
    assert normal.by_value
    values = np.exp(normal.points(normal.draw(40000, np.random.default_rng(4))))
    (mean, deviation), (total, spread) = quadrature(log_posterior)
    # The prior is not normal in values: its third order is left out.
    assert values[:, 0].mean() == pytest.approx(mean, abs=0.1 * deviation)
    assert values[:, 0].std() == pytest.approx(deviation, rel=0.1)
    assert values.sum(axis=1).mean() == pytest.approx(total, abs=0.05 * spread)
    assert values.sum(axis=1).std() == pytest.approx(spread, rel=0.03)
    logarithmic = Laplace(NAMES, mode, np.zeros(2), covariance, False)
    curved = np.exp(logarithmic.points(logarithmic.draw(40000, np.random.default_rng(4))))
    assert curved.sum(axis=1).std() > 3.0 * spread


def test_where_the_prior_rules_it_is_the_prior():
    prior = Prior(NAMES, np.log([2.0, 8.0]), np.diag([1.0, 0.8]) ** 2)
    log_posterior = log_posterior_of(prior, 1e6, 1e6)
    normal = laplace(*mode_of(prior, 1e6, 1e6), prior, log_posterior, seed=3)
    assert not normal.by_value
    np.testing.assert_allclose(normal.covariance, prior.covariance, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(normal.points(np.zeros((1, 2)))[0], prior.mean, atol=1e-6)


def test_densities_change_with_the_coordinates_as_volumes_do():
    normal = Laplace(("leakage", "delay"), np.array([1.0, 0.5]), np.zeros(2), 0.04 * np.eye(2), True)
    z = np.array([[0.2, -0.1], [-0.3, 0.4]])
    step = 1e-6
    slopes = [
        (normal.points(z + step * unit) - normal.points(z - step * unit)) / (2.0 * step)
        for unit in np.eye(2)
    ]
    volume = np.abs(np.linalg.det(np.stack(slopes, axis=-1)))
    density = normal.density_of(lambda points: np.zeros(len(points)))(z)
    np.testing.assert_allclose(np.exp(density), volume, rtol=1e-8)


def test_values_and_delays_below_zero_are_never_drawn():
    normal = Laplace(("leakage", "delay"), np.array([1.0, 0.5]), np.zeros(2), np.eye(2), True)
    impossible = np.array([[-1.0, 0.0], [-1.5, 0.0], [0.0, -0.6]])
    assert not normal.possible(impossible).any()
    assert np.all(normal.density_of(lambda points: np.ones(len(points)))(impossible) == -np.inf)
    z = normal.draw(500, np.random.default_rng(0))
    assert normal.possible(z).all()
    assert len(np.unique(z[:, 1])) == 500  # none is moved to the bound
