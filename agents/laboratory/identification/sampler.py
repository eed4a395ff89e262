"""Samples of the posterior by an ensemble of walkers (emcee), with R-hat and effective sample sizes.

Walkers are lanes of one batch of simulated tables, in the coordinates of the normal posterior. They
begin at draws of it, weighted by the true density. Most moves are independent draws around it, with the
tails of Student's t, accepted by Metropolis and Hastings' rule; the others are differences of walkers
(ter Braak and Vrugt 2008), which find what is not normal.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from agents.laboratory.identification.fit import Fit
from agents.laboratory.identification.laplace import Density, Laplace
from agents.laboratory.identification.posterior import Posterior
from agents.laboratory.logs.hdf5_file import import_library
from shake_env.errors import ParameterError
from shake_env.model.parameters import FloatArray

WALKERS_A_PARAMETER = 4
FREEDOM = 8.0  # degrees of Student's t
INDEPENDENT = 0.7  # share of the moves
DRAWS = 4  # of the normal posterior for each walker, of which one is taken
FIRST = 0.2  # of the time, whose samples are left out
LEAST, MOST = 20, 5000  # moves of each walker
LONGEST = 7 * 86400.0  # [s]
LEAST_SAMPLES = 2  # of a posterior, whose covariance is the next prior's
WIDER = 1.5  # of the normal posterior's deviations, that the walkers' first draws are taken from


def require_sampler(seconds: float, moves: int | None) -> None:
    """Raise ParameterError where a time [s] or a number of moves is outside its range."""
    if not 0.0 <= seconds <= LONGEST:
        raise ParameterError("sampler_seconds", seconds, f"must be at least 0, at most {LONGEST:g}")
    if moves is not None and not LEAST <= moves <= MOST:
        raise ParameterError("sampler_moves", moves, f"must be {LEAST} to {MOST}")


def sample_posterior(
    fit: Fit,
    *,
    samples: int = 2000,
    seconds: float = 120.0,
    moves: int | None = None,
    seed: int = 0,
    on_progress: Callable[[float], None] = lambda share: None,
) -> Posterior:
    """Return samples of the posterior that a fit found the mode of.

    Parameters
    ----------
    fit
        Mode, covariance, likelihood and prior.
    samples
        Number to keep, at most.
    seconds
        Time to spend, where `moves` is None; the number of samples that count then depends on the
        machine.
    moves
        Moves of each walker; the same seed then gives the same samples.
    seed
        Of the sampler.
    on_progress
        Told the share of the work done, 0 to 1.

    Raises
    ------
    LogError
        If emcee or arviz-stats is missing.
    ParameterError
        If `seconds` or `moves` is outside its range.
    """
    require_sampler(seconds, moves)
    emcee, statistics = import_library("emcee"), import_library("arviz_stats.base")
    begun, p = time.perf_counter(), len(fit.names)
    walkers = max(2 * p + 2, WALKERS_A_PARAMETER * p)
    walkers += walkers % 2
    stream = np.random.default_rng(seed)
    density = fit.normal.density_of(fit.log_posterior)
    start = _start(fit.normal, density, walkers, stream)
    ensemble = emcee.EnsembleSampler(
        walkers,
        p,
        density,
        vectorize=True,
        moves=[
            (emcee.moves.MHMove(_independent(fit.normal)), INDEPENDENT),
            (emcee.moves.DEMove(), 1.0 - INDEPENDENT),
        ],
    )
    ensemble._random = np.random.RandomState(int(stream.integers(2**31)))
    count, done = MOST if moves is None else moves, 0
    for _ in ensemble.sample(start, iterations=count, skip_initial_state_check=True):
        done += 1
        spent = (time.perf_counter() - begun) / seconds if moves is None else done / count
        on_progress(min(spent, 1.0))
        if moves is None and spent >= 1.0 and done >= LEAST:
            break
    chain = ensemble.get_chain()[int(FIRST * done) :]  # (moves, walkers, p)
    by_walker = np.swapaxes(chain, 0, 1)
    r_hat, effective = [], []
    for i in range(p):
        values = by_walker[:, :, i]
        r_hat.append(float(statistics.array_stats.rhat(values, chain_axis=0, draw_axis=1)))
        effective.append(float(statistics.array_stats.ess(values, chain_axis=0, draw_axis=1)))
    flat = chain.reshape(-1, p)
    picked = np.linspace(0, len(flat) - 1, min(samples, len(flat))).astype(int)
    on_progress(1.0)
    return replace(
        Posterior.from_fit(fit, 1, seed),
        points=fit.normal.points(flat[picked]),
        method="ensemble",
        r_hat=tuple(r_hat),
        effective=tuple(effective),
    )


def _independent(normal: Laplace) -> Callable[[FloatArray, Any], tuple[FloatArray, FloatArray]]:
    """Return a proposal of Student's t around the mean, with its part in the rule of acceptance."""
    p, factor = len(normal.names), np.linalg.cholesky(normal.covariance)

    def log_density(z: FloatArray) -> FloatArray:
        logs: FloatArray = -0.5 * (FREEDOM + p) * np.log1p(normal.distance(z) / FREEDOM)
        return logs

    def propose(z: FloatArray, random: Any) -> tuple[FloatArray, FloatArray]:
        step = random.standard_normal(z.shape)
        heavy = np.sqrt(FREEDOM / random.chisquare(FREEDOM, size=len(z)))
        proposed = normal.mean + (heavy[:, None] * step) @ factor.T
        return proposed, log_density(z) - log_density(proposed)

    return propose


def _start(normal: Laplace, density: Density, walkers: int, stream: np.random.Generator) -> FloatArray:
    """Return the walkers' first z (walkers, p): draws of a wide normal, by their weights."""
    wide = replace(normal, covariance=WIDER**2 * normal.covariance)
    draws = wide.draw(DRAWS * walkers, stream)
    weight = density(draws) + 0.5 * wide.distance(draws)
    # Without putting back: the largest of weights with Gumbel noise (Efraimidis and Spirakis, 2006).
    order = np.argsort(weight + stream.gumbel(size=len(weight)))[::-1]
    start: FloatArray = draws[order[:walkers]]
    return start
