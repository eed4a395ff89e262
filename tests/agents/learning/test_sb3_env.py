"""A Stable-Baselines3 script of one's own: `make_sb3_env`, the same as a wrapper, and the comparison."""

import gymnasium
import numpy as np
import pytest
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy

from agents.learning.features import FeatureMap, feature_matrix
from agents.learning.sb3_env import SB3Controller, compare_with_reference, make_sb3_env
from agents.learning.training_scenario import (
    checked_action_scale,
    horizon_of,
    make_training_scenario,
    reward_scale,
)
from agents.learning.wrappers import TrainingWrapper
from baselines.lqr.sampled import lqr
from shake_env import NoControl, ShakeTableVectorEnv, make_scenario
from shake_env.errors import ParameterError, ScenarioError

ID = "shake_env:ShakeTable-v0"


def wrapped(duration=0.4, **options):
    scenario = make_training_scenario("linear", duration=duration)
    return TrainingWrapper(gymnasium.make(ID, scenario=scenario), **options)


class LinearModel:
    """LQR as an SB3 model sees the table: from features to actions of a given scale."""

    def __init__(self, scenario, action_scale):
        matrix = feature_matrix(scenario)
        eye = np.eye(scenario.observation.size, dtype=np.float32)
        small = 1e-3 * eye  # within the bounds of the action
        row = lqr(scenario).predict(small)[0][:, 0] / 1e-3
        self.row = row @ np.linalg.pinv(matrix) / action_scale

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return (observation @ self.row)[..., None], state


def test_lanes_are_the_wrapped_environment():
    tables = make_sb3_env("linear", 3, duration=0.4, action_scale=0.5, gamma=0.97)
    horizon = horizon_of(0.97, 0.005)
    scenario = make_training_scenario("linear", duration=0.4, horizon=horizon)
    single = [
        TrainingWrapper(gymnasium.make(ID, scenario=scenario), action_scale=0.5, gamma=0.97)
        for _ in range(3)
    ]
    tables.seed(5)
    first = tables.reset()
    alone = [env.reset(seed=5 + i)[0] for i, env in enumerate(single)]
    np.testing.assert_allclose(first, alone, rtol=1e-5, atol=1e-5)
    assert first.dtype == np.float32 and tables.observation_space == single[0].observation_space
    rng, ended, costly = np.random.default_rng(0), 0, 0
    for _ in range(160):
        action = rng.uniform(-1.0, 1.0, (3, 1)).astype(np.float32)
        observation, reward, done, infos = tables.step(action)
        for lane, env in enumerate(single):
            seen, value, terminated, truncated, _ = env.step(action[lane])
            assert done[lane] == (terminated or truncated)
            assert reward[lane] == pytest.approx(value, rel=1e-5)
            if done[lane]:
                ended += 1
                costly += terminated
                last = infos[lane]["terminal_observation"]
                np.testing.assert_allclose(last, seen, rtol=1e-4, atol=1e-4)
                seen, _ = env.reset()
            # Features are differences of states, in single precision.
            np.testing.assert_allclose(observation[lane], seen, rtol=1e-4, atol=1e-4)
    assert ended >= 6 and costly  # by the end of the motion and by the bound on the state


def test_sb3_checks_the_wrapped_environment():
    check_env(wrapped(action_scale=0.5))


def test_the_wrapper_can_be_made_again_from_its_spec():
    env = wrapped(action_scale=0.5, gamma=0.97)
    again = gymnasium.make(env.spec)
    assert isinstance(again, TrainingWrapper)
    assert (again.action_scale, again.reward_scale) == (0.5, env.reward_scale)


@pytest.mark.parametrize("name", ["linear", "ShakeTable-linear-v0", "shake_env:ShakeTable-v0"])
def test_a_scenario_has_a_name_an_id_or_a_value(name):
    expected = make_training_scenario("linear")
    assert make_training_scenario(name) == expected
    assert make_training_scenario(make_scenario(name if name == "linear" else "linear")) == expected
    assert make_sb3_env(name, 2).get_attr("scenario")[0].name == "linear"


def test_training_ends_hopeless_episodes_where_there_are_no_limits():
    linear = make_training_scenario("linear", {"stories": 3}, horizon=0.5)
    assert (linear.limits.state_limit, linear.limits.cost_horizon) == (12.0, 0.5)
    assert (linear.motion.duration, linear.specimen.stories) == (10.0, 3)
    laboratory = make_training_scenario("laboratory", duration=None)
    assert laboratory == make_scenario("laboratory")


