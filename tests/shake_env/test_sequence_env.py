"""The environment of a sequence: one specimen, rising shakes, carried damage, Gymnasium's contract."""

import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from shake_env.env import ShakeTableEnv
from shake_env.errors import ParameterError, ScenarioError
from shake_env.scenario.limits import REASONS
from shake_env.sequence_env import ShakeTableSequenceEnv

OPTIONS = {"amplitudes": (0.5, 1.0), "duration": 0.5, "amplitude": 0.2}


def through(env, seed=3, level=0.1):
    """All steps of a sequence under a small noise: observations, rewards, infos."""
    rng = np.random.default_rng(0)
    observation, info = env.reset(seed=seed)
    looks, rewards, infos = [observation], [], [info]
    over = False
    while not over:
        action = rng.uniform(-level, level, 1).astype(np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        looks.append(observation)
        rewards.append(reward)
        infos.append(info)
        over = terminated or truncated
    return np.array(looks), np.array(rewards), infos, truncated


@pytest.mark.parametrize("options", [{"scenario": "unknown-specimen"}, {"scenario": "yielding"}])
def test_it_keeps_gymnasiums_contract(options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make("shake_env:ShakeTable-sequence-v0", **OPTIONS, **options)
        check_env(env.unwrapped, skip_render_check=True)
    assert env.observation_space.shape == (ShakeTableEnv(**options).observation_space.shape[0] + 1,)
    env.close()


def test_an_episode_is_a_sequence_of_shakes_on_one_plant():
    env = ShakeTableSequenceEnv(**OPTIONS)
    looks, rewards, infos, truncated = through(env)
    assert truncated and len(rewards) == 200
    shares = looks[:, -1]
    # The observation that ends a shake is the one that the next begins with.
    assert set(shares[:100]) == {np.float32(0.5)} and set(shares[100:]) == {np.float32(1.0)}
    assert [info["shake"] for info in infos[1:]] == [0] * 100 + [1] * 100
    ended = [i for i, info in enumerate(infos) if info["shake_ended"]]
    assert ended == [100, 200]
    costs = infos[-1]["shake_costs"]
    assert costs == pytest.approx((-rewards[:100].sum(), -rewards[100:].sum()))
    assert infos[50]["shake_costs"] == pytest.approx((-rewards[:50].sum(),))
    assert infos[1]["amplitude"] == 0.5 and infos[-1]["amplitude"] == 1.0


def test_each_shake_is_that_of_the_environment_of_one():
    """The plant is drawn once: the second shake's own stream draws nothing of it."""
    env = ShakeTableSequenceEnv(**OPTIONS)
    looks, rewards, _, _ = through(env)
    drawn = env._simulation.get_state()["plant_values"][0]
    assert set(drawn) == {"mass_ratio", "storey_frequency"}
    one = ShakeTableEnv("unknown-specimen", duration=0.5)
    motion = replace(one.scenario.motion, amplitude=0.1, duration=0.5)
    rng = np.random.default_rng(0)
    observation, _ = one.reset(seed=3, options={"motion": motion})
    for t in range(100):
        np.testing.assert_array_equal(observation, looks[t, :-1])
        observation, reward, _, _, _ = one.step(rng.uniform(-0.1, 0.1, 1).astype(np.float32))
        assert reward == rewards[t]
    assert one._simulation.get_state()["plant_values"][0] == drawn
    again, *_ = through(ShakeTableSequenceEnv(**OPTIONS))
    np.testing.assert_array_equal(again, looks)
    other, *_ = through(ShakeTableSequenceEnv(**OPTIONS), seed=4)
    assert np.abs(other - looks).max() > 0.1
    # The next sequence goes on with the environment's stream.
    env.reset()
    assert env._simulation.get_state()["plant_values"][0] != drawn


def test_damage_passes_from_shake_to_shake():
    options = {"scenario": "yielding", "amplitudes": (0.5, 1.0), "duration": 2.0, "amplitude": 0.4}
    env = ShakeTableSequenceEnv(**options, limits="off")
    looks, _, infos, truncated = through(env, level=0.5)
    assert truncated
    first = infos[400]
    assert first["shake_ended"] and first["dissipated_energy"] > 0.1
    slip, reference = np.array(env.specimen.slip), np.array(env.specimen.reference_slip)
    assert np.abs(slip).min() > 1e-6 and np.abs(reference).min() > 1e-6
    assert env.specimen.energy == pytest.approx(first["dissipated_energy"])
    # The second shake begins at rest but for the drift that remains.
    scale, alpha = env.scenario.plant.state_scale, env.scenario.nonlinearity.yielding.stiffness_ratio
    shown = looks[400, : len(scale)] * scale
    layout = env.scenario.plant.layout
    specimen = slice(layout.controlled.start + 4, layout.controlled.stop)
    assert shown[specimen][:2] == pytest.approx((1 - alpha) * np.cumsum(slip), rel=1e-5)
    assert shown[layout.reference][:2] == pytest.approx((1 - alpha) * np.cumsum(reference), rel=1e-5)
    energies = [info["dissipated_energy"] for info in infos]
    assert energies[-1] > energies[400] > energies[200] > 0.0
    env.reset(seed=5)
    assert not any(env.specimen.slip)


def test_a_broken_limit_ends_the_sequence_and_never_pays():
    options = {**OPTIONS, "amplitudes": (0.5, 1.0, 2.0), "duration": 1.0}
    env = ShakeTableSequenceEnv(**options)
    env.reset(seed=1)
    terminated, steps = False, 0
    while not terminated:
        _, reward, terminated, truncated, info = env.step(np.ones(1, dtype=np.float32))
        steps += 1
        assert not truncated
    assert info["shake"] == 0 and info["shake_ended"]
    assert info["broken_limit"] in REASONS
    tables = env._simulation.tables
    lacking = 200 - steps + 200 + 200  # control periods; amplitudes below 1 count as 1
    assert info["limit_cost"] == pytest.approx(tables.limit_rate * lacking, rel=1e-6)
    assert reward < -info["limit_cost"]
    with pytest.raises(ScenarioError, match="no episode is running"):
        env.step(np.zeros(1, dtype=np.float32))


def test_amplitudes_must_rise():
    for wrong in ((), (1.0, 0.5), (0.0, 1.0), (0.5, np.inf)):
        with pytest.raises(ParameterError, match="must rise"):
            ShakeTableSequenceEnv(amplitudes=wrong)
