"""The vector environment: each lane is the single environment, in every autoreset mode."""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from shake_env import (
    Limits,
    ShakeTableEnv,
    ShakeTableVectorEnv,
    make_scenario,
)
from shake_env.env import INFO_KEYS
from shake_env.errors import ParameterError, ScenarioError

MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED]
SHORT = {"duration": 0.5}


def push(lanes, steps, seed=0, size=0.1):
    rng = np.random.default_rng(seed)
    return rng.uniform(-size, size, (steps, lanes, 1)).astype(np.float32)


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
