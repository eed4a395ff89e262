"""Signal and noise of score-function gradients beside the exact gradient."""

import numpy as np
import pytest

from agents.studies.gradient_noise import NoiseSettings, advantages, gradient_noise
from shake_env import make_scenario


def test_advantages_are_those_of_their_definition():
    rng = np.random.default_rng(0)
    reward, values = rng.normal(size=(2, 2, 6, 3))
    gamma, smoothing = 0.9, 0.8
    ours = advantages(reward, values, gamma, smoothing)
    following = np.concatenate([values[:, 1:], np.zeros((2, 1, 3))], axis=1)
    errors = reward + gamma * following - values
    for t in range(6):
        weights = (gamma * smoothing) ** np.arange(6 - t)
        np.testing.assert_allclose(ours[:, t], np.einsum("k,rkn->rn", weights, errors[:, t:]))


@pytest.mark.slow
def test_paired_advantages_point_where_the_exact_gradient_does():
    scenario = make_scenario("laboratory", {})
    found = gradient_noise(scenario, NoiseSettings(n_envs=32, rollouts=6))
    rows = {each.estimator: each for each in found.estimators}
    paired, single = rows["paired, lambda 0.95"], rows["lambda 0.9, critic"]
    assert paired.cosine > 0.5 > single.cosine
    assert paired.samples < 3000 and single.samples > 3 * paired.samples
    assert abs(paired.along - 1.0) < 0.5


def test_it_is_the_same_for_the_same_seed():
    scenario = make_scenario("laboratory", {})
    settings = NoiseSettings(n_envs=4, rollouts=1, rollout=16)
    assert gradient_noise(scenario, settings) == gradient_noise(scenario, settings)
