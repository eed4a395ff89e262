"""The Gymnasium environments: contract, spaces, reward, ends, autoreset, and lanes as single tables."""

import copy
import hashlib
import pickle
import re
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import RecordEpisodeStatistics, TimeLimit

from baselines.lqr import lqr
from shake_env import (
    Limits,
    Objective,
    RecordedMotion,
    ShakeTableEnv,
    ShakeTableVectorEnv,
    make_scenario,
)
from shake_env.env import INFO_KEYS
from shake_env.errors import ActionError, ParameterError, ScenarioError
from shake_env.simulation import Simulation

MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED]
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


def test_docstring_is_the_contract_of_info_and_arguments():
    document = ShakeTableEnv.__doc__
    section = document.split("## Info")[1].split("##")[0]
    assert set(re.findall(r"``(\w+)``", section)) == set(INFO_KEYS)
    env = ShakeTableEnv(**SHORT)
    assert set(env.reset(seed=0)[1]) == set(INFO_KEYS)
    assert set(env.step(np.zeros(1))[4]) == set(INFO_KEYS)
    from shake_env.scenario import Overrides

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
    ("limits", "reason"),
    [
        (Limits(table_displacement=1e-4), "table_displacement"),
        (Limits(table_velocity=1e-2), "table_velocity"),
        (Limits(load_pressure=1e5), "load_pressure"),
        (Limits(table_acceleration=1.0), "table_acceleration"),
        (Limits(state_limit=0.5), "diverged"),
        ("laboratory", None),
    ],
    ids=str,
)
def test_a_broken_limit_terminates_and_costs(limits, reason):
    env = ShakeTableEnv(limits=limits, duration=2.0)
    observation, _ = env.reset(seed=0)
    taken, terminated = 0, False
    while not terminated:
        observation, reward, terminated, truncated, info = env.step(np.ones(1))
        taken += 1
        assert terminated or (info["limit_cost"] == 0.0 and "broken_limit" not in info)
    assert not truncated
    assert env.observation_space.contains(observation)
    if reason is not None:
        assert info["broken_limit"] == reason
    # Five times the stationary cost of standing still, 2, for each period left.
    assert info["limit_cost"] == pytest.approx(5.0 * 2.0 * (400 - taken), rel=1e-9)
    assert reward < -info["limit_cost"]
    with pytest.raises(ScenarioError, match="reset"):
        env.step(np.zeros(1))


@pytest.mark.parametrize("limit", ["table_displacement", "table_velocity", "load_pressure"])
def test_a_limit_holds_up_to_its_value(limit):
    """The state that breaks a limit is the first beyond it."""
    free = ShakeTableEnv(duration=1.0)
    free.reset(seed=0)
    history = [abs(free.step(np.full(1, 0.2))[4][limit]) for _ in range(30)]
    bound = np.median(history)
    first = int(np.argmax(np.array(history) > bound))
    env = ShakeTableEnv(duration=1.0, limits=Limits(**{limit: bound}))
    env.reset(seed=0)
    for t in range(first + 1):
        terminated = env.step(np.full(1, 0.2))[2]
        assert terminated == (t == first)


def test_a_limit_broken_on_the_last_step_is_no_truncation():
    env = ShakeTableEnv(limits=Limits(load_pressure=1e5), duration=0.1)
    env.reset(seed=0)
    for _ in range(19):
        assert env.step(np.zeros(1))[2:4] == (False, False)
    *_, terminated, truncated, info = env.step(np.ones(1))
    assert (terminated, truncated) == (True, False)
    assert info["limit_cost"] == pytest.approx(10.0, rel=1e-9)  # of one period at least


def test_divergence_ends_an_episode_even_without_limits():
    # The negative of LQR's gain is unstable: it pumps the oil column as far as the current reaches.
    scenario = make_scenario("linear", {"duration": 20.0})
    controller = lqr(scenario)
    limited = ShakeTableEnv(scenario, limits=Limits(state_limit=5.0))
    observation, _ = limited.reset(seed=0)
    for _ in range(4000):
        action, _ = controller.predict(observation)
        observation, _, terminated, truncated, info = limited.step(-action)
        if terminated or truncated:
            break
    assert terminated and info["broken_limit"] == "diverged"


