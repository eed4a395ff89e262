"""The Gymnasium environments: contract, spaces, reward, ends, autoreset, and lanes as single tables."""

import re

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordEpisodeStatistics, TimeLimit
from short_env import SHORT, push

from baselines.registry import make_baseline, reference_name
from shake_env import (
    Objective,
    ShakeTableEnv,
    ShakeTableVectorEnv,
    make_scenario,
)
from shake_env.env import INFO_KEYS
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.simulation.simulation import Simulation
from shake_env.simulation.streams import earthquake_stream


def test_make():
    env = gymnasium.make("shake_env:ShakeTable-v0", stories=5, mass_ratio=0.2)
    observation, info = env.reset(seed=1)
    assert env.observation_space.shape == (26,)
    assert env.observation_space.contains(observation)
    assert set(info) == set(INFO_KEYS)
    assert env.unwrapped.scenario.specimen.mass == pytest.approx(36.0)
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    assert env.observation_space.contains(observation)
    assert isinstance(reward, float) and not terminated and not truncated
    env.close()


def test_make_vec():
    envs = gymnasium.make_vec(
        "shake_env:ShakeTable-v0",
        num_envs=3,
        vectorization_mode="vector_entry_point",
        stories=5,
        mass_ratio=0.2,
    )
    assert isinstance(envs.unwrapped, ShakeTableVectorEnv)
    observation, _ = envs.reset(seed=1)
    assert observation.shape == (3, 26) and envs.observation_space.contains(observation)
    assert envs.single_observation_space.shape == (26,)
    observation, reward, terminated, truncated, _ = envs.step(envs.action_space.sample())
    assert envs.observation_space.contains(observation)
    assert [a.shape for a in (reward, terminated, truncated)] == [(3,)] * 3
    assert (reward.dtype, terminated.dtype, truncated.dtype) == (np.float64, bool, bool)
    envs.close()


@pytest.mark.parametrize(
    "overrides",
    [
        {},
        {"scenario": "as-printed", "stories": 3},
        {"highpass_frequency": 0.5, "amplitude": 0.3, "limits": "laboratory"},
        {"record": "ridgecrest2019_clc_90"},
    ],
    ids=str,
)
def test_gymnasium_checker_has_no_complaint(overrides):
    # Warnings are errors throughout this suite.
    check_env(gymnasium.make("shake_env:ShakeTable-v0", **overrides).unwrapped)


def test_stable_baselines_checker_has_no_complaint():
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(ShakeTableEnv(stories=5, mass_ratio=0.2), warn=True)


