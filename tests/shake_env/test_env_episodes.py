"""The Gymnasium environments over episodes: seeds, ends, returned arrays, options of a reset, copies."""

import copy
import hashlib
import math
import pickle
import subprocess
import sys

import numpy as np
import pytest
from short_env import SHORT, push

from shake_env import (
    RecordedMotion,
    ShakeTableEnv,
    ShakeTableVectorEnv,
)
from shake_env.errors import ActionError, ParameterError, ScenarioError


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
        np.array([1], dtype="datetime64[ns]"),  # tolist() gives whole numbers of these two
        np.array([1], dtype="timedelta64[ns]"),
        np.array([10**400], dtype=object),
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