def test_drifting_position_alone_never_ends_an_episode():
    scenario = make_scenario("linear", {"duration": 20.0})
    env = ShakeTableEnv(scenario)
    env.reset(seed=0)
    for _ in range(3999):
        observation, _, terminated, _, info = env.step(np.full(1, 0.4))
        assert not terminated
    # 0.05 A give 114 l/min, 0.8 m/s for twenty seconds.
    assert info["table_displacement"] > 5.0
    assert env.observation_space.contains(observation)


def crashes(overrides, lanes=200):
    """Costs from a random moment on: of running into a limit there, and of standing still."""
    scenario = make_scenario("linear", {"limits": "laboratory", **overrides})

    def costs(policy):
        simulation = Simulation(scenario, lanes)
        simulation.start(range(lanes), [np.random.default_rng(i) for i in range(lanes)])
        steps = int(simulation.episode_steps[0])
        cost, over, broke = np.zeros((steps, lanes)), np.zeros(lanes, bool), np.zeros(lanes, bool)
        for t in range(steps):
            result = simulation.step(policy(t, steps))
            cost[t] = np.where(over, 0.0, -result.reward)
            broke |= result.terminated & ~over
            over |= result.terminated
        return cost, broke

    steps_all = np.arange(lanes)
    still, _ = costs(lambda t, steps: np.zeros(lanes))
    results = []
    for sign in (1.0, -1.0):
        begin = np.linspace(0, len(still) - 1, lanes).astype(int)
        crash, broke = costs(lambda t, steps, b=begin, s=sign: np.where(t >= b, s, 0.0))
        after = np.arange(len(still))[:, None] >= begin
        results.append(((crash * after).sum(0)[broke], (still * after).sum(0)[broke]))
        assert len(steps_all[broke]) > 0.9 * lanes
    return np.concatenate(results, axis=1)


@pytest.mark.parametrize(
    "overrides",
    [
        {"duration": 6.0},
        {"duration": 6.0, "amplitude": 3.0},
        {"duration": 6.0, "amplitude": 0.34, "highpass_frequency": 0.5},
        {"duration": 6.0, "objective": Objective.raw(1.0, 1e-3)},
        {"record": "napa2014_68150_hne", "duration": 10.0},
    ],
    ids=str,
)
def test_crashing_never_pays(overrides):
    crash, still = crashes(overrides)
    assert np.all(crash > still), np.min(crash / still)


def test_the_cost_of_a_limit_grows_with_the_motion():
    # Without this a strong motion makes standing still dearer than a crash.
    costs = []
    for amplitude in (0.3, 1.0, 3.0):
        env = ShakeTableEnv(limits=Limits(load_pressure=1e5), duration=1.0, amplitude=amplitude)
        env.reset(seed=0)
        costs.append(env.step(np.ones(1))[4]["limit_cost"])
    assert costs == pytest.approx([1990.0, 1990.0, 9 * 1990.0], rel=1e-9)


def test_the_horizon_of_the_limit_cost():
    env = ShakeTableEnv(limits=Limits(load_pressure=1e5, cost_horizon=0.1), duration=1.0)
    env.reset(seed=0)
    assert env.step(np.ones(1))[4]["limit_cost"] == pytest.approx(10.0 * 20, rel=1e-9)


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


@pytest.mark.parametrize("mode", MODES)
def test_vector_step_before_reset_raises(mode):
    envs = ShakeTableVectorEnv(2, autoreset_mode=mode, **SHORT)
    with pytest.raises(ScenarioError, match="reset"):
        envs.step(np.zeros((2, 1)))
    # A first reset of one lane does not start the other.
    envs.reset(seed=0, options={"reset_mask": np.array([True, False])})
    with pytest.raises(ScenarioError, match=r"lanes = \[1\].*reset"):
        envs.step(np.zeros((2, 1)))


