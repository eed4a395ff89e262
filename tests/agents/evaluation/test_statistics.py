"""Statistics over seeds and earthquakes: by hand, against scipy, and against the truth they estimate."""

import numpy as np
import pytest
from scipy.stats import bootstrap, mannwhitneyu, trim_mean

from agents.evaluation.statistics import (
    estimate,
    interquartile_mean,
    probability_of_improvement,
    ratio_of_means,
    worst_mean,
)
from shake_env.errors import ParameterError


def mean(scores):
    return float(scores.mean())


def test_the_interquartile_mean_by_hand():
    scores = np.array([[1.0, 100.0, 3.0, 2.0], [4.0, 5.0, -50.0, 6.0]])
    assert interquartile_mean(scores) == (2.0 + 3.0 + 4.0 + 5.0) / 4.0
    assert interquartile_mean(np.array([[1.0, 2.0, 9.0]])) == 4.0  # a quarter of three is none


@pytest.mark.parametrize("number", [1, 4, 7, 30])
def test_the_interquartile_mean_is_scipys(number):
    scores = np.random.default_rng(number).standard_cauchy((3, number))
    assert interquartile_mean(scores) == pytest.approx(trim_mean(scores, 0.25, axis=None))


def test_the_worst_share_by_hand():
    scores = np.arange(40.0).reshape(2, 20)
    assert worst_mean(scores) == (38.0 + 39.0) / 2.0
    assert worst_mean(scores[:, :3]) == 22.0  # a twentieth of six is one
    assert worst_mean(scores, 0.5) == np.arange(20.0, 40.0).mean()


def test_the_probability_of_improvement_by_hand():
    scores = np.array([[1.0, 5.0], [3.0, 2.0]])
    reference = np.array([[2.0, 2.0]])
    # First earthquake: 1 < 2, 3 > 2; second: 5 > 2, 2 = 2.
    assert probability_of_improvement(scores, reference) == (1.0 + 0.0 + 0.0 + 0.5) / 4.0
    assert probability_of_improvement(reference, reference) == 0.5


def test_the_probability_of_improvement_is_mann_and_whitneys():
    rng = np.random.default_rng(0)
    scores, reference = rng.normal(size=(7, 3)), rng.normal(0.3, 1.0, (5, 3))
    expected = [mannwhitneyu(reference[:, e], scores[:, e]).statistic / 35.0 for e in range(3)]
    assert probability_of_improvement(scores, reference) == pytest.approx(np.mean(expected))


def test_intervals_over_earthquakes_are_scipys():
    rng = np.random.default_rng(1)
    cost, base = rng.gamma(4.0, 1.2, (1, 60)), rng.gamma(4.0, 1.0, (1, 60))

    def ratio(a, b, axis=-1):
        return a.sum(axis=axis) / b.sum(axis=axis)

    ours = estimate(ratio_of_means, cost, base, resamples=20_000)
    theirs = bootstrap(
        (cost[0], base[0]), ratio, paired=True, vectorized=True, method="percentile",
        n_resamples=20_000, rng=np.random.default_rng(2),
    ).confidence_interval  # fmt: skip
    # Ends are 2.5 % quantiles of 20 000 draws: their own standard error is about 2 % of the width.
    width = theirs.high - theirs.low
    assert ours.low == pytest.approx(theirs.low, abs=0.06 * width)
    assert ours.high == pytest.approx(theirs.high, abs=0.06 * width)
    assert ours.value == pytest.approx(ratio(cost[0], base[0]))


def test_intervals_over_seeds_are_scipys():
    scores = np.random.default_rng(3).normal(size=(25, 1))
    ours = estimate(mean, scores, resamples=20_000)
    theirs = bootstrap(
        (scores[:, 0],), np.mean, method="percentile", n_resamples=20_000, rng=np.random.default_rng(4)
    ).confidence_interval
    width = theirs.high - theirs.low
    assert ours.low == pytest.approx(theirs.low, abs=0.06 * width)
    assert ours.high == pytest.approx(theirs.high, abs=0.06 * width)


def test_the_interval_covers_the_mean_of_crossed_effects():
    # score = seed's effect + earthquake's effect + noise, of mean 0: an interval over either alone
    # covers too seldom. 100 trials of coverage 0.95 have a standard error of 0.022, and percentile
    # intervals of 8 seeds come out somewhat narrow.
    rng = np.random.default_rng(5)
    covered = {"both": 0, "seeds": 0, "earthquakes": 0}
    for _ in range(100):
        scores = rng.normal(size=(8, 1)) + rng.normal(size=(1, 12)) + 0.5 * rng.normal(size=(8, 12))
        for name, sample in {
            "both": scores,
            "seeds": scores.mean(axis=1, keepdims=True),
            "earthquakes": scores.mean(axis=0, keepdims=True),
        }.items():
            found = estimate(mean, sample, resamples=200)
            covered[name] += found.low < 0.0 < found.high
    assert covered["both"] >= 0.86 * 100
    assert covered["seeds"] < covered["both"]
    assert covered["earthquakes"] < covered["both"]


def test_pairs_stay_together():
    base = np.random.default_rng(6).gamma(1.0, 1.0, (1, 20))
    found = estimate(ratio_of_means, 1.5 * base, base)
    assert found.low == pytest.approx(1.5) == found.high


def test_a_single_number_is_its_own_interval():
    assert estimate(mean, np.array([[3.0]])).low == 3.0


@pytest.mark.parametrize(
    "bad", [np.zeros(3), np.zeros((2, 4)), np.array([[1.0, np.nan, 0.0]]), np.zeros((0, 3))]
)
def test_bad_tables_are_refused(bad):
    with pytest.raises(ParameterError, match="scores"):
        estimate(lambda a, b: 0.0, np.zeros((1, 3)), bad)
