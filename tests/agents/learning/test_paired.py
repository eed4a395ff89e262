"""Paired roll-outs: common random numbers, shadows put back, rewards as differences, SB3 untouched."""

import numpy as np
import pytest
from sb3_contrib import TQC, CrossQ, RecurrentPPO
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.vec_env import DummyVecEnv

from agents.learning import PairedVecEnv, ShakeTableVecEnv, make_sb3_env
from shake_env import make_scenario
from shake_env.errors import ParameterError


class Mean:
    """A model whose mean action is a fixed number."""

    def __init__(self, action):
        self.action = action

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        assert deterministic
        return np.full((len(observation), 1), self.action, np.float32), state


def paired(name="laboratory", tables=3, duration=0.5, **options):
    inner = ShakeTableVecEnv(make_scenario(name, {"duration": duration}), 2 * tables)
    env = PairedVecEnv(inner, **options)
    env.seed(4)
    return env


@pytest.mark.parametrize("name", ["laboratory", "unknown-specimen"])
def test_the_mean_action_earns_nothing_on_any_earthquake(name):
    env = paired(name)
    env.follow(Mean(0.1))
    observation = env.reset()
    ended = 0
    for _ in range(250):
        following, reward, done, infos = env.step(np.full((3, 1), 0.1, np.float32))
        np.testing.assert_array_equal(reward, 0.0)
        ended += done.sum()
        assert len(infos) == 3
        assert not np.array_equal(following, observation)
        observation = following
    assert ended == 6


def test_a_reward_is_the_difference_of_two_runs_on_the_same_earthquake():
    env = paired(interval=None, gain=3.0)
    env.follow(Mean(0.0))
    table, shadow = (ShakeTableVecEnv(env.scenario, 3) for _ in range(2))
    for each in (table, shadow):
        each.seed(4)
        each.reset()
    env.reset()
    rng = np.random.default_rng(0)
    for _ in range(90):
        action = rng.normal(0.0, 0.1, (3, 1)).astype(np.float32)
        _, reward, done, _ = env.step(action)
        ours, theirs = table.step(action), shadow.step(np.zeros((3, 1)))
        np.testing.assert_allclose(reward, 3.0 * (ours[1] - theirs[1]), rtol=1e-5)
        assert not done.any()


def test_shadows_are_put_back_at_each_interval():
    env = paired(interval=20)
    env.follow(Mean(0.0))
    env.reset()
    place = []
    for t in range(60):
        _, reward, _, _ = env.step(np.full((3, 1), 0.1, np.float32))
        state = env.tables.simulation.state
        apart = np.abs(state[:3] - state[3:]).max(axis=1)
        assert (apart > 0.0).all()
        if t % 20 == 0:  # one action from the same place
            assert (reward != 0.0).all()
            place.append(np.abs(state[:3, 1] - state[3:, 1]))  # of the tables [m]
    np.testing.assert_array_less(place, 1e-4)
    assert (np.abs(state[:3, 1] - state[3:, 1]) > 1e-4).all()  # after 20


def test_against_the_base_controller_shadows_keep_their_own_place():
    env = paired(against="base", interval=None)
    env.reset()
    alone = ShakeTableVecEnv(env.scenario, 3)
    alone.seed(4)
    alone.reset()
    for _ in range(150):  # through an episode's end
        env.step(np.full((3, 1), 0.05, np.float32))
        alone.step(np.zeros((3, 1)))
        np.testing.assert_array_equal(env.tables.simulation.state[3:], alone.simulation.state)