def test_vector_step_after_an_end_raises_where_nothing_resets():
    envs = ShakeTableVectorEnv(2, autoreset_mode="Disabled", **SHORT)
    envs.reset(seed=0)
    for action in push(2, 100):
        envs.step(action)
    with pytest.raises(ScenarioError, match=r"\[0, 1\]"):
        envs.step(np.zeros((2, 1)))
    envs.reset(options={"reset_mask": np.array([False, True])})
    with pytest.raises(ScenarioError, match=r"\[0\]"):
        envs.step(np.zeros((2, 1)))


def compare_info(found, expected, lanes, where):
    """Every value that Gymnasium's own vector info marks as present, in ours too."""
    for key, value in expected.items():
        if key.startswith("_"):
            assert np.array_equal(found[key], value), (where, key)
        elif key == "final_info":
            compare_info(found[key], value, lanes, where)
        else:
            for lane in np.flatnonzero(expected[f"_{key}"]):
                a, b = found[key][lane], value[lane]
                if isinstance(b, str):
                    assert a == b, (where, key, lane)
                else:
                    size = 1.0 + np.max(np.abs(b))
                    tolerance = 2e-7 if key == "final_obs" else 1e-10
                    assert np.max(np.abs(np.asarray(a) - b)) <= tolerance * size, (where, key, lane)
    assert set(found) == set(expected), where


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    "overrides",
    [{}, {"limits": Limits(table_displacement=2e-3, table_velocity=0.2)}],
    ids=["truncated", "terminated"],
)
def test_vector_env_is_gymnasiums_sync_vector_env_of_single_envs(mode, overrides):
    lanes, steps = 4, 330
    scenario = make_scenario("linear", {**SHORT, **overrides})
    ours = ShakeTableVectorEnv(lanes, scenario, autoreset_mode=mode)
    theirs = SyncVectorEnv([lambda: ShakeTableEnv(scenario)] * lanes, autoreset_mode=mode)
    found, expected = ours.reset(seed=21), theirs.reset(seed=21)
    assert np.array_equal(found[0], expected[0])
    compare_info(found[1], expected[1], lanes, "reset")
    ends = np.zeros(lanes, dtype=int)
    for t, action in enumerate(push(lanes, steps, size=0.15)):
        found, expected = ours.step(action), theirs.step(action)
        size = 1.0 + np.max(np.abs(expected[0]))
        # Batches of other sizes sum in another order: 1e-16, which may flip a float32 rounding.
        assert np.max(np.abs(found[0] - expected[0])) <= 2e-7 * size, t
        assert found[1] == pytest.approx(expected[1], rel=1e-10, abs=1e-10), t
        assert np.array_equal(found[2], expected[2]) and np.array_equal(found[3], expected[3]), t
        compare_info(found[4], expected[4], lanes, t)
        done = found[2] | found[3]
        ends += done
        if mode == AutoresetMode.DISABLED and done.any():
            found = ours.reset(options={"reset_mask": done})
            expected = theirs.reset(options={"reset_mask": done.copy()})
            assert np.max(np.abs(found[0] - expected[0])) <= 2e-7 * size
            compare_info(found[1], expected[1], lanes, (t, "reset"))
    assert np.all(ends >= 3)
    if overrides:
        assert len(set(ends)) > 1  # lanes end apart


def test_same_step_autoreset_hands_over_the_last_state():
    envs = ShakeTableVectorEnv(2, autoreset_mode="SameStep", **SHORT)
    single = ShakeTableEnv(**SHORT)
    envs.reset(seed=5)
    single.reset(seed=6)
    for _ in range(100):
        observation, _, _, truncated, info = envs.step(np.full((2, 1), 0.2))
        last = single.step(np.full(1, 0.2))
    assert truncated.all()
    assert info["final_obs"][1] == pytest.approx(last[0], abs=1e-6)
    for key in INFO_KEYS:
        assert info["final_info"][key][1] == pytest.approx(last[4][key], rel=1e-10), key
        assert info[key][1] == 0.0
    assert info["final_info"]["table_displacement"][1] > 1e-3
    assert np.array_equal(observation, np.zeros_like(observation))


