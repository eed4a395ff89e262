"""Environments against their peers: Gymnasium's CartPole alone, vectorised, and in SB3's DummyVecEnv."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv

from agents.learning.vec_env import ShakeTableVecEnv
from benchmarks.timing import seconds_each
from shake_env import Uncertainty, Uniform, make_scenario

STORIES = 5
STEPS = 50  # of each call, so that the loop around a step is not what is measured
OWN = Uncertainty(mass_ratio=Uniform(0.1, 1.0), storey_frequency=Uniform(5.0, 9.0))


def stepper(env: Any, action: Any) -> Callable[[], None]:
    """Return a call that makes STEPS steps of one environment, reset whenever an episode ends."""
    env.reset(seed=0)

    def call() -> None:
        for _ in range(STEPS):
            *_, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()

    return call


def vector(env: Any, action: Any) -> Callable[[], None]:
    """Return a call that makes STEPS steps of a vector environment, which resets itself."""
    env.reset(seed=0)

    def call() -> None:
        for _ in range(STEPS):
            env.step(action)

    return call


def stable(env: Any, action: Any) -> Callable[[], None]:
    """Return a call that makes STEPS steps of an SB3 VecEnv."""
    env.seed(0)
    env.reset()

    def call() -> None:
        for _ in range(STEPS):
            env.step(action)

    return call


def shake(scenario: str, **options: Any) -> Any:
    return gymnasium.make("shake_env:ShakeTable-v0", scenario=scenario, **options)


def shake_vector(number: int, scenario: str, **options: Any) -> Any:
    return gymnasium.make_vec(
        "shake_env:ShakeTable-v0",
        num_envs=number,
        vectorization_mode="vector_entry_point",
        scenario=scenario,
        **options,
    )


def single(spell: float, spells: int) -> dict[str, float]:
    """Return the steps a second of one environment, through `gymnasium.make` with its wrappers."""
    still = np.zeros(1, dtype=np.float32)
    work = {
        "CartPole-v1": stepper(gymnasium.make("CartPole-v1"), 1),
        "linear, n_m = 2": stepper(shake("linear", stories=2), still),
        "linear, n_m = 5": stepper(shake("linear", stories=STORIES), still),
        "linear, n_m = 10": stepper(shake("linear", stories=10), still),
        "laboratory": stepper(shake("laboratory"), still),
        "yielding": stepper(shake("yielding"), still),
        "records": stepper(shake("records"), still),
    }
    return {name: STEPS / each for name, each in seconds_each(work, spell, spells).items()}


def vectors(spell: float, spells: int) -> dict[str, dict[str, float]]:
    """Return the table-steps a second of vector environments, by their number of tables."""
    per_second = {}
    for number in (64, 256, 1024):
        cart = gymnasium.make_vec(
            "CartPole-v1", num_envs=number, vectorization_mode="vector_entry_point"
        )
        still = np.zeros((number, 1), dtype=np.float32)
        work = {
            "CartPole-v1": vector(cart, np.ones(number, dtype=np.int64)),
            "linear": vector(shake_vector(number, "linear", stories=STORIES), still),
            "linear, recorded motion": vector(
                shake_vector(number, "linear", stories=STORIES, record="napa2014_68150_hne"), still
            ),
            "laboratory": vector(shake_vector(number, "laboratory"), still),
            "yielding": vector(shake_vector(number, "yielding"), still),
            "laboratory, a specimen each": vector(
                shake_vector(number, "laboratory", uncertainty=OWN), still
            ),
        }
        if number == 64:
            carts = DummyVecEnv([lambda: gymnasium.make("CartPole-v1") for _ in range(number)])
            work["CartPole-v1, SB3 DummyVecEnv"] = stable(carts, np.ones(number, dtype=np.int64))
            tables = ShakeTableVecEnv(make_scenario("linear", {"stories": STORIES}), number)
            work["linear, SB3 VecEnv"] = stable(tables, still)
        rates = seconds_each(work, spell, spells)
        per_second[f"{number} tables"] = {name: number * STEPS / each for name, each in rates.items()}
    return per_second


def threads(spell: float, spells: int) -> dict[str, dict[str, float]]:
    """Return the table-steps a second, by the wall clock, with two threads beside CartPole's one."""
    rates = {}
    for number in (1024, 4096):
        cart = gymnasium.make_vec(
            "CartPole-v1", num_envs=number, vectorization_mode="vector_entry_point"
        )
        still = np.zeros((number, 1), dtype=np.float32)
        work = {"CartPole-v1": vector(cart, np.ones(number, dtype=np.int64))}
        for count, name in ((1, "linear"), (2, "linear, two threads")):
            tables = shake_vector(number, "linear", stories=STORIES, threads=count)
            work[name] = vector(tables, still)
        each = seconds_each(work, spell, spells, time.perf_counter)
        rates[f"{number} tables"] = {name: number * STEPS / s for name, s in each.items()}
    return rates


def resets(spell: float, spells: int) -> dict[str, float]:
    """Return the seconds of a reset, through `gymnasium.make`."""

    def again(scenario: str) -> Callable[[], object]:
        env = shake(scenario)
        env.reset(seed=0)
        return lambda: [env.reset() for _ in range(10)]

    work = {name: again(name) for name in ("linear", "laboratory", "unknown-specimen")}
    return {name: each / 10 for name, each in seconds_each(work, spell, spells).items()}
