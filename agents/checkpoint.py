"""Checkpoints from which a run goes on exactly: model, environment and every random stream.

A checkpoint is a directory that appears under its name only when it is complete. It holds pickles, as
SB3's own models do: resume only runs of your own. (Policies to share are safetensors, `policy_file`.)
"""

from __future__ import annotations

import os
import random
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import torch
from sb3_contrib import RecurrentPPO
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from agents.analytic_gradient import AnalyticPolicyGradient
from agents.models import ALGORITHMS, Model
from agents.sb3_vec_env import ShakeTableVecEnv
from shake_env.errors import RunDirectoryError

KEPT = 2  # newest checkpoints that stay


def save_checkpoint(run: Path, model: Model, env: ShakeTableVecEnv) -> Path:
    """Write a checkpoint of a model between two roll-outs, and drop the oldest ones."""
    folder = run / "checkpoints"
    folder.mkdir(parents=True, exist_ok=True)
    final = folder / f"step-{model.num_timesteps:012d}"
    if final.exists():
        return final
    partial = folder / f".partial-{os.getpid()}"
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir()
    model.save(partial / "model.zip")
    state: dict[str, Any] = {
        "env": env.snapshot(),
        "last_observation": model._last_obs,
        "last_episode_starts": model._last_episode_starts,
        "action_space": model.action_space.np_random,
        "torch": torch.get_rng_state(),
        "numpy": np.random.get_state(),  # noqa: NPY002  # SB3 draws its minibatches from it
        "python": random.getstate(),
    }
    if isinstance(model, OffPolicyAlgorithm):
        state["replay_buffer"] = _filled(model.replay_buffer)
    if isinstance(model, RecurrentPPO):
        state["memory"] = model._last_lstm_states
    if isinstance(model, AnalyticPolicyGradient):
        state["memory"] = model.memory
    torch.save(state, partial / "state.pt")
    partial.rename(final)
    for old in checkpoints(run)[:-KEPT]:
        shutil.rmtree(old)
    return final


def checkpoints(run: Path) -> list[Path]:
    """Return a run's complete checkpoints, oldest first."""
    return sorted((run / "checkpoints").glob("step-*"))


_REMEMBERED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def _filled(buffer: ReplayBuffer) -> dict[str, Any]:
    """Return what a replay buffer holds; the rest of it is zeros that need no room on disk."""
    rows = buffer.size()
    held = {name: getattr(buffer, name)[:rows] for name in _REMEMBERED}
    return {"pos": buffer.pos, "full": buffer.full, **held}


def _refill(buffer: ReplayBuffer, held: dict[str, Any]) -> None:
    buffer.pos, buffer.full = held["pos"], held["full"]
    for name in _REMEMBERED:
        getattr(buffer, name)[: len(held[name])] = held[name]


def load_checkpoint(run: Path, algorithm: str, env: ShakeTableVecEnv, device: str = "cpu") -> Model:
    """Return the model of the newest readable checkpoint; `env` and all random streams go on from it.

    It goes on on `device`, the one that the run is on.

    Raises
    ------
    RunDirectoryError
        If there is no readable checkpoint.
    """
    failures = []
    for folder in reversed(checkpoints(run)):
        try:
            state = torch.load(folder / "state.pt", weights_only=False, map_location="cpu")
            model = ALGORITHMS[algorithm].load(folder / "model.zip", env=env, device=device)
        except Exception as error:  # a damaged pickle raises anything; the next older one is tried
            failures.append(f"{folder.name}: {error}")
            continue
        env.restore(state["env"])
        model._last_obs = state["last_observation"]
        model._last_episode_starts = state["last_episode_starts"]
        if isinstance(model, OffPolicyAlgorithm):
            _refill(model.replay_buffer, state["replay_buffer"])
        if isinstance(model, RecurrentPPO):
            model._last_lstm_states = state["memory"]
        if isinstance(model, AnalyticPolicyGradient):
            memory = state["memory"]
            model.memory = None if memory is None else memory.to(model.device)
        model.action_space._np_random = state["action_space"]
        torch.set_rng_state(state["torch"])
        np.random.set_state(state["numpy"])  # noqa: NPY002  # SB3 draws its minibatches from it
        random.setstate(state["python"])
        return model
    raise RunDirectoryError(
        "run directory", str(run), f"holds no readable checkpoint {failures or ''}: start a new run"
    )