@pytest.mark.parametrize("overrides", [{}, {"equations": "as_printed", "stories": 4}], ids=str)
def test_a_lane_is_the_same_in_any_batch_size(overrides):
    steps, scenario = 260, make_scenario("linear", {**SHORT, **overrides})
    actions = push(7, steps)
    histories = {}
    for lanes in (1, 2, 7):
        envs = ShakeTableVectorEnv(lanes, scenario)
        envs.reset(seed=[100 + i for i in range(lanes)])
        histories[lanes] = [envs.step(action[:lanes]) for action in actions]
    for lanes in (1, 2):
        for few, many in zip(histories[lanes], histories[7], strict=True):
            size = 1.0 + np.max(np.abs(many[0]))
            assert np.max(np.abs(few[0] - many[0][:lanes])) <= 2e-7 * size
            assert few[1] == pytest.approx(many[1][:lanes], rel=1e-10, abs=1e-12)
            assert np.array_equal(few[3], many[3][:lanes])


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


def test_a_list_of_seeds():
    envs = ShakeTableVectorEnv(3, **SHORT)
    envs.reset(seed=[7, 8, 7])
    found = np.array([envs.step(np.zeros((3, 1)))[0] for _ in range(20)])
    assert np.array_equal(found[:, 0], found[:, 2])
    assert not np.array_equal(found[:, 0], found[:, 1])
    envs.reset(seed=7)
    again = np.array([envs.step(np.zeros((3, 1)))[0] for _ in range(20)])
    assert np.array_equal(found[:, :2], again[:, :2])
    with pytest.raises(ParameterError, match="seed"):
        envs.reset(seed=[1, 2])


def test_a_seed_of_none_in_a_list_goes_on_with_that_lane():
    envs, plain = (ShakeTableVectorEnv(2, **SHORT) for _ in range(2))
    envs.reset(seed=[1, 2])
    envs.reset(seed=[1, None])
    plain.reset(seed=[1, 2])
    plain.reset()
    a, b = (np.array([e.step(np.zeros((2, 1)))[0] for _ in range(20)]) for e in (envs, plain))
    assert np.array_equal(a[:, 1], b[:, 1]) and not np.array_equal(a[:, 0], b[:, 0])


def test_reset_mask_leaves_the_other_lanes_alone():
    scenario = make_scenario("linear", {"duration": 2.0})
    masked = ShakeTableVectorEnv(3, scenario, autoreset_mode="Disabled")
    plain = ShakeTableVectorEnv(3, scenario, autoreset_mode="Disabled")
    masked.reset(seed=0)
    plain.reset(seed=0)
    actions = push(3, 200)
    for action in actions[:70]:  # the 70th step lies inside the second block
        before = masked.step(action)[0]
        plain.step(action)
    returned = before
    before = before.copy()
    returned[:] = 7.0  # the caller's to write to
    observation, info = masked.reset(seed=50, options={"reset_mask": np.array([False, True, False])})
    assert np.array_equal(observation[[0, 2]], before[[0, 2]])
    assert np.array_equal(observation[1], np.zeros(14))
    assert info["_current"].tolist() == [False, True, False]
    fresh = ShakeTableEnv(scenario)
    fresh.reset(seed=51)
    for action in actions[70:]:
        a, b, c = masked.step(action), plain.step(action), fresh.step(action[1])
        assert np.array_equal(a[0][[0, 2]], b[0][[0, 2]])
        assert a[0][1] == pytest.approx(c[0], rel=1e-6, abs=1e-6)
        assert a[1][1] == pytest.approx(c[1], rel=1e-10)


@pytest.mark.parametrize(
    "mask", [[True, False], np.array([1, 0]), np.array([True]), np.array([False, False]), "all"]
)
def test_bad_reset_mask_raises(mask):
    envs = ShakeTableVectorEnv(2)
    with pytest.raises(ParameterError, match="reset_mask"):
        envs.reset(options={"reset_mask": mask})


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


def test_rendering_is_refused():
    with pytest.raises(ScenarioError, match="render_mode"):
        ShakeTableEnv(render_mode="human")


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
