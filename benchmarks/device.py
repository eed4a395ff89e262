"""The torch path of a step on a device, beside what the device's memory can move in the same run.

And what an update of learning takes there and on the CPU: a gradient through the plant, and PPO's.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
import torch

from agents.learning.apg.torch_plant import torch_model
from agents.learning.vec_env import ShakeTableVecEnv
from agents.policies.base_law import base_law
from agents.scenario_options import ScenarioOptions
from agents.training.algorithm_options import APGOptions
from agents.training.config import TrainConfig
from agents.training.model_factory import new_model
from shake_env import make_scenario
from shake_env.dynamics.ground import GroundPeriod
from shake_env.simulation.sensors import SensorMemory
from shake_env.simulation.simulation import Simulation

SCENARIOS = {"linear": {"stories": 5}, "laboratory": {}}
POWERS = {"cpu": (10, 12, 14), "cuda": (10, 12, 14, 16, 18, 20)}
COPIED = 2**24  # numbers of the copy: beyond any cache


def device(spell: float, spells: int) -> dict[str, Any]:
    """Return table-steps a second in single precision by tables, and the memory's limit for them.

    A step is transition, cost, limits and observation; the ground is given, for its streams are numpy's.
    The limit takes each number of state, ground and observation as moved once between memory and device.
    Where there is no CUDA device, torch's CPU device stands in.
    """
    kind = "cuda" if torch.cuda.is_available() else "cpu"
    torch.set_num_threads(1)
    result: dict[str, Any] = {
        "device": torch.cuda.get_device_name() if kind == "cuda" else "cpu, one thread"
    }
    with torch.no_grad():
        source = torch.zeros(COPIED, dtype=torch.float32, device=kind)
        target = torch.empty_like(source)
        work: dict[str, Callable[[], object]] = {"copy": lambda: target.copy_(source)}
        moved = {}
        for name, options in SCENARIOS.items():
            for power in POWERS[kind]:
                key = f"{name} {2**power}"
                work[key], moved[key] = _step(name, options, 2**power, kind)
        times = _seconds(work, spell, spells, kind)
    bandwidth = 2 * 4 * COPIED / times["copy"]
    result["bandwidth [B/s]"] = bandwidth
    for name in SCENARIOS:
        rates = {str(2**power): 2**power / times[f"{name} {2**power}"] for power in POWERS[kind]}
        bytes_each = moved[f"{name} {2 ** POWERS[kind][-1]}"]
        result[name] = {"rates": rates, "bytes": bytes_each, "limit": bandwidth / bytes_each}
    kinds = ("cpu", "cuda") if kind == "cuda" else ("cpu",)
    updates = {way: {each: update(way, each) for each in kinds} for way in ("gradient", "PPO")}
    return result | {"updates": updates}


def update(way: str, kind: str) -> float:
    """Return the wall seconds of one update on ``"cpu"`` or ``"cuda"``, median of three.

    ``"gradient"``: a window of 96 periods of 1024 laboratory tables, there and back, plant and law in
    single precision. ``"PPO"``: a roll-out of 128 periods of 64 linear tables, which numpy steps, and
    ten passes over it.
    """
    gradient = way == "gradient"
    config = TrainConfig(
        algorithm="apg" if gradient else "ppo",
        scenario=ScenarioOptions(scenario="laboratory" if gradient else "linear"),
        apg=APGOptions(
            base_controller="lqg-dac", n_envs=1024, residual_scale=0.3, precision="float32", device=kind
        ),
    )
    scenario, chosen = config.scenario.build(), config.chosen
    env = ShakeTableVecEnv(
        scenario,
        chosen.n_envs,
        base=base_law(chosen.base_controller, scenario),
        authority=chosen.residual_scale,
        reward_scale=0.01,
    )
    model = new_model(config, scenario, env)
    if not gradient:
        model.device = torch.device(kind)  # experiments keep PPO's small networks on the CPU
        model._setup_model()
    periods = 96 if gradient else config.ppo.n_steps
    taken = []
    for number in range(4):  # the first one sets up, and compiles
        begin = time.perf_counter()
        model.learn(periods * chosen.n_envs, reset_num_timesteps=number == 0, log_interval=None)
        taken.append(time.perf_counter() - begin)
    return statistics.median(taken[1:])


def _step(name: str, options: dict[str, Any], tables: int, kind: str) -> tuple[Any, int]:
    """Return a call that steps so many tables, and the bytes that a table's step has to move."""
    scenario = make_scenario(name, options)
    simulation = Simulation(scenario, 1)
    simulation.start([0], [np.random.default_rng(0)])
    like = torch.zeros(1, dtype=torch.float32, device=kind)
    model = torch_model(simulation.model, like)
    ground = _wide(simulation.advance_ground()[0].to(like), tables)
    memory = _wide(simulation.memory.to(like), tables)
    readings = memory.bias.shape[-1]
    noise = torch.zeros((tables, readings), device=kind)
    action = torch.zeros(tables, device=kind)
    state = torch.zeros((tables, simulation.state.shape[1]), device=kind)

    def call() -> torch.Tensor:
        nonlocal state, memory
        outcome = model.transition(state, action, ground)
        state = outcome.response.state
        observation, memory = model.observe(outcome, ground, action, memory, noise)
        return observation

    shown = call().shape[1]
    given = [getattr(ground, field.name) for field in fields(GroundPeriod)]
    remembered = sum(part[0].numel() for part in vars(memory).values())
    numbers = sum(part[0].numel() for part in given if part is not None)
    return call, 4 * (numbers + 2 * (state.shape[1] + remembered) + readings + shown + 2)


def _wide(parts: Any, tables: int) -> Any:
    """Return the arrays of one table as those of many, in memory of their own."""
    kind: type[GroundPeriod] | type[SensorMemory] = type(parts)
    columns = (getattr(parts, field.name) for field in fields(kind))
    return kind(*(c if c is None else c.repeat(tables, *(1,) * (c.dim() - 1)) for c in columns))


def _seconds(
    work: dict[str, Callable[[], object]], spell: float, spells: int, kind: str
) -> dict[str, float]:
    """Return median seconds of a call of each, in turns; of a GPU the wall time up to its end."""
    clock = time.process_time if kind == "cpu" else time.perf_counter

    def seconds(call: Callable[[], object], number: int) -> float:
        begin = clock()
        for _ in range(number):
            call()
        if kind == "cuda":
            torch.cuda.synchronize()
        return clock() - begin

    numbers = {}
    for name, call in work.items():
        seconds(call, 2)
        numbers[name] = max(1, round(spell / max(seconds(call, 1), 1e-7)))
    taken: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(spells):
        for name, call in work.items():
            taken[name].append(seconds(call, numbers[name]) / numbers[name])
    return {name: statistics.median(times) for name, times in taken.items()}
