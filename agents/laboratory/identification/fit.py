"""The most probable parameters by Gauss-Newton steps, and the normal posterior around them (Laplace)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from agents.laboratory.identification.laplace import Laplace, laplace
from agents.laboratory.identification.likelihood import Likelihood
from agents.laboratory.identification.parameters import Prior, clip_delays, from_scale
from shake_env.model.parameters import FloatArray

DRAWS = 96  # of the prior, beside its mean: the search begins at the best of them
STARTS = 8  # at most
SAME = 1.0  # difference of two optima's log densities below which they are taken for one
STEP = 1e-3  # of a prior standard deviation, between the tables that slopes are taken from
ROUNDS = 6  # of discrepancy and fit, at most
FAR, NEARER = 0.3, 0.03  # share of discrepancy while the parameters are far off, and then
SETTLED = 0.1  # relative change of the shares that ends the rounds


@dataclass(frozen=True)
class Fit:
    """Mode and curvature of the posterior of logs' parameters, on their scales."""

    likelihood: Likelihood
    prior: Prior
    mode: FloatArray  # (p,)
    covariance: FloatArray  # (p, p) inverse of the curvature at the mode
    cost: float  # minus log posterior density at the mode, but a constant
    normal: Laplace  # the normal posterior that samples are drawn from
    seconds: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.prior.names

    @property
    def deviations(self) -> FloatArray:
        """Standard deviations (p,)."""
        deviations: FloatArray = np.sqrt(np.diag(self.covariance))
        return deviations

    @property
    def correlation(self) -> FloatArray:
        """Correlations (p, p)."""
        correlation: FloatArray = self.covariance / np.outer(self.deviations, self.deviations)
        return correlation

    @property
    def values(self) -> dict[str, float]:
        """Most probable values, SI."""
        return dict(zip(self.names, from_scale(self.names, self.mode).tolist(), strict=True))

    def draw(self, number: int, stream: np.random.Generator) -> FloatArray:
        """Return draws (number, p) of the normal posterior."""
        return self.normal.points(self.normal.draw(number, stream))

    def log_posterior(self, points: FloatArray) -> FloatArray:
        """Return the log posterior density (N,), but a constant, at N points (N, p)."""
        white = (points - self.prior.mean) @ self.prior.root.T
        density: FloatArray = self.likelihood.log_density(points) - 0.5 * np.sum(white**2, axis=1)
        return density


def fit(
    likelihood: Likelihood,
    prior: Prior,
    *,
    discrepancy: bool = True,
    seed: int = 0,
    on_progress: Callable[[float], None] = lambda share: None,
) -> Fit:
    """Return the most probable parameters and the normal posterior around them.

    Parameters
    ----------
    likelihood, prior
        Of the same parameters.
    discrepancy
        Whether what the model lacks is estimated; False trusts the model up to the sensors' noise.
    seed
        Of the draws that the search begins from.
    on_progress
        Told the share of the rounds done, 0 to 1.
    """
    begun = time.perf_counter()
    fitted = _search(likelihood, prior, _global(likelihood, prior, seed).mode)
    on_progress(1.0 / ROUNDS)
    current = likelihood.with_share(0.0)
    for number in range(2, ROUNDS + 1):
        last = current
        current = last.with_discrepancy(fitted.mode) if discrepancy else last
        if number > 2 or any(share.any() for share in current.shares):
            fitted = _search(current, prior, fitted.mode)
        on_progress(number / ROUNDS)
        change = max(
            float(np.max(np.abs(new - old) / np.maximum(old, 1e-4), initial=0.0))
            for new, old in zip(current.shares, last.shares, strict=True)
        )
        if change < SETTLED or not discrepancy:
            break
    normal = laplace(fitted.mode, fitted.covariance, prior, fitted.log_posterior, seed)
    on_progress(1.0)
    return replace(fitted, normal=normal, seconds=time.perf_counter() - begun)


def _global(likelihood: Likelihood, prior: Prior, seed: int) -> Fit:
    """Return the best optimum from several starts, with a small share of discrepancy.

    Logs of a weak shake have several optima: a light specimen on soft storeys answers the same below its
    first mode. Starts are the most probable draws of the prior, until the best was reached twice.
    """
    # A discrepancy that is estimated where the parameters are still off would explain that, and stay:
    # first the model is trusted, as far as it goes.
    draws = np.concatenate([prior.mean[None], prior.draw(DRAWS, np.random.default_rng(seed))])
    far, near = likelihood.with_share(FAR), likelihood.with_share(NEARER)
    white = (draws - prior.mean) @ prior.root.T
    order = np.argsort(0.5 * np.sum(white**2, axis=1) - far.log_density(draws))
    best: Fit | None = None
    for start in draws[order[:STARTS]]:
        other = _search(near, prior, _search(far, prior, start).mode)
        if best is not None and abs(other.cost - best.cost) < SAME:
            return min(best, other, key=lambda each: each.cost)
        best = other if best is None or other.cost < best.cost else best
    assert best is not None
    return best


def _search(likelihood: Likelihood, prior: Prior, start: FloatArray) -> Fit:
    """Return the fit from a start (p,), in coordinates in which the prior is standard normal."""
    factor, p = np.linalg.inv(prior.root), len(prior.names)
    steps = np.concatenate([np.zeros((1, p)), STEP * np.eye(p), -STEP * np.eye(p)])
    last: dict[bytes, tuple[FloatArray, FloatArray]] = {}

    def both(white: FloatArray) -> tuple[FloatArray, FloatArray]:
        key = white.tobytes()
        if key not in last:
            points = prior.mean + (white + steps) @ factor.T
            rows = likelihood.residuals(clip_delays(prior.names, points))
            slopes = (rows[1 : p + 1] - rows[p + 1 :]).T / (2.0 * STEP)
            last.clear()
            last[key] = np.concatenate([rows[0], white]), np.concatenate([slopes, np.eye(p)])
        return last[key]

    begin = prior.root @ (start - prior.mean)
    result = least_squares(
        lambda white: both(white)[0], begin, lambda white: both(white)[1],
        method="trf", ftol=1e-5, xtol=1e-6, gtol=1e-6, max_nfev=30,
    )  # fmt: skip
    slopes = both(result.x)[1]
    covariance = factor @ np.linalg.inv(slopes.T @ slopes) @ factor.T
    mode = clip_delays(prior.names, prior.mean + factor @ result.x)
    covariance = 0.5 * (covariance + covariance.T)
    normal = Laplace(prior.names, mode, np.zeros(p), covariance, False)
    return Fit(likelihood, prior, mode, covariance, float(result.cost), normal, 0.0)
