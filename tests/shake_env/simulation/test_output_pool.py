"""Memory that steps hand out: used again once nobody holds it, and never before."""

import copy
import gc
import pickle

import numpy as np
import pytest

from shake_env import ShakeTableVectorEnv, make_scenario
from shake_env.env import INFO_KEYS
from shake_env.simulation.batch_info import BatchInfo
from shake_env.simulation.output_pool import OutputPool
from shake_env.simulation.simulation import Simulation

pytest.importorskip("numba")


def test_memory_is_never_handed_out_twice_and_used_again_when_free():
    pool, rng = OutputPool(5, 32, 7), np.random.default_rng(0)
    held, used = [], set()
    for _ in range(500):
        memory, address = pool.take()
        assert all(address != other for _, other in held)
        used.add(address)
        views = pool.views(memory)
        held.append(
            (views[rng.integers(4)][..., :1], address)
        )  # a part of one array is enough to hold it
        del memory, views
        while len(held) > rng.integers(1, 12):
            held.pop(rng.integers(len(held)))
    del held
    gc.collect()
    assert len({pool.take()[1] for _ in range(4)}) == 1 and len(used) < 500


@pytest.mark.parametrize("kept", ["observation", "reward", "terminated", "info"])
def test_what_a_caller_keeps_never_changes(kept):
    env = ShakeTableVectorEnv(40, "linear")
    env.reset(seed=0)
    rng, saved = np.random.default_rng(0), []
    for _ in range(20):
        observation, reward, terminated, _, info = env.step(rng.uniform(-1, 1, (40, 1)))
        value = {
            "observation": observation[3:5],
            "reward": reward,
            "terminated": terminated,
            "info": info["base_shear"],
        }[kept]
        saved.append((value, value.copy()))
        del observation, reward, terminated, info, value
    for value, was in saved:
        np.testing.assert_array_equal(value, was)


def test_steps_that_are_let_go_take_turns_in_little_memory():
    sim = Simulation(make_scenario("linear"), 40)
    sim.start(range(40), [np.random.default_rng(i) for i in range(40)])
    addresses = {sim.step(np.zeros(40)).observation.ctypes.data for _ in range(50)}
    assert len(addresses) <= 2


def infos():
    report = np.arange(15.0)[:, None] + np.arange(4.0) / 8.0
    plain = {}
    for row, key in enumerate(INFO_KEYS):
        plain[key], plain[f"_{key}"] = report[row], np.ones(4, dtype=bool)
    return BatchInfo(report), plain


def same(ours, theirs):
    assert list(ours) == list(theirs)
    for key, value in theirs.items():
        np.testing.assert_array_equal(ours[key], value)


@pytest.mark.parametrize(
    "use",
    [
        lambda info: info,
        dict,
        lambda info: {**info},
        lambda info: dict(info.items()),
        lambda info: dict(zip(info.keys(), info.values(), strict=True)),
        copy.copy,
        copy.deepcopy,
        lambda info: info.copy(),
        lambda info: pickle.loads(pickle.dumps(info)),
        lambda info: info | {},
        lambda info: {} | info,
        lambda info: {key: info.get(key) for key in info},
        lambda info: {key: info[key] for key in (*INFO_KEYS[::-1], *info)} and info,
        lambda info: (info.__setitem__("other", 1), info.pop("other")) and info,
    ],
)
def test_an_info_is_a_dictionary_in_every_respect(use):
    ours, plain = infos()
    same(use(ours), plain)


def test_an_info_knows_what_it_holds_and_what_not():
    ours, plain = infos()
    assert len(ours) == len(plain) and bool(ours) and "base_shear" in ours and "_current" in ours
    assert "other" not in ours and ours.get("other", 5) == 5 and repr(infos()[0]) == repr(plain)
    for info in (ours, infos()[0]):
        with pytest.raises(KeyError):
            info["other"]
    fresh = infos()[0]
    fresh["base_shear"] = 1.0
    del fresh["current"]
    assert fresh["base_shear"] == 1.0 and "current" not in fresh and len(fresh) == len(plain) - 1
    assert infos()[0] != {}
