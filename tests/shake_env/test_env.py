"""The Gymnasium environments: contract, spaces, reward, ends, autoreset, and lanes as single tables."""

import copy
import hashlib
import math
import pickle
import re
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordEpisodeStatistics, TimeLimit

from baselines.registry import make_baseline, reference_name
from shake_env import (
    Objective,
    RecordedMotion,
    ShakeTableEnv,
    ShakeTableVectorEnv,
    make_scenario,
)
from shake_env.env import INFO_KEYS
from shake_env.errors import ActionError, ParameterError, ScenarioError
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.simulation.simulation import Simulation

SHORT = {"duration": 0.5}


def push(lanes, steps, seed=0, size=0.1):
    rng = np.random.default_rng(seed)
    return rng.uniform(-size, size, (steps, lanes, 1)).astype(np.float32)


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
    simulation.start([0], np.random.default_rng(11).spawn(1))
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


@pytest.mark.parametrize(
    ("overrides", "steps"),
    [
        ({"duration": 0.5}, 100),
        ({"duration": 0.5, "control_rate": 500.0}, 250),
        ({"duration": 0.503}, 100),
        ({"record": "napa2014_68150_hne"}, 6996),  # 6997 samples at 200 Hz
        ({"record": "napa2014_68150_hne", "time_compression": 2.0}, 3498),
    ],
    ids=str,
)
def test_truncated_exactly_at_the_end_of_the_motion(overrides, steps):
    env = ShakeTableEnv(**overrides)
    env.reset(seed=0)
    for t in range(1, steps + 1):
        _, _, terminated, truncated, _ = env.step(np.zeros(1))
        assert not terminated
        assert truncated == (t == steps), t


@pytest.mark.parametrize(
    "action",
    [
        np.array([np.nan]),
        np.array([np.inf]),
        np.zeros(2),
        np.zeros((1, 1)),
        np.zeros(()),
        0.5,
        "left",
        None,
        [[0.1], 0.2],
    ],
    ids=repr,
)
def test_bad_action_raises_an_action_error(action):
    env = ShakeTableEnv()
    env.reset(seed=0)
    with pytest.raises(ActionError, match=r"action.*=.*must be"):
        env.step(action)
    envs = ShakeTableVectorEnv(3)
    envs.reset(seed=0)
    with pytest.raises(ActionError, match=r"action.*=.*must be"):
        envs.step(action)


def test_one_bad_lane_raises_an_action_error():
    envs = ShakeTableVectorEnv(3)
    envs.reset(seed=0)
    with pytest.raises(ActionError, match="finite"):
        envs.step(np.array([[0.0], [np.nan], [0.0]]))


def test_a_refused_action_changes_nothing():
    env, twin = ShakeTableEnv(), ShakeTableEnv()
    env.reset(seed=0)
    twin.reset(seed=0)
    with pytest.raises(ActionError):
        env.step(np.array([np.nan]))
    assert np.array_equal(env.step(np.zeros(1))[0], twin.step(np.zeros(1))[0])


def test_step_before_reset_and_after_the_end_raises():
    env = ShakeTableEnv(**SHORT)
    with pytest.raises(ScenarioError, match="reset"):
        env.step(np.zeros(1))
    env.reset(seed=0)
    while not env.step(np.zeros(1))[3]:
        pass
    with pytest.raises(ScenarioError, match="reset"):
        env.step(np.zeros(1))
    env.reset()
    env.step(np.zeros(1))


_EPISODE = """
import hashlib, numpy as np
from shake_env import ShakeTableEnv, ShakeTableVectorEnv
digest = hashlib.sha256()
env = ShakeTableEnv(stories=3, duration=1.0)
digest.update(env.reset(seed=123)[0].tobytes())
for t in range(200):
    digest.update(env.step(np.array([0.1 * np.sin(t)], np.float32))[0].tobytes())
digest.update(env.reset()[0].tobytes())
envs = ShakeTableVectorEnv(3, stories=3, duration=1.0)
envs.reset(seed=9)
for t in range(300):
    digest.update(envs.step(np.full((3, 1), 0.1 * np.sin(t), np.float32))[0].tobytes())
print(digest.hexdigest())
"""


