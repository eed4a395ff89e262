"""The native SB3 VecEnv is the vector environment with SB3's manners."""

import numpy as np
import pytest
from stable_baselines3.common.evaluation import evaluate_policy

from agents.learning.vec_env import ShakeTableVecEnv
from baselines.lqr.sampled import lqr
from shake_env import ShakeTableVectorEnv, make_scenario
from shake_env.errors import ActionError


def test_lanes_equal_the_vector_environment_with_same_step_autoreset():
    scenario = make_scenario("linear", {"duration": 0.4})
    ours, theirs = (
        ShakeTableVecEnv(scenario, 3),
        ShakeTableVectorEnv(3, scenario, autoreset_mode="SameStep"),
    )
    ours.seed(5)
    first, _ = theirs.reset(seed=5)
    np.testing.assert_array_equal(ours.reset(), first)
    rng = np.random.default_rng(0)
    ended = 0
    for _ in range(200):
        action = rng.uniform(-0.3, 0.3, (3, 1))
        observation, reward, done, infos = ours.step(action)
        other, other_reward, terminated, truncated, info = theirs.step(action)
        np.testing.assert_array_equal(observation, other)
        np.testing.assert_array_equal(reward, other_reward.astype(np.float32))
        np.testing.assert_array_equal(done, terminated | truncated)
        for lane in np.flatnonzero(done):
            ended += 1
            np.testing.assert_array_equal(infos[lane]["terminal_observation"], info["final_obs"][lane])
            assert infos[lane]["TimeLimit.truncated"] == truncated[lane]
            assert infos[lane]["episode"]["l"] == 80
    assert ended == 6


def test_a_broken_limit_is_no_truncation():
    env = ShakeTableVecEnv(make_scenario("linear", {"limits": "laboratory"}), 2)
    env.seed(0)
    env.reset()
    for t in range(400):
        _, reward, done, infos = env.step(np.array([[0.0], [min(t / 100, 1.0)]]))
        if done.any():
            break
    assert done.tolist() == [False, True]
    assert infos[1]["broken_limit"] == "table_velocity"
    assert not infos[1]["TimeLimit.truncated"]
    assert reward[1] < -1000.0


def test_episode_return_is_the_sum_of_rewards():
    env = ShakeTableVecEnv(make_scenario("linear", {"duration": 0.2}), 2)
    env.seed(0)
    env.reset()
    total = np.zeros(2)
    for _ in range(40):
        _, reward, done, infos = env.step(np.full((2, 1), 0.01))
        total += reward
    assert done.all()
    np.testing.assert_allclose([info["episode"]["r"] for info in infos], total, rtol=1e-6)


def test_lqr_drives_it_through_sb3s_own_evaluation():
    scenario = make_scenario("linear", {"duration": 4.0})
    env = ShakeTableVecEnv(scenario, 4)
    env.seed(3)
    returns, lengths = evaluate_policy(
        lqr(scenario), env, n_eval_episodes=4, return_episode_rewards=True, warn=False
    )
    assert lengths == [800] * 4
    assert 0.05 < -np.mean(returns) / 800 < 0.3  # J* is 0.2085, from rest a little less


def test_snapshot_goes_on_exactly():
    env = ShakeTableVecEnv(make_scenario("linear", {"duration": 0.5}), 3)
    env.seed(1)
    env.reset()
    action = np.full((3, 1), 0.05)
    for _ in range(70):
        env.step(action)
    kept = env.get_state()
    once = [env.step(action)[0] for _ in range(150)]
    other = ShakeTableVecEnv(env.scenario, 3)
    other.set_state(kept)
    again = [other.step(action)[0] for _ in range(150)]
    np.testing.assert_array_equal(once, again)


def test_bad_actions_are_refused():
    env = ShakeTableVecEnv(make_scenario(), 2)
    env.reset()
    with pytest.raises(ActionError, match=r"action shape.*\(2,\).*must be \(2, 1\)"):
        env.step(np.zeros(2))
    with pytest.raises(ActionError, match="finite"):
        env.step(np.array([[0.0], [np.nan]]))
