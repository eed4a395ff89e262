"""What a run is at, as arrays and plain JSON values: random generators, and the tables of a `VecEnv`.

Reading any of it runs no code: every object is made here, of a kind that is named here.
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from agents.learning.vec_env import ShakeTableVecEnv
from shake_env.motion.targets import EpisodeMotion, MotionSet
from shake_env.scenario.scenario import Scenario

Arrays = dict[str, NDArray[Any]]
PLANTS = "plant_values"  # what was drawn for each table, in a state of tables
ARRAY = "array"  # key of an object that stands for an array, by its name
_BITS = {"PCG64": np.random.PCG64, "PCG64DXSM": np.random.PCG64DXSM}
_WORDS = 624  # of the state of a Mersenne twister


def split_state(value: Any, name: str = "state") -> tuple[Any, Arrays]:
    """Return a training state's nest as JSON values, and its arrays and tensors by name.

    Raises
    ------
    TypeError
        If it holds anything else than these, numbers, words, truth values and None.
    """
    arrays: Arrays = {}

    def plain(part: Any, name: str) -> Any:
        if isinstance(part, torch.Tensor):
            part = part.detach().cpu().numpy()
        if isinstance(part, np.ndarray):
            arrays[name] = np.array(part, order="C")
            return {ARRAY: name}
        if isinstance(part, Mapping):
            return {str(key): plain(each, f"{name}.{key}") for key, each in part.items()}
        if isinstance(part, list | tuple):
            return [plain(each, f"{name}.{i}") for i, each in enumerate(part)]
        if isinstance(part, np.generic):
            return part.item()
        if part is None or isinstance(part, bool | int | float | str):
            return part
        raise TypeError(f"{name} is a {type(part).__name__}, which is no plain value")

    return plain(value, name), arrays


def join_state(value: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    """Return the nest that :func:`split_state` made parts of; arrays for tensors, lists for tuples."""
    if isinstance(value, dict):
        if set(value) == {ARRAY}:
            return arrays[value[ARRAY]]
        return {key: join_state(each, arrays) for key, each in value.items()}
    return [join_state(each, arrays) for each in value] if isinstance(value, list) else value


def require_form(value: Any, like: Any, name: str) -> None:
    """Raise ValueError unless a nest has the keys, lengths, types and array shapes of another."""
    if isinstance(like, np.ndarray):
        fits = isinstance(value, np.ndarray) and (value.shape, value.dtype) == (like.shape, like.dtype)
        _require(fits, name, f"must be of shape {like.shape} and type {like.dtype}")
    elif isinstance(like, Mapping):
        _require(isinstance(value, Mapping) and set(value) == set(like), name, "lacks a part")
        for key, part in like.items():
            require_form(value[key], part, f"{name}.{key}")
    elif isinstance(like, list | tuple):
        _require(isinstance(value, list | tuple) and len(value) == len(like), name, "has another length")
        for i, part in enumerate(like):
            require_form(value[i], part, f"{name}.{i}")
    else:
        _require(type(value) is type(like), name, f"must be of type {type(like).__name__}")


def whole_number(value: Any, name: str, most: int) -> int:
    """Return a whole number from 0 to `most`; ValueError for anything else."""
    _require(type(value) is int and 0 <= value <= most, name, f"must be a whole number of 0 to {most}")
    number: int = value
    return number


# Random generators


def generator_state(generator: np.random.Generator | None) -> dict[str, Any] | None:
    """Return where a random generator stands, with the seed that its children are spawned from."""
    if generator is None:
        return None
    bits = generator.bit_generator
    seed = bits.seed_seq
    if type(bits).__name__ not in _BITS or not isinstance(seed, np.random.SeedSequence):
        raise TypeError(f"{type(bits).__name__} is no generator that a checkpoint keeps")
    entropy = seed.entropy
    return {
        "bits": type(bits).__name__,
        "state": bits.state["state"],
        "has_uint32": bits.state["has_uint32"],
        "uinteger": bits.state["uinteger"],
        "entropy": entropy if entropy is None or isinstance(entropy, int) else [int(e) for e in entropy],
        "spawn_key": [int(key) for key in seed.spawn_key],
        "children": seed.n_children_spawned,
    }


def restore_generator(state: Mapping[str, Any] | None) -> np.random.Generator | None:
    """Return the random generator that :func:`generator_state` describes."""
    if state is None:
        return None
    seed = np.random.SeedSequence(
        state["entropy"],
        spawn_key=tuple(state["spawn_key"]),
        n_children_spawned=whole_number(state["children"], "children", 2**31),
    )
    bits = _BITS[state["bits"]](seed)
    bits.state = {
        "bit_generator": state["bits"],
        "state": {key: int(state["state"][key]) for key in ("state", "inc")},
        "has_uint32": int(state["has_uint32"]),
        "uinteger": int(state["uinteger"]),
    }
    return np.random.Generator(bits)


def global_generators() -> dict[str, Any]:
    """Return where the generators of the process stand: torch's, numpy's old one and Python's."""
    old: Any = np.random.get_state(legacy=False)  # noqa: NPY002  # SB3 draws its minibatches from it
    version, words, pair = random.getstate()
    return {
        "torch": torch.get_rng_state(),
        "numpy": {**old["state"], "has_gauss": old["has_gauss"], "gauss": old["gauss"]},
        "python": [version, list(words), pair],
    }


