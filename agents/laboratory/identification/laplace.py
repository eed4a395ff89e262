"""The normal posterior (Laplace), in the coordinates in which the posterior is closer to a normal one.

The plant's matrices are linear in masses, stiffnesses, dampings and leakage. Where a log tells only a
sum of two of them (the table's damping, and what its leakage damps), the likelihood is normal along a
straight ridge of values, which is curved in logarithms. Where the prior rules, logarithms are normal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from agents.laboratory.identification.parameters import LINEAR, Prior, clip_delays
from shake_env.model.parameters import FloatArray

TRIALS = 96  # draws that the two kinds of coordinates are judged by
LEAST_POSSIBLE = 0.2  # share of draws with values above zero, for values to be the coordinates
Density = Callable[[FloatArray], FloatArray]  # log density (N,) at N points (N, p)


@dataclass(frozen=True)
class Laplace:
    """A normal distribution of z, coordinates around the mode.

    With `by_value` z is a value over that of the mode, less 1; without, and for parameters that are
    estimated on a linear scale, the difference from the mode on the parameter's scale.
    """

    names: tuple[str, ...]
    mode: FloatArray  # (p,) on the parameters' scales
    mean: FloatArray  # (p,) of z
    covariance: FloatArray  # (p, p) of z
    by_value: bool

    @property
    def valued(self) -> FloatArray:
        """1 for the parameters (p,) whose z is a relative value, 0 for the others."""
        valued: FloatArray = np.array([self.by_value and n not in LINEAR for n in self.names], float)
        return valued

    def points(self, z: FloatArray) -> FloatArray:
        """Return points (N, p) on the parameters' scales; NaN where a value is not above zero."""
        with np.errstate(invalid="ignore", divide="ignore"):
            logarithms = np.where(z > -1.0, np.log1p(z), np.nan)
        points: FloatArray = self.mode + np.where(self.valued > 0.0, logarithms, z)
        return points

    def possible(self, z: FloatArray) -> FloatArray:
        """Return whether (N,) all values are above zero, and delays not below."""
        points = self.points(z)
        possible: FloatArray = np.all(points >= clip_delays(self.names, points), axis=1)
        return possible

    def density_of(self, log_posterior: Density) -> Density:
        """Return the log density of z for a log density of points; minus infinity where impossible."""

        def density(z: FloatArray) -> FloatArray:
            logs = np.full(len(z), -np.inf)
            possible = self.possible(z)
            if possible.any():
                points = self.points(z[possible])
                # dz = exp(point - mode) dpoint of a value
                logs[possible] = log_posterior(points) - (points - self.mode) @ self.valued
            return logs

        return density

    def distance(self, z: FloatArray) -> FloatArray:
        """Return the squared Mahalanobis distances (N,) from the mean."""
        white = np.linalg.solve(np.linalg.cholesky(self.covariance), (z - self.mean).T)
        distance: FloatArray = np.sum(white**2, axis=0)
        return distance

    def draw(self, number: int, stream: np.random.Generator) -> FloatArray:
        """Return possible draws (number, p) of z."""
        drawn = np.zeros((0, len(self.names)))
        while len(drawn) < number:
            z = self.free_draw(number, stream)
            drawn = np.concatenate([drawn, z[self.possible(z)]])
        return drawn[:number]

    def free_draw(self, number: int, stream: np.random.Generator) -> FloatArray:
        """Return draws (number, p) of z, possible or not."""
        factor = np.linalg.cholesky(self.covariance)
        return self.mean + stream.standard_normal((number, len(self.names))) @ factor.T


def laplace(
    mode: FloatArray, covariance: FloatArray, prior: Prior, log_posterior: Density, seed: int
) -> Laplace:
    """Return the normal posterior around a mode, in the better of both kinds of coordinates.

    Parameters
    ----------
    mode, covariance
        Most probable point (p,) on the parameters' scales; inverse (p, p) of the curvature there.
    prior
        Of the parameters.
    log_posterior
        Log density (N,) of points (N, p), but a constant.
    seed
        Of the draws that are weighed: those coordinates are taken in which the ratio of the true density
        to the normal one varies less.
    """
    logarithmic = Laplace(prior.names, mode, np.zeros_like(mode), covariance, False)
    stream = np.random.default_rng(seed)
    by_value = _by_value(mode, covariance, prior, stream)
    if by_value is None:
        return logarithmic
    spread = {}
    for each in (logarithmic, by_value):
        z = each.draw(TRIALS, stream)
        weights = each.density_of(log_posterior)(z) + 0.5 * each.distance(z)
        # Of quartiles: single draws far off the ridge would decide a standard deviation.
        spread[each.by_value] = np.subtract(*np.quantile(weights, [0.75, 0.25]))
    return by_value if spread[True] < spread[False] else logarithmic


def _by_value(
    mode: FloatArray, covariance: FloatArray, prior: Prior, stream: np.random.Generator
) -> Laplace | None:
    """Return the normal distribution of relative values; None where they are not told to be above zero.

    With z = exp(x - mode) - 1, minus the log density of z is that of x, plus the sum of log(1 + z). Its
    second order at z = 0: the likelihood's as in x (it is taken to be normal in z), the prior's less its
    slope at the mode, the sum's 1 and -1.
    """
    trial = Laplace(prior.names, mode, np.zeros_like(mode), covariance, True)
    slope = prior.root.T @ (prior.root @ (mode - prior.mean))
    curvature = np.linalg.inv(covariance) - np.diag(trial.valued * (1.0 + slope))
    try:
        np.linalg.cholesky(curvature)
    except np.linalg.LinAlgError:
        return None
    inverse = np.linalg.inv(curvature)
    inverse = 0.5 * (inverse + inverse.T)
    best = Laplace(prior.names, mode, -inverse @ trial.valued, inverse, True)
    z = (
        best.mean
        + np.random.default_rng(0).standard_normal((1000, len(mode))) @ np.linalg.cholesky(inverse).T
    )
    return best if np.mean(best.possible(z)) >= LEAST_POSSIBLE else None
