"""What learning costs beside the tables: PPO's share of time in them, a gradient through the plant."""

from __future__ import annotations

import ctypes
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

from agents.learning.vec_env import ShakeTableVecEnv
from agents.policies.base_law import base_law
from agents.scenario_options import ScenarioOptions
from agents.training.algorithm_options import APGOptions, PPOOptions
from agents.training.config import TrainConfig
from agents.training.model_factory import new_model
from benchmarks.scaling import exponent
from benchmarks.timing import seconds_each

SCENARIOS = {"linear": "none", "laboratory": "lqg-dac"}  # and what a policy corrects there
WINDOWS = (32, 64, 128, 256, 512)
TABLES = 64


def learning(spell: float, spells: int, quick: bool) -> dict[str, Any]:
    """Return the shares of PPO's time, and cost and memory of gradients."""
    torch.set_num_threads(1)
    windows = WINDOWS[::2] if quick else WINDOWS
    return {
        "PPO": {name: ppo_shares(name, 2 if quick else 5) for name in SCENARIOS},
        "samples/s": learned(1 if quick else 3),
        "gradient": {name: gradients(name, windows, spell, spells) for name in SCENARIOS},
    }


def _model(config: TrainConfig, base: str) -> Any:
    scenario = config.scenario.build()
    chosen = config.chosen
    env = ShakeTableVecEnv(
        scenario,
        TABLES,
        base=base_law(base, scenario),
        authority=chosen.residual_scale,
        reward_scale=0.01,
    )
    return new_model(config, scenario, env)


def _timed(owner: Any, name: str, taken: list[float]) -> None:
    """Let a method of one object add up its CPU seconds in the last entry of a list."""
    call = getattr(owner, name)

    def timed(*arguments: Any, **options: Any) -> Any:
        begin = time.process_time()
        result = call(*arguments, **options)
        taken[-1] += time.process_time() - begin
        return result

    setattr(owner, name, timed)


def ppo_shares(scenario: str, updates: int) -> dict[str, float]:
    """Return the share of PPO's roll-outs, and of all its time, in which 64 tables are stepped.

    As `shake train` sets PPO up: roll-outs of 128 periods, ten passes in batches of 2048. On the
    laboratory the policy corrects a law behind an estimator, whose batch counts as stepping.
    """
    config = TrainConfig(
        scenario=ScenarioOptions(scenario=scenario), ppo=PPOOptions(base_controller=SCENARIOS[scenario])
    )
    model = _model(config, SCENARIOS[scenario])
    steps: list[float] = [0.0]
    rollouts: list[float] = [0.0]
    whole: list[float] = []
    _timed(model.env, "step", steps)
    _timed(model, "collect_rollouts", rollouts)
    model.learn(model.n_steps * TABLES)  # sets up, compiles
    for _ in range(updates):
        for taken in (steps, rollouts):
            taken.append(0.0)
        begin = time.process_time()
        model.learn(model.n_steps * TABLES, reset_num_timesteps=False)
        whole.append(time.process_time() - begin)
    steps, rollouts = steps[-updates:], rollouts[-updates:]
    return {
        "share of roll-outs": float(np.median(np.divide(steps, rollouts))),
        "share of all": float(np.median(np.divide(steps, whole))),
        "a period of 64 tables [s]": float(np.median(steps)) / model.n_steps,
    }


def learned(updates: int) -> dict[str, float]:
    """Return the samples that SB3's PPO learns from in a second, by the wall clock.

    64 environments, roll-outs of 128 periods, ten passes in batches of 2048, two networks of 64 x 64: on
    the linear table, and on CartPole in SB3's DummyVecEnv.
    """
    tables = ShakeTableVecEnv(ScenarioOptions().build(), TABLES, reward_scale=0.01)
    carts = DummyVecEnv([lambda: gymnasium.make("CartPole-v1") for _ in range(TABLES)])
    rates = {}
    for name, env in {"linear": tables, "CartPole-v1": carts}.items():
        model = PPO("MlpPolicy", env, n_steps=128, batch_size=2048, n_epochs=10, seed=0, device="cpu")
        samples = model.n_steps * TABLES
        model.learn(samples)
        times = []
        for _ in range(updates):
            begin = time.perf_counter()
            model.learn(samples, reset_num_timesteps=False)
            times.append(time.perf_counter() - begin)
        rates[name] = samples / float(np.median(times))
    return rates


def gradients(
    scenario: str, windows: tuple[int, ...], spell: float, spells: int
) -> dict[str, dict[str, Any]]:
    """Return seconds and bytes of a gradient by window, whole and in segments, and fitted exponents.

    A forward pass follows 64 tables over the window without a graph; a gradient follows them with one
    and goes back. Segments are of the window's square root.
    """
    config = TrainConfig(
        algorithm="apg",
        scenario=ScenarioOptions(scenario=scenario),
        apg=APGOptions(base_controller=SCENARIOS[scenario], residual_scale=0.3),
    )
    model = _model(config, SCENARIOS[scenario])
    model._setup_learn(1)
    start = model.env.get_state()

    def set_up(window: int, segment: int) -> None:
        model.window, model.checkpoint = window, segment
        model.env.set_state(start)

    def forward(window: int) -> Callable[[], None]:
        def call() -> None:
            set_up(window, 0)
            with torch.no_grad():
                model.window_loss()

        return call

    def gradient(window: int, segment: int) -> Callable[[], None]:
        def call() -> None:
            set_up(window, segment)
            torch.autograd.grad(model.window_loss()[0], model._actor)

        return call

    ways = {
        "forward": {window: forward(window) for window in windows},
        "gradient": {window: gradient(window, 0) for window in windows},
        "in segments": {window: gradient(window, math.isqrt(window)) for window in windows},
    }
    work = {f"{way} {window}": call for way, calls in ways.items() for window, call in calls.items()}
    times = seconds_each(work, spell, spells)
    results: dict[str, dict[str, Any]] = {}
    for way, calls in ways.items():
        seconds = {str(window): times[f"{way} {window}"] for window in calls}
        memory = {str(window): peak(call) for window, call in calls.items()}
        results[way] = {
            "seconds": seconds,
            "bytes": memory if all(memory.values()) else None,
            "exponent of time": exponent(seconds, 3),
            "exponent of memory": exponent(memory, 3) if all(memory.values()) else None,
        }
    return results


def peak(call: Callable[[], None]) -> int | None:
    """Return the bytes by which a call raises this process's resident memory; None where not Linux.

    What was freed before is given back to the system first, so that it is not counted as free room.
    """
    status, reset = Path("/proc/self/status"), Path("/proc/self/clear_refs")
    if not reset.exists():
        return None
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    reset.write_text("5", encoding="ascii")  # the highest mark back to what is resident now
    before = _kibibytes(status, "VmRSS")
    call()
    return 1024 * max(_kibibytes(status, "VmHWM") - before, 1)


def _kibibytes(status: Path, name: str) -> int:
    lines = status.read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name))