def set_global_generators(state: Mapping[str, Any]) -> None:
    """Put the generators of the process where :func:`global_generators` found them."""
    numpy, (version, words, pair) = state["numpy"], state["python"]
    require_form(numpy["key"], np.zeros(_WORDS, np.uint32), "numpy.key")
    old = {
        "bit_generator": "MT19937",
        "state": {"key": numpy["key"], "pos": whole_number(numpy["pos"], "numpy.pos", _WORDS)},
        "has_gauss": int(numpy["has_gauss"]),
        "gauss": float(numpy["gauss"]),
    }
    random.setstate((version, tuple(words), pair))
    np.random.set_state(old)  # noqa: NPY002
    torch.set_rng_state(torch.from_numpy(np.array(state["torch"])))


# The tables


def tables_state(env: ShakeTableVecEnv) -> dict[str, Any]:
    """Return the state of the tables without objects: generators and motions as what they are."""
    state, motions = dict[str, Any](env.get_state()), _motions(env.scenario)
    state["motion"] = [motions.index(motion) for motion in state["motion"]]
    state["stream"] = [generator_state(stream) for stream in state["stream"]]
    if PLANTS in state:
        state[PLANTS] = list(state[PLANTS])
    return state


def restore_tables(env: ShakeTableVecEnv, state: Mapping[str, Any]) -> None:
    """Put the tables, of which each has begun an episode, where :func:`tables_state` found them.

    Raises
    ------
    ValueError, TypeError, KeyError
        If they are others' tables, or it describes none.
    """
    _require_tables(state, tables_state(env), env)
    motions = _motions(env.scenario)
    places = [whole_number(place, "motion", len(motions) - 1) for place in state["motion"]]
    objects: dict[str, list[Any]] = {
        "motion": [motions[place] for place in places],
        "stream": [restore_generator(stream) for stream in state["stream"]],
    }
    if PLANTS in state:
        objects[PLANTS] = state[PLANTS]
    arrays = {name: np.empty(env.num_envs, dtype=object) for name in objects}
    for name, array in arrays.items():
        array[:] = objects[name]
    env.set_state({**state, **arrays})


def _require_tables(state: Mapping[str, Any], like: Mapping[str, Any], env: ShakeTableVecEnv) -> None:
    """Compare all but generators and drawn plants."""
    varied = [name for name in ("stream", PLANTS) if name in like]
    for name in varied:
        each = state[name]
        fits = isinstance(each, list) and len(each) == env.num_envs
        _require(fits, "tables", f"must be {env.num_envs}")
    without = dict.fromkeys(varied)
    require_form({**state, **without}, {**like, **without}, "tables")
    for name in ("step_count", "episode_steps", "period"):
        counts = state[name]
        inside = bool((counts >= 0).all() and (counts < 2**31).all())
        _require(inside, "steps", "must not be below 0")


def _motions(scenario: Scenario) -> Sequence[EpisodeMotion]:
    motion = scenario.motion
    return motion.scaled if isinstance(motion, MotionSet) else (motion,)


def _require(holds: bool, name: str, remedy: str) -> None:
    if not holds:
        raise ValueError(f"{name} {remedy}")