@pytest.mark.parametrize("loses", ["table", "shadow"])
def test_an_episode_that_ends_alone_costs_its_limit_and_both_go_on_together(loses):
    env = paired(duration=4.0, tables=2)
    strong, weak = np.full((2, 1), 1.0, np.float32), np.zeros((2, 1), np.float32)
    env.follow(Mean(1.0 if loses == "shadow" else 0.0))
    env.reset()
    for _ in range(200):
        _, reward, done, infos = env.step(strong if loses == "table" else weak)
        state = env.tables.simulation.state
        if together := np.flatnonzero((state[:2] == state[2:]).all(axis=1)).tolist():
            break
    lane = together[0]
    assert abs(reward[lane]) > 10.0
    assert done[lane] == (loses == "table") and (reward[lane] < 0.0) == (loses == "table")
    assert ("broken_limit" in infos[lane]) == (loses == "table")
    state = env.tables.get_state()
    for name in ("key", "period", "state", "step_count"):
        np.testing.assert_array_equal(state[name][lane], state[name][lane + 2])


SMALL = {"learning_rate": 1e-3, "seed": 0, "device": "cpu"}
KEEP = {**SMALL, "learning_starts": 8, "batch_size": 8, "buffer_size": 200}


@pytest.mark.parametrize("kind", [SAC, TD3, TQC, CrossQ])
def test_off_policy_algorithms_of_sb3_learn_on_it_as_they_are(kind):
    tables = make_sb3_env("laboratory", 4, base_controller="lqg", action_scale=0.02, duration=0.3)
    model = kind("MlpPolicy", PairedVecEnv(tables, against="base", gain=10.0), **KEEP)
    model.env.follow(model)
    model.learn(40)
    rewards = model.replay_buffer.rewards[: model.replay_buffer.size()]
    assert np.isfinite(rewards).all() and (rewards != 0.0).all() and np.abs(rewards).max() < 10.0


def test_ppo_learns_on_it_without_a_critic_that_says_anything():
    tables = make_sb3_env("laboratory", 8, base_controller="lqg", action_scale=0.02, duration=0.3)
    env = PairedVecEnv(tables, interval=16)
    model = PPO("MlpPolicy", env, n_steps=16, batch_size=32, n_epochs=2, **SMALL)
    env.follow(model)
    model.learn(128)
    assert not model.rollout_buffer.values.any()
    assert np.abs(model.rollout_buffer.advantages).max() > 0.0
    np.testing.assert_array_equal(
        model.rollout_buffer.advantages + model.rollout_buffer.values, model.rollout_buffer.returns
    )


def test_a_recurrent_shadow_begins_a_roll_out_with_its_tables_memory():
    tables = make_sb3_env("laboratory", 4, duration=2.0)
    env = PairedVecEnv(tables, interval=16)
    still = {**SMALL, "learning_rate": 0.0}
    model = RecurrentPPO("MlpLstmPolicy", env, n_steps=16, batch_size=16, n_epochs=1, **still)
    env.follow(model)
    model.policy.log_std.data.fill_(-18.0)  # the explored action is the mean
    model.policy.log_std.requires_grad_(False)
    model.learn(16 * 2 * 3)
    assert np.abs(model._last_lstm_states.pi[0].numpy()).max() > 0.0
    np.testing.assert_allclose(model.rollout_buffer.rewards, 0.0, atol=1e-6)


def test_what_cannot_be_paired_is_refused_with_its_remedy():
    tables = make_sb3_env("linear", 4)
    with pytest.raises(ParameterError, match=r"num_envs.*must be even"):
        PairedVecEnv(make_sb3_env("linear", 3))
    with pytest.raises(ParameterError, match=r"venv.*make_sb3_env"):
        PairedVecEnv(DummyVecEnv([lambda: __import__("gymnasium").make("CartPole-v1")] * 2))
    with pytest.raises(ParameterError, match="known: mean, base"):
        PairedVecEnv(tables, against="nothing")
    with pytest.raises(ParameterError, match=r"interval.*or None"):
        PairedVecEnv(tables, interval=0)
    env = PairedVecEnv(tables)
    env.reset()
    with pytest.raises(ParameterError, match=r"follow\(model\)"):
        env.step(np.zeros((2, 1), np.float32))
