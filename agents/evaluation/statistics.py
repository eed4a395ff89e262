"""Statistics of costs over training seeds and earthquakes, with bootstrap intervals.

Estimates and comparison follow Agarwal et al., Deep Reinforcement Learning at the Edge of the
Statistical Precipice, NeurIPS 2021: interquartile mean, probability of improvement, stratified
bootstrap. There tasks are fixed and runs are drawn. Here earthquakes (with the specimens that they draw)
are a sample too, and every seed meets the same ones: rows and columns are both drawn anew and
independently, which is the two-way bootstrap of crossed samples (Owen, The pigeonhole bootstrap, Annals
of Applied Statistics 2007; it errs on the wide side). With one row it is the usual bootstrap over
earthquakes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap

from shake_env.errors import ParameterError
from shake_env.model.parameters import FloatArray
from shake_env.simulation.metrics import EpisodeMetrics

Scores = NDArray[np.float64]  # (seeds, earthquakes)
Statistic = Callable[..., float]

RESAMPLES = 2000
LEVEL = 0.95


@dataclass(frozen=True)
class Estimate:
    """A statistic with its interval."""

    value: float
    low: float
    high: float


def interquartile_mean(scores: Scores) -> float:
    """Return the mean of the middle half of all scores, whatever their row.

    A quarter of the number is cut from each end, rounded down, as `scipy.stats.trim_mean` does.
    """
    flat = np.sort(scores, axis=None)
    cut = flat.size // 4
    return float(flat[cut : flat.size - cut].mean())


def worst_mean(scores: Scores, share: float = 0.05) -> float:
    """Return the mean of the highest `share` of all scores (conditional value at risk of a cost).

    Of the number, rounded up, so that there is always one.
    """
    flat = np.sort(scores, axis=None)
    return float(flat[-int(np.ceil(share * flat.size - 1e-9)) :].mean())


def ratio_of_means(scores: Scores, reference: Scores) -> float:
    """Return the mean of all scores over that of the reference's."""
    return float(scores.mean() / reference.mean())


def probability_of_improvement(scores: Scores, reference: Scores) -> float:
    """Return how probable it is that a run costs less than the reference's on the same earthquake.

    The mean over earthquakes of the Mann-Whitney statistic of both columns; a tie counts half.

    Parameters
    ----------
    scores, reference
        (seeds, earthquakes) costs; the numbers of seeds may differ.
    """
    difference = scores[:, None, :] - reference[None, :, :]
    return float(np.mean((difference < 0.0) + 0.5 * (difference == 0.0)))


def estimate(
    statistic: Statistic,
    *samples: Scores,
    resamples: int = RESAMPLES,
    level: float = LEVEL,
    seed: int = 0,
) -> Estimate:
    """Return a statistic of scores and its percentile interval from the two-way bootstrap.

    Parameters
    ----------
    statistic
        Function of the samples.
    samples
        (seeds, earthquakes) each, of the same earthquakes: a draw of earthquakes is one for all of
        them, so that differences are paired. Seeds are each sample's own.
    resamples
        Number of draws.
    level
        Probability that the interval is to have.
    seed
        Of the draws.

    Raises
    ------
    ParameterError
        If a sample is no table of finite numbers, or the numbers of earthquakes differ.
    """
    columns = samples[0].shape[-1]
    for sample in samples:
        if sample.ndim != 2 or sample.shape[1] != columns or not sample.size:
            raise ParameterError("scores shape", sample.shape, f"must be (seeds, {columns})")
        if not np.isfinite(sample).all():
            raise ParameterError("scores", "nan or inf", "must be finite: leave out what is not defined")
    value = statistic(*samples)
    if columns < 2 and all(len(sample) < 2 for sample in samples):
        return Estimate(value, value, value)  # a single number has no spread to draw from
    rng = np.random.default_rng(seed)
    drawn = np.empty(resamples)
    for i in range(resamples):
        quakes = rng.integers(columns, size=columns)
        rows = [rng.integers(len(sample), size=len(sample)) for sample in samples]
        drawn[i] = statistic(
            *(sample[row[:, None], quakes] for sample, row in zip(samples, rows, strict=True))
        )
    tail = 50.0 * (1.0 - level)
    low, high = np.percentile(drawn, [tail, 100.0 - tail])
    return Estimate(value, float(low), float(high))


def cost_ratio(
    rows: Sequence[EpisodeMetrics], others: Sequence[EpisodeMetrics]
) -> tuple[float, float, float]:
    """Return summed cost over the others' on the same earthquakes, with its 95 % interval."""
    cost, base = np.asarray([r.cost for r in rows]), np.asarray([r.cost for r in others])
    return (float(_ratio(cost, base)), *_interval(cost, base))


def _mean(values: Sequence[float]) -> float:
    known = np.asarray(values)[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")


def _ratio(cost: NDArray[np.float64], base: NDArray[np.float64], axis: int = -1) -> Any:
    return np.sum(cost, axis=axis) / np.sum(base, axis=axis)


def _interval(cost: NDArray[np.float64], base: NDArray[np.float64]) -> tuple[float, float]:
    """Return the 95 % percentile-bootstrap interval of the cost ratio; NaN of one earthquake.

    Copies of one earthquake are one: their costs have no spread to draw from.
    """
    if len(np.unique(np.stack([cost, base]), axis=1).T) < 2:
        return float("nan"), float("nan")
    if np.array_equal(cost, base):
        return 1.0, 1.0
    result = bootstrap(
        (cost, base), _ratio, paired=True, vectorized=True, method="percentile", n_resamples=9999,
        rng=np.random.default_rng(0),
    )  # fmt: skip
    return float(result.confidence_interval.low), float(result.confidence_interval.high)


def mean_interval(values: FloatArray) -> tuple[float, float, float]:
    """Return the mean of (n,) values with its 95 % bootstrap interval."""
    mean = float(np.mean(values))
    if len(values) < 2 or np.ptp(values) <= 1e-12 * abs(mean):
        return mean, mean, mean
    interval = bootstrap(
        (values,), np.mean, method="percentile", n_resamples=1999, rng=np.random.default_rng(0)
    ).confidence_interval
    return mean, float(interval.low), float(interval.high)
