"""Compiled periods of the laws behind estimators equal those in numpy, in any batch."""

import numpy as np
import pytest

from agents.learning.law_batch import LawBatch
from agents.policies.estimated_law import EstimatedLaw
from shake_env import make_scenario
from shake_env.scenario.limits import OBSERVATION_BOUND

pytest.importorskip("numba")
LANES = 37  # more than a block, and no whole number of them


@pytest.fixture(scope="module", params=["laboratory", "field", "linear"])
def law(request):
    delayed = {"fields": {"delay": 2.5, "sensing.preview": 0.1}} if request.param == "linear" else {}
    return EstimatedLaw.from_name("lqg-dac", make_scenario(request.param, delayed))


def batches(law, lanes):
    compiled, plain = LawBatch(law, lanes), LawBatch(law, lanes)
    assert compiled._compiled is not None
    plain._compiled = None
    return compiled, plain


def test_compiled_periods_are_those_in_numpy(law):
    """Over the ages at which the gain changes, with episodes that begin in between."""
    rng, n = np.random.default_rng(0), law.observation_size
    pair = batches(law, LANES)
    age = rng.integers(0, 500, LANES)
    shown = [np.zeros((LANES, n + law.shown), np.float32) for _ in pair]
    memory = rng.normal(size=(LANES, law.size))
    for each in pair:
        each.memory = memory
    for t in range(12):
        seen = rng.normal(size=(LANES, n)).astype(np.float32)
        lanes = None if t % 3 else np.array([5, 0, 36])
        kinds = (np.float32, np.float64)[t % 2]
        correction = rng.normal(size=(LANES, 1)).astype(kinds)
        actions = [each.act(correction, 0.3, part) for each, part in zip(pair, shown, strict=True)]
        np.testing.assert_allclose(*actions, rtol=1e-5, atol=1e-6)
        age = np.where(rng.random(LANES) < 0.1, 0, age + 1)
        for each, part, action in zip(pair, shown, actions, strict=True):
            action[:] = actions[0]  # so that single precision does not add up
            each.show(seen, age, part, lanes=lanes, stepped=t > 0)
        size = np.abs(pair[1]._known).max()
        np.testing.assert_allclose(pair[0]._known / size, pair[1]._known / size, rtol=0, atol=1e-13)
        np.testing.assert_allclose(pair[0].memory, pair[1].memory, rtol=1e-12, atol=1e-12 * size)
        np.testing.assert_allclose(*shown, rtol=1e-5, atol=1e-5)
        looked = np.arange(LANES) if lanes is None else lanes
        assert (shown[0][looked, :n] == seen[looked]).all()


def test_a_table_shows_the_same_bits_in_any_batch(law):
    rng, n = np.random.default_rng(1), law.observation_size
    compiled, _ = batches(law, LANES)
    seen, age = rng.normal(size=(LANES, n)).astype(np.float32), rng.integers(0, 500, LANES)
    memory = rng.normal(size=(LANES, law.size))
    shown = np.zeros((LANES, n + law.shown), np.float32)
    compiled.memory = memory
    compiled.show(seen, age, shown)
    for lane in (0, 31, 36):
        alone, _ = batches(law, 1)
        row = np.zeros((1, n + law.shown), np.float32)
        alone.memory = memory[lane : lane + 1]
        alone.show(seen[lane : lane + 1], age[lane : lane + 1], row)
        assert (row[0] == shown[lane]).all()
        assert (alone._known[0] == compiled._known[lane]).all()


def test_a_diverged_table_shows_bounded_numbers_and_its_next_episode_none_of_it(law):
    pair, n = batches(law, 3), law.observation_size
    seen, age = np.ones((3, n), np.float32), np.array([7, 8, 9])
    for each in pair:
        shown = np.zeros((3, n + law.shown), np.float32)
        memory = np.zeros((3, law.size))
        memory[0], memory[1] = np.nan, 1e300
        each.memory = memory
        each.show(seen, age, shown)
        believed = shown[:, n:]
        assert np.isfinite(believed).all() and (np.abs(believed) <= OBSERVATION_BOUND).all()
        assert (np.abs(believed[1]) == OBSERVATION_BOUND).any()
        each.show(seen, np.zeros(3, dtype=int), shown)
        assert (shown[0] == shown[1]).all() and (shown[0] == shown[2]).all()