def rows(document, title):
    """Cells of the table of a section of the class docstring."""
    section = document.split(f"## {title}")[1].split("##")[0]
    lines = [line.strip() for line in section.splitlines() if line.strip().startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def test_docstring_is_the_contract_of_the_spaces():
    stories = 5
    env = ShakeTableEnv(stories=stories)
    document = ShakeTableEnv.__doc__
    low, high, size = re.search(
        r"## Observation\s+``Box\((-?\d+), (\d+), \((.*?),\), float32\)", document
    ).groups()
    assert size == "6 + 4 stories"
    space = gymnasium.spaces.Box(float(low), float(high), (6 + 4 * stories,), np.float32)
    assert env.observation_space == space
    low, high, size = re.search(
        r"## Action\s+``Box\((-?\d+), (\d+), \((.*?),\), float32\)", document
    ).groups()
    assert env.action_space == gymnasium.spaces.Box(float(low), float(high), (int(size),), np.float32)
    names = env.scenario.plant.layout.names
    for entry, meaning, unit in rows(document, "Observation"):
        if entry.startswith("("):
            continue
        first = entry.replace("...", "").strip()
        index = 6 + 2 * stories if "stories" in first else int(first)
        assert names[index].endswith(f"[{unit.split(',')[0]}]"), entry
        word = meaning.split()[0].rstrip(":")
        assert word in names[index], (entry, names[index])


def test_docstring_names_the_high_pass_entries():
    env = ShakeTableEnv(highpass_frequency=0.5)
    names = env.scenario.plant.layout.names
    assert env.observation_space.shape == (16,)
    optional = [row for row in rows(ShakeTableEnv.__doc__, "Observation") if row[0] == "(2, 3)"]
    assert optional == [
        ["(2, 3)", "(ground displacement, velocity: only with the high-pass)", "(m, m/s)"]
    ]
    assert names[2:4] == ("ground displacement [m]", "ground velocity [m/s]")


@pytest.mark.parametrize("name", ["linear", "laboratory"])
def test_docstring_says_what_reference_and_no_control_get(name):
    """Within the rounding of the text."""
    scenario = make_scenario(name, {"duration": 10.0})
    earthquakes = noise_earthquakes(scenario, 64)
    table = {(row[0], row[1]): row[2:] for row in rows(ShakeTableEnv.__doc__, "Reward")}
    assert {key[0] for key in table} == {"linear", "laboratory"}
    for controller in (reference_name(scenario), "none"):
        episodes, _ = rollout(make_baseline(controller, scenario), scenario, earthquakes)
        reward = -np.mean([episode.cost for episode in episodes])
        per_step, per_episode = (float(cell) for cell in table[name, controller])
        assert reward == pytest.approx(per_step, rel=5e-4)
        assert reward * 2000 == pytest.approx(per_episode, rel=5e-4)


def test_docstring_is_the_contract_of_info_and_arguments():
    document = ShakeTableEnv.__doc__
    section = document.split("## Info")[1].split("##")[0]
    assert set(re.findall(r"``(\w+)``", section)) == set(INFO_KEYS)
    env = ShakeTableEnv(**SHORT)
    assert set(env.reset(seed=0)[1]) == set(INFO_KEYS)
    assert set(env.step(np.zeros(1))[4]) == set(INFO_KEYS)
    from shake_env.scenario.overrides import Overrides

    section = document.split("## Arguments")[1].split("##")[0]
    words = set(re.findall(r"``(\w+)``", section)) - {"scenario", "Scenario", "make_scenario"}
    assert words == set(Overrides.__annotations__)


def test_observation_is_the_scaled_full_state_and_info_is_si():
    scenario = make_scenario("linear", {"stories": 2})
    env = ShakeTableEnv(scenario)
    env.reset(seed=11)
    simulation = Simulation(scenario, 1)
    simulation.start([0], [earthquake_stream(11)])
    for action in push(1, 100)[:, 0]:
        observation, reward, _, _, info = env.step(action)
        result = simulation.step(action.astype(float))
        ground, response = result.ground, result.outcome.response
        full = np.concatenate([ground.ground[0], response.state[0], ground.reference[0]])
        expected = full / scenario.plant.state_scale
        assert np.array_equal(observation, expected.astype(np.float32))
        p_l, x_a, v_a, _ = response.state[0, :4]
        assert info["load_pressure"] == p_l
        assert (info["table_displacement"], info["table_velocity"]) == (x_a, v_a)
        assert info["current"] == pytest.approx(0.125 * float(action[0]), rel=1e-15)
        # Outputs of the state, from the coupled model's own rows.
        y_A, f_s, y, f = scenario.plant.coupled.C @ full
        assert info["table_acceleration"] == pytest.approx(y_A, rel=1e-9, abs=1e-9)
        assert info["base_shear"] == pytest.approx(f_s, rel=1e-9, abs=1e-9)
        assert info["target_acceleration"] == pytest.approx(y, rel=1e-9, abs=1e-9)
        assert info["reference_base_shear"] == pytest.approx(f, rel=1e-9, abs=1e-9)
        terms = sum(info[f"{name}_cost"] for name in ("acceleration", "force", "current", "limit"))
        assert reward == pytest.approx(-terms, rel=1e-14)


def test_reward_is_the_stage_cost_by_its_definition():
    env = ShakeTableEnv(control_rate=1000.0)  # one physics step a period: the mean is one term
    env.reset(seed=2)
    plant = env.scenario.plant
    for action in push(1, 50)[:, 0]:
        _, reward, _, _, info = env.step(action)
        cost = (
            (info["table_acceleration"] - info["target_acceleration"]) ** 2 / plant.target_variance
            + (info["base_shear"] - info["reference_base_shear"]) ** 2 / plant.reference_shear_variance
            + 0.01 * (info["current"] / 0.025) ** 2
        )
        assert -reward == pytest.approx(cost, rel=1e-12)


def test_raw_weights_are_the_papers():
    env = ShakeTableEnv(objective=Objective.raw(1e3, 1e-3, 2.0), control_rate=1000.0)
    env.reset(seed=2)
    for action in push(1, 50)[:, 0]:
        _, reward, _, _, info = env.step(action)
        z = np.array(
            [
                1e3 * (info["table_acceleration"] - info["target_acceleration"]),
                1e-3 * (info["base_shear"] - info["reference_base_shear"]),
                2.0 * info["current"],
            ]
        )
        assert -reward == pytest.approx(z @ z, rel=1e-12)


def test_actions_outside_the_space_are_clipped():
    results = []
    for action in (1.0, 3.0):
        env = ShakeTableEnv()
        env.reset(seed=0)
        results.append(env.step(np.array([action], np.float32)))
    assert np.array_equal(results[0][0], results[1][0])
    assert results[0][4] == results[1][4]
    assert results[1][4]["current"] == 0.125


def test_gymnasium_wrappers():
    env = RecordEpisodeStatistics(
        TimeLimit(gymnasium.make("shake_env:ShakeTable-v0", duration=0.5), max_episode_steps=30)
    )
    env.reset(seed=0)
    total = 0.0
    for t in range(30):
        _, reward, _, truncated, info = env.step(np.zeros(1, np.float32))
        total += reward
        assert truncated == (t == 29)
    assert info["episode"]["l"] == 30
    assert info["episode"]["r"] == pytest.approx(total, abs=1e-5)  # rounded to 6 decimals
    env.close()


def test_gymnasium_vector_wrapper_counts_episodes():
    wrapper = gymnasium.wrappers.vector.RecordEpisodeStatistics(
        ShakeTableVectorEnv(3, autoreset_mode="NextStep", **SHORT)
    )
    wrapper.reset(seed=0)
    for _ in range(100):
        *_, truncated, info = wrapper.step(np.zeros((3, 1)))
    assert truncated.all() and np.array_equal(info["episode"]["l"], [100, 100, 100])