def test_rewards_are_scaled_to_the_order_of_a_stage_cost():
    amplitude = make_scenario("laboratory").motion.amplitude
    assert reward_scale(make_scenario("linear"), 0.98) == pytest.approx(0.02)
    assert reward_scale(make_scenario("laboratory"), 0.98) == pytest.approx(0.02 / amplitude**2)
    assert np.exp(-0.005 / horizon_of(0.9802, 0.005)) == pytest.approx(0.9802)


def test_ppo_of_sb3_learns_on_both():
    for env in (make_sb3_env("linear", 2, duration=0.5, action_scale=0.5), wrapped(0.5)):
        model = PPO(
            "MlpPolicy", env, n_steps=64, batch_size=64, n_epochs=1, seed=0, device="cpu",
            policy_kwargs={"log_std_init": -2.0},
        )  # fmt: skip
        before = model.policy.action_net.weight.detach().clone()
        model.learn(256)
        assert not np.array_equal(before, model.policy.action_net.weight.detach())
        assert compare_with_reference(model, duration=0.5, earthquakes=2).ratio > 1.0


def test_evaluate_policy_reports_true_returns():
    """And not the scaled ones, as the episode's record says."""
    scenario = make_training_scenario("linear", duration=0.5)
    env = make_sb3_env("linear", 2, duration=0.5)
    model = LinearModel(scenario, 1.0)
    env.seed(3)
    returns, _ = evaluate_policy(model, env, 2, return_episode_rewards=True)
    bare = gymnasium.make(ID, scenario=scenario)
    controller, total, truncated = lqr(scenario), 0.0, False
    observation, _ = bare.reset(seed=3)
    while not truncated:
        observation, reward, _, truncated, _ = bare.step(controller.predict(observation)[0])
        total += reward
    assert returns[0] == pytest.approx(total, rel=1e-3)


@pytest.mark.parametrize("action_scale", [1.0, 0.5])
def test_lqr_on_features_has_the_cost_of_lqr(action_scale):
    """A comparison that left out the features or the scale would give another ratio."""
    scenario = make_scenario("linear")
    model = LinearModel(scenario, action_scale)
    compared = compare_with_reference(model, action_scale=action_scale, duration=4.0, earthquakes=4)
    assert compared.reference == "lqr" and compared.broken_limits == 0
    assert compared.ratio == pytest.approx(1.0, rel=1e-3)
    assert f"ratio {compared.ratio:.3f}" in str(compared)
    other = compare_with_reference(model, action_scale=0.3, duration=4.0, earthquakes=4)
    assert other.ratio > 1.5


def test_a_model_with_memory_is_a_controller():
    env = make_sb3_env("linear", 2, duration=0.5)
    model = RecurrentPPO("MlpLstmPolicy", env, n_steps=8, batch_size=8, seed=0, device="cpu")
    controller = SB3Controller(model, "linear", action_scale=0.5)
    observation = np.random.default_rng(0).normal(size=(3, 14)).astype(np.float32)
    start = np.ones(3, dtype=bool)
    action, memory = controller.predict(observation, None, start)
    expected, _ = model.predict(FeatureMap(make_scenario("linear"))(observation), None, start, True)
    np.testing.assert_allclose(action, 0.5 * expected)
    again, _ = controller.predict(observation, memory, ~start)
    assert action.shape == (3, 1) and not np.array_equal(action, again)


def test_a_gymnasium_batch_given_to_sb3_names_what_to_use():
    envs = gymnasium.make_vec(ID, num_envs=2)
    with pytest.raises(ValueError, match=r"agents\.learning\.make_sb3_env"):
        PPO("MlpPolicy", envs)
    with pytest.raises(ValueError, match=r"agents\.learning\.make_sb3_env"):
        evaluate_policy(NoControl(), envs)
    assert str(ShakeTableVectorEnv) == "<class 'shake_env.vector_env.ShakeTableVectorEnv'>"


def test_a_model_of_the_bare_environment_is_refused():
    model = PPO("MlpPolicy", gymnasium.make(ID, duration=0.5), device="cpu")
    with pytest.raises(ScenarioError, match="make_sb3_env"):
        compare_with_reference(model)


def test_what_cannot_be_is_refused():
    with pytest.raises(ScenarioError, match="reserved for testing"):
        make_sb3_env("records")
    with pytest.raises(ScenarioError, match="linear"):
        make_sb3_env("linaer")
    for gamma in (0.0, 1.0, np.nan):
        with pytest.raises(ParameterError, match="gamma"):
            make_sb3_env(gamma=gamma)
    for scale in (0.0, 1.5, np.nan):
        with pytest.raises(ParameterError, match="action_scale"):
            checked_action_scale(scale)
    for number in (0, 1.5):
        with pytest.raises(ParameterError, match="num_envs"):
            make_sb3_env(num_envs=number)
