"""``python -m benchmarks.random_numbers``: the random numbers of tables against what they should be.

Moments, tails and a histogram against the normal distribution; correlations of a stream with itself, of
neighbouring seeds, of the episodes of a seed, and of keys that differ in one bit. Each figure is given
as its distance from the exact value in standard errors of that many independent normal numbers.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri
from scipy.stats import chi2

from shake_env.model.random_numbers import GROUND, episode_key, normals
from shake_env.simulation.streams import episode_stream

STREAMS, PERIODS, NUMBERS = 512, 128, 12  # of one portion
MOMENTS = {1: (0.0, 1.0), 2: (1.0, 2.0), 3: (0.0, 15.0), 4: (3.0, 96.0)}  # exact mean and variance
TAILS = (1.0, 2.0, 3.0, 3.5, 4.0, 4.5, 5.0)
LAGS = (1, 2, 3, 4, 5, 8, 11, 12, 24, 36)  # in numbers; a period has 12
BINS = 1024
EDGES = ndtri(np.arange(1, BINS) / BINS)


def keys_of(seeds: range, episode: int) -> np.ndarray:
    """Return the keys (seeds, 2) that tables with these seeds have in an episode."""
    keys = []
    for seed in seeds:
        generator = np.random.default_rng(seed)
        for _ in range(episode):
            episode_stream(generator)
        keys.append(episode_key(episode_stream(generator)))
    return np.stack(keys)


class Battery:
    """Sums over portions of numbers (streams, length)."""

    def __init__(self) -> None:
        self.count, self.portions = 0, 0
        self.powers = dict.fromkeys(MOMENTS, 0.0)
        self.tails = dict.fromkeys((side * t for t in TAILS for side in (-1, 1)), 0)
        self.bins = np.zeros(BINS, dtype=np.int64)
        self.products: dict[str, list[float]] = {}
        self.largest = 0.0

    def add(self, z: np.ndarray, others: dict[str, np.ndarray]) -> None:
        """Count a portion, and its products with others of the same shape."""
        flat = z.ravel()
        self.count += flat.size
        self.portions += 1
        self.largest = max(self.largest, float(np.abs(flat).max()))
        for power in MOMENTS:
            self.powers[power] += float((flat**power).sum())
        for tail in self.tails:
            self.tails[tail] += int((flat > tail).sum() if tail > 0 else (flat < tail).sum())
        self.bins += np.bincount(np.searchsorted(EDGES, flat), minlength=BINS)
        for lag in LAGS:
            self._product(f"lag {lag}", z[:, lag:], z[:, :-lag])
        for name, other in others.items():
            self._product(name, z, other)

    def _product(self, name: str, x: np.ndarray, y: np.ndarray) -> None:
        held = self.products.setdefault(name, [0.0, 0.0, 0.0])
        held[0] += float(np.vdot(x, y))
        held[1] += float(np.vdot(x * x - 1.0, y * y - 1.0))  # dependence that correlation does not see
        held[2] += x.size

    def figures(self) -> dict[str, Any]:
        """Return every figure in standard errors."""
        n = self.count
        distances = {
            f"moment {power}": (self.powers[power] / n - mean) / math.sqrt(variance / n)
            for power, (mean, variance) in MOMENTS.items()
        }
        for tail, counts in self.tails.items():
            share = float(ndtr(-abs(tail)))
            distances[f"beyond {tail:+.1f}"] = (counts - n * share) / math.sqrt(
                n * share * (1.0 - share)
            )
        for name, (plain, squared, count) in self.products.items():
            distances[f"correlation, {name}"] = plain / math.sqrt(count)
            distances[f"correlation of squares, {name}"] = squared / math.sqrt(4.0 * count)
        statistic = float(((self.bins - n / BINS) ** 2 / (n / BINS)).sum())
        largest = max(abs(each) for each in distances.values())
        # Of so many standard normal distances, the share of samples whose largest is above this one.
        every = 1.0 - (1.0 - 2.0 * float(ndtr(-largest))) ** len(distances)
        return {
            "numbers": n,
            "largest number": self.largest,
            "distances [standard errors]": distances,
            "largest distance": largest,
            "probability of a larger one": every,
            "histogram, probability of a larger chi-square": float(chi2.sf(statistic, BINS - 1)),
        }


def battery(numbers: float) -> dict[str, Any]:
    """Return the figures of at least so many numbers."""
    result, seed = Battery(), 0
    keys = keys_of(range(STREAMS + 1), 0)
    episodes = keys_of(range(STREAMS), 1)
    first = 0
    while result.count < numbers:
        if first >= 64 * PERIODS:  # other seeds now and then, as an episode has a few thousand periods
            seed, first = seed + STREAMS, 0
            keys = keys_of(range(seed, seed + STREAMS + 1), 0)
            episodes = keys_of(range(seed, seed + STREAMS), 1)
        period = np.arange(first, first + PERIODS)
        every = _drawn(keys, period)
        z, neighbour = every[:-1], every[1:]
        others = {"neighbouring seeds": neighbour}
        if result.portions % 8 == 0:
            others["next episode"] = _drawn(episodes, period)
            others["key of one other bit"] = _drawn(keys[:-1] ^ np.array([1, 0]), period)
            others["sensors"] = normals(keys[:-1, None], period, 1 << 32, NUMBERS).reshape(z.shape)
        result.add(z, others)
        first += PERIODS
    return result.figures()


def _drawn(keys: np.ndarray, period: np.ndarray) -> np.ndarray:
    return normals(keys[:, None], period, GROUND, NUMBERS).reshape(len(keys), -1)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--numbers", type=float, default=1e9, help="how many are drawn")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    asked = parser.parse_args()
    figures = battery(asked.numbers)
    text = json.dumps(figures, indent=1)
    if asked.json:
        asked.json.write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