def test_the_same_seed_gives_the_same_episode_in_another_process():
    hashes = [
        subprocess.run(
            [sys.executable, "-c", _EPISODE], capture_output=True, text=True, check=True
        ).stdout
        for _ in range(2)
    ]
    assert len(hashes[0].strip()) == 64 and hashes[0] == hashes[1]


def digest_of_an_episode(seed, **overrides):
    env = ShakeTableEnv(**SHORT, **overrides)
    env.reset(seed=seed)
    digest = hashlib.sha256()
    for _ in range(100):
        digest.update(env.step(np.full(1, 0.05))[0].tobytes())
    return digest.hexdigest()


def test_seeds_and_parameters_make_different_episodes():
    runs = [(0, {}), (1, {}), (0, {"stories": 2, "mass_ratio": 0.6}), (0, {"amplitude": 0.5})]
    assert len({digest_of_an_episode(seed, **kw) for seed, kw in runs}) == 4
    assert digest_of_an_episode(0) == digest_of_an_episode(0)


def test_episodes_of_one_lane_differ_and_reseeding_repeats_them():
    env = ShakeTableEnv(**SHORT)

    def episodes():
        histories = []
        for episode in range(3):
            env.reset(seed=4 if episode == 0 else None)
            histories.append(np.array([env.step(np.zeros(1))[0] for _ in range(100)]))
        return np.array(histories)

    first, again = episodes(), episodes()
    assert np.array_equal(first, again)
    assert not np.array_equal(first[0], first[1]) and not np.array_equal(first[1], first[2])


def test_how_an_episode_ends_never_shows_in_the_next_one():
    # Neither the length of an episode nor the blocks that are computed ahead move the stream.
    after = []
    for steps in (1, 63, 64, 65, 100):
        env = ShakeTableEnv(**SHORT)
        env.reset(seed=4)
        for _ in range(steps):
            env.step(np.zeros(1))
        env.reset()
        after.append(np.array([env.step(np.zeros(1))[0] for _ in range(100)]))
    assert all(np.array_equal(after[0], other) for other in after[1:])


def test_returned_arrays_are_never_written_again():
    envs = ShakeTableVectorEnv(3, autoreset_mode="SameStep", duration=0.05)
    env = ShakeTableEnv(duration=0.05)
    kept = []

    def keep(*results):
        for result in results:
            if isinstance(result, dict):
                keep(*result.values())
            elif isinstance(result, np.ndarray) and result.dtype != object:
                kept.append((result, result.copy()))
            elif isinstance(result, np.ndarray):
                keep(*result)

    for episode in range(3):
        keep(*env.reset(seed=episode))
        for _ in range(10):
            keep(*env.step(np.full(1, 0.3)))
    keep(*envs.reset(seed=0))
    for _ in range(200):  # past several blocks and autoresets
        keep(*envs.step(np.full((3, 1), 0.3)))
    disabled = ShakeTableVectorEnv(3, autoreset_mode="Disabled", duration=0.05)
    for _ in range(3):
        keep(*disabled.reset(seed=0))
        for _ in range(10):
            keep(*disabled.step(np.full((3, 1), 0.3)))
    assert len(kept) > 1000
    for now, then in kept:
        assert np.array_equal(now, then)


def test_returned_arrays_may_be_written_to():
    envs, twin = (ShakeTableVectorEnv(2, **SHORT) for _ in range(2))
    first, _ = envs.reset(seed=0)
    twin.reset(seed=0)
    first[:] = 7.0
    for action in push(2, 120):
        results, expected = envs.step(action), twin.step(action)
        assert np.array_equal(results[0], expected[0])
        assert np.array_equal(results[1], expected[1])
        for array in (*results[:4], *results[4].values()):
            if array.dtype == bool:
                array[:] = ~array
            elif array.dtype != object:
                array[:] = 1e9


def test_reset_takes_a_motion_for_one_episode():
    motion = RecordedMotion(record="napa2014_68150_hne", duration=0.2)
    env = ShakeTableEnv(duration=0.5)
    env.reset(seed=0, options={"motion": motion})
    steps = 1
    while not env.step(np.zeros(1))[3]:
        steps += 1
    assert steps == 40
    env.reset()
    steps = 1
    while not env.step(np.zeros(1))[3]:
        steps += 1
    assert steps == 100
    envs = ShakeTableVectorEnv(2, duration=0.5)
    envs.reset(options={"motion": motion})
    assert [envs.step(np.zeros((2, 1)))[3].all() for _ in range(40)] == [False] * 39 + [True]


