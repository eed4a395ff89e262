"""Random numbers by counting: published vectors, numpy against torch, and what normal numbers are."""

import math

import numpy as np
import pytest
from scipy.special import ndtr

from shake_env.model.random_numbers import GROUND, OFFSETS, SENSORS, episode_key, normals, threefry

# Random123's kat_vectors: threefry2x64, 13 rounds; counter, key, result.
KNOWN = [
    ((0, 0), (0, 0), (0xF167B032C3B480BD, 0xE91F9FEE4B7A6FB5)),
    ((2**64 - 1, 2**64 - 1), (2**64 - 1, 2**64 - 1), (0xCCDEC5C917A874B1, 0x4DF53ABCA26CEB01)),
    (
        (0x243F6A8885A308D3, 0x13198A2E03707344),
        (0xA4093822299F31D0, 0x082EFA98EC4E6C89),
        (0xC3AAC71561042993, 0x3FE7AE8801AFF316),
    ),
]


def words(*numbers):
    return np.array(numbers, dtype=np.uint64).view(np.int64)


@pytest.mark.parametrize(("counter", "key", "expected"), KNOWN)
def test_published_vectors(counter, key, expected):
    first, second = words(*counter)[:, None]
    found = threefry(words(*key)[None], first, second)
    assert tuple(int(word.view(np.uint64)[0]) for word in found) == expected


def test_numpy_and_torch_draw_the_same_numbers():
    torch = pytest.importorskip("torch")
    key, period = words(*range(1, 41)).reshape(20, 2), np.arange(20) * 10**12
    ours = normals(key, period, GROUND, 10)
    theirs = normals(torch.from_numpy(key), torch.from_numpy(period), GROUND, 10)
    np.testing.assert_array_equal(ours, theirs.numpy())


def test_a_number_depends_on_key_period_and_purpose_only():
    key = episode_key(np.random.default_rng(4))
    every = normals(key, np.arange(50), GROUND, 10)
    np.testing.assert_array_equal(normals(key[None], np.array([17]), GROUND, 10)[0], every[17])
    np.testing.assert_array_equal(normals(key, np.arange(50), GROUND, 6), every[:, :6])
    for other in (
        normals(key, np.arange(50), SENSORS, 10),
        normals(key, np.arange(50), OFFSETS, 10),
        normals(key ^ words(0, 1), np.arange(50), GROUND, 10),
    ):
        assert not np.any(other == every)


def test_they_are_standard_normal():
    """2e6 numbers of 100 seeds; distances of 4.5 standard errors leave one run in 7000 (30 figures)."""
    keys = np.stack([episode_key(np.random.default_rng(seed)) for seed in range(100)])
    z = normals(keys[:, None], np.arange(2000), GROUND, 10).reshape(100, -1)
    n = z.size
    for power, mean, variance in ((1, 0.0, 1.0), (2, 1.0, 2.0), (3, 0.0, 15.0), (4, 3.0, 96.0)):
        assert abs(np.mean(z**power) - mean) < 4.5 * math.sqrt(variance / n)
    for tail in (1.0, 2.0, 3.0, 4.0):
        share = ndtr(-tail)
        for count in ((z > tail).sum(), (z < -tail).sum()):
            assert abs(count - n * share) < 4.5 * math.sqrt(n * share) + 1.0
    for lag in (1, 2, 3, 4, 5, 10, 20):
        assert abs(np.mean(z[:, lag:] * z[:, :-lag])) < 4.5 / math.sqrt(n - 100 * lag)
    assert abs(np.mean(z[1:] * z[:-1])) < 4.5 / math.sqrt(n)  # neighbouring seeds
    assert abs(np.mean((z[1:] ** 2 - 1.0) * (z[:-1] ** 2 - 1.0))) < 4.5 * 2.0 / math.sqrt(n)
