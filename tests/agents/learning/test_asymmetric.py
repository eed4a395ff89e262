"""An asymmetric critic: what it is told, and that the policy neither sees nor needs it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from agents.learning.asymmetric import AHEAD, BLOCK, FINE_AHEAD, AsymmetricVecEnv
from agents.learning.paired import PairedVecEnv
from agents.learning.vec_env import ShakeTableVecEnv
from agents.scenario_options import ScenarioOptions
from agents.training.algorithm_options import PPOOptions, SACOptions, TD3Options, TQCOptions
from agents.training.config import TrainConfig
from agents.training.model_factory import new_model
from agents.training.policy_export import export_policy
from agents.training.tables import training_tables
from shake_env import make_scenario
from shake_env.errors import ParameterError
from shake_env.rollout import noise_earthquakes, rollout

SCENARIOS = ("laboratory", "unknown-specimen", "field")


def model_on(algorithm="ppo", scenario="unknown-specimen", asymmetric=True, **ppo):
    few = {"n_envs": 3, "asymmetric_critic": asymmetric, "base_controller": "lqg-searched"}
    off = {**few, "residual_scale": 0.02, "learning_starts": 12, "batch_size": 8, "buffer_size": 200}
    off["gradient_steps"] = 1
    config = TrainConfig(
        algorithm=algorithm,
        scenario=ScenarioOptions(scenario, duration=0.5),
        ppo=PPOOptions(n_steps=16, batch_size=24, residual_scale=0.02, **few, **ppo),
        sac=SACOptions(**off),
        td3=TD3Options(**off),
        tqc=TQCOptions(**off),
        net_arch=(8, 8),
        episode_duration=0.5,
    )
    made = config.scenario.build()
    env = training_tables(config, made)
    env.seed(2)
    return new_model(config, made, env), env, made


@pytest.mark.parametrize("name", SCENARIOS)
def test_tables_do_the_same_and_observations_go_on(name):
    made = make_scenario(name, {"duration": 0.25})
    plain, more = ShakeTableVecEnv(made, 3), AsymmetricVecEnv(made, 3)
    for env in (plain, more):
        env.seed(4)
    size = made.observation.size
    both = plain.reset(), more.reset()
    rng = np.random.default_rng(0)
    for _ in range(60):
        np.testing.assert_array_equal(both[0], both[1][:, :size])
        assert more.observation_space.contains(both[1][0])
        action = rng.normal(0.0, 0.05, (3, 1)).astype(np.float32)
        (one, reward, done, infos), (two, again, ended, others) = plain.step(action), more.step(action)
        np.testing.assert_array_equal(reward, again)
        np.testing.assert_array_equal(done, ended)
        for info, other in zip(infos, others, strict=True):
            if info:
                terminal = other.pop("terminal_observation")
                np.testing.assert_array_equal(info.pop("terminal_observation"), terminal[:size])
                assert terminal.shape == two[0].shape
            assert info == other
        both = one, two


def test_the_ground_to_come_comes():
    made = make_scenario("laboratory", {"duration": 0.6})
    env = AsymmetricVecEnv(made, 2)
    env.seed(1)
    first, period = env.reset(), made.control_period
    fine, blocks = round(FINE_AHEAD / period), round(AHEAD / BLOCK)
    told = first[:, -(fine + blocks) :]
    targets = [env.simulation.engine.ground(preview=False).target[:, -1]]
    for _ in range(fine):
        env.step(np.zeros((2, 1), np.float32))
        targets.append(env.simulation.engine.ground(preview=False).target[:, -1])
    changes = np.diff(targets, axis=0).T
    scale = changes[0, 5] / told[0, 5]
    np.testing.assert_allclose(told[:, :fine] * scale, changes, rtol=1e-4, atol=1e-6 * scale)
    each = round(BLOCK / period)
    squares = np.mean((changes / scale).reshape(2, -1, each) ** 2, axis=2)
    np.testing.assert_allclose(told[:, fine : fine + fine // each], squares, rtol=1e-4, atol=1e-6)


def test_the_drawn_plant_and_the_true_state_are_told():
    made = make_scenario("unknown-specimen", {"duration": 0.5})
    env = AsymmetricVecEnv(made, 4)
    env.seed(3)
    env.reset()
    order = made.plant.layout.order
    drawn = env.privileged()[:, order : order + 2]
    ranges = made.uncertainty
    for lane, plant in enumerate(env.simulation.plant_batch.plants):
        ratio, drawn_ratio = ranges.mass_ratio, sum(plant.specimen.masses) / made.actuator.table_mass
        share = (drawn_ratio - ratio.low) / (ratio.high - ratio.low)
        assert drawn[lane, 0] == pytest.approx(2.0 * share - 1.0, abs=1e-5)
    before = env.privileged()[:, :order].copy()
    state = env.simulation.state
    state[:, 2] += 0.01
    env.simulation.state = state
    assert not np.array_equal(env.privileged()[:, :order], before)


def test_a_table_that_is_put_back_is_told_the_same():
    made = make_scenario("field", {"duration": 0.5})
    env, other = (AsymmetricVecEnv(made, 2) for _ in range(2))
    env.seed(1)
    other.seed(9)
    env.reset()
    other.reset()
    for _ in range(7):
        env.step(np.full((2, 1), 0.02, np.float32))
    other.set_state(env.get_state())
    np.testing.assert_allclose(other.privileged(), env.privileged(), rtol=1e-6)


@pytest.mark.parametrize("options", [{}, {"direct_path": True}, {"actor_bias": True}], ids=str)
def test_the_actor_does_not_see_what_the_critic_uses(options):
    model, env, _ = model_on(**options)
    shown = torch.from_numpy(env.reset())
    own = shown.shape[1] - env.privileged.size
    changed = shown.clone()
    changed[:, own:] += torch.randn_like(changed[:, own:])
    policy = model.policy
    with torch.no_grad():
        assert torch.equal(*(policy.get_distribution(s).mode() for s in (shown, changed)))
        values = [policy.predict_values(s) for s in (shown, changed)]
    assert (values[0] != values[1]).all()


@pytest.mark.parametrize("algorithm", ["ppo", "sac", "td3", "tqc"])
def test_the_exported_policy_acts_like_the_model_and_has_the_form_of_one_without(algorithm):
    model, env, made = model_on(algorithm)
    model.learn(48)
    policy = export_policy(model, env, {})
    plain, tables, _ = model_on(algorithm, asymmetric=False)
    usual = export_policy(plain, tables, {})
    assert policy.observation_size == made.observation.size
    np.testing.assert_array_equal(policy.matrix, usual.matrix)
    assert [w.shape for w in policy.weights] == [w.shape for w in usual.weights]
    shown = env.reset()
    correction = model.predict(shown, deterministic=True)[0]
    env.step_async(correction)
    action, _ = policy.predict(env.observation)
    np.testing.assert_allclose(env._action, action[:, 0], atol=1e-5)
    metrics, _ = rollout(policy, made, noise_earthquakes(made, 1, 3))
    assert np.isfinite(metrics[0].cost)


@pytest.mark.parametrize("algorithm", ["sac", "td3", "tqc"])
def test_critics_of_actions_use_it_and_actors_do_not(algorithm):
    model, env, _ = model_on(algorithm)
    shown = torch.from_numpy(env.reset())
    changed = shown.clone()
    changed[:, -env.privileged.size :] += 1.0
    action = torch.zeros((3, 1))
    with torch.no_grad():
        acts = [model.predict(s.numpy(), deterministic=True)[0] for s in (shown, changed)]
        values = [model.critic(s, action) for s in (shown, changed)]
    np.testing.assert_array_equal(*acts)
    pairs = zip(*(v if isinstance(v, tuple) else (v,) for v in values), strict=True)
    assert all(not torch.equal(a, b) for a, b in pairs)


def test_without_a_critic_it_is_refused():
    with pytest.raises(ParameterError, match="have no critic"):
        TrainConfig(ppo=replace(PPOOptions(), paired=True, asymmetric_critic=True))


def test_differences_to_the_base_law_have_critics_that_can_see_more():
    few = SACOptions(
        n_envs=2, learning_starts=4, batch_size=4, gradient_steps=1, buffer_size=100,
        paired=True, asymmetric_critic=True, base_controller="lqg-searched", residual_scale=0.02,
    )  # fmt: skip
    config = TrainConfig(
        algorithm="sac", scenario=ScenarioOptions("laboratory"), sac=few, episode_duration=0.2
    )
    env = training_tables(config, made := config.scenario.build())
    assert isinstance(env, PairedVecEnv)
    model = new_model(config, made, env)
    model.learn(60)
    assert model.num_timesteps == 60