@pytest.mark.parametrize(
    "options", [{"motion": "napa"}, {"seed": 3}, {"motion": 4, "speed": 2}], ids=str
)
def test_bad_reset_options_raise(options):
    with pytest.raises(ScenarioError):
        ShakeTableEnv().reset(options=options)
    with pytest.raises(ScenarioError):
        ShakeTableVectorEnv(2).reset(options=options)


@pytest.mark.parametrize("number", [0, -1, 2.5, "4"])
def test_bad_number_of_lanes_raises(number):
    with pytest.raises(ParameterError, match="num_envs"):
        ShakeTableVectorEnv(number)


@pytest.mark.parametrize("through", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))])
@pytest.mark.parametrize("kind", ["single", "vector"])
def test_a_copied_env_goes_on_exactly(through, kind):
    lanes = 2
    env = ShakeTableEnv(**SHORT) if kind == "single" else ShakeTableVectorEnv(lanes, **SHORT)
    env.reset(seed=3)
    actions = push(lanes, 100)
    actions = actions[:, 0] if kind == "single" else actions
    for action in actions[:30]:
        env.step(action)
    twin = through(env)
    for action in actions[30:]:
        a, b = env.step(action), twin.step(action)
        assert np.array_equal(a[0], b[0]) and np.array_equal(a[1], b[1])
    env.reset()
    twin.reset()  # the next episode too
    for action in actions[:30]:
        assert np.array_equal(env.step(action)[0], twin.step(action)[0])


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


class Refusing:
    """An object of another library that cannot become an array."""

    def __array__(self, dtype=None, copy=None):
        raise RuntimeError("not on this device")


def gradient():
    torch = pytest.importorskip("torch")
    return torch.zeros(1, requires_grad=True)


@pytest.mark.parametrize(
    "action",
    [
        [10**400],
        10**400,
        np.array([1j]),
        [1 + 0j],
        np.ma.masked_array([0.1], mask=[True]),
        np.ma.masked_array([0.1]),
        np.array(["2020-01-01"], dtype="datetime64[D]"),
        np.array([3], dtype="timedelta64[s]"),
        ["0.1"],
        [None],
        [b"1"],
        {"current": 1},
        Refusing(),
        gradient,
        np.array([np.longdouble("1e400")]),
    ],
    ids=lambda a: type(a).__name__,
)
def test_actions_that_are_no_real_numbers_are_refused(action):
    action = action() if callable(action) else action
    env, vector = ShakeTableEnv(duration=1.0), ShakeTableVectorEnv(1, duration=1.0)
    for table, given in ((env, action), (vector, [action])):
        table.reset(seed=0)
        with pytest.raises(ActionError):
            table.step(given)


@pytest.mark.parametrize("action", [[0.25], np.array([0.25], np.float16), (0.25,), [np.float64(0.25)]])
def test_other_real_numbers_are_the_same_action(action):
    import torch

    results = []
    for given in (action, np.array([0.25]), torch.tensor([0.25])):
        env = ShakeTableEnv(duration=1.0)
        env.reset(seed=0)
        results.append(env.step(given)[1])
    assert results[0] == results[1] == results[2]


@pytest.mark.parametrize("options", [5, "motion", [("motion", None)], {"colour": 1}])
def test_options_that_are_none_are_refused(options):
    for env in (ShakeTableEnv(duration=1.0), ShakeTableVectorEnv(2, duration=1.0)):
        with pytest.raises(ScenarioError, match="reset option"):
            env.reset(options=options)


@pytest.mark.parametrize("seed", [1.5, math.nan, -1, "1", True, np.array(1.5)])
def test_seeds_that_are_no_whole_numbers_are_refused(seed):
    for env in (ShakeTableEnv(duration=1.0), ShakeTableVectorEnv(2, duration=1.0)):
        with pytest.raises(ParameterError, match="seed"):
            env.reset(seed=seed)
    with pytest.raises(ParameterError, match=r"seed\[1\]"):
        ShakeTableVectorEnv(2, duration=1.0).reset(seed=[1, seed])
