"""Checkpoints from which a run goes on exactly: model, optimisers, tables and every random generator.

A checkpoint is one safetensors file: arrays as tensors, everything else as JSON in its header. Reading
one runs no code: the model is built anew from the run's configuration, and takes numbers alone.
"""

from __future__ import annotations

import json
import re
from collections import deque
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save
from sb3_contrib import RecurrentPPO
from sb3_contrib.common.recurrent.type_aliases import RNNStates
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from agents.learning.apg.algorithm import AnalyticPolicyGradient
from agents.learning.distillation import Distillation, Labels
from agents.learning.networks import DirectPolicy
from agents.learning.paired import PairedVecEnv
from agents.run_directory import CHECKPOINTS, names_in_words, parse_json
from agents.training.config import TrainConfig
from agents.training.model_factory import Model, new_model
from agents.training.plain_state import (
    generator_state,
    global_generators,
    join_state,
    require_form,
    restore_generator,
    restore_tables,
    set_global_generators,
    split_state,
    tables_state,
    whole_number,
)
from agents.training.tables import TrainingTables, base_tables
from shake_env.errors import RunDirectoryError
from shake_env.files import file_errors, write_bytes

FORMAT = "shake-checkpoint-2"
KEPT = 2  # newest checkpoints that stay
_NAME = re.compile(r"step-(\d{12,})\.safetensors")
_EARLIER = re.compile(r"step-\d{12,}")  # a folder of pickles
MOST_STEPS = 2**53

# What a learner counts, beside its parameters; those that an algorithm has not are left out.
_COUNTERS = (
    "num_timesteps", "_total_timesteps", "_num_timesteps_at_start", "_episode_num", "_n_updates",
    "retreats", "halvings",
)  # fmt: skip
_REMEMBERED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def checkpoints(run: str | PathLike[str]) -> list[Path]:
    """Return a run's checkpoints, oldest first."""
    run = Path(run)
    files = [f for f in (run / CHECKPOINTS).glob("step-*.safetensors") if _NAME.fullmatch(f.name)]
    return sorted(files, key=checkpoint_steps)


def checkpoint_steps(checkpoint: str | PathLike[str]) -> int:
    """Return the control periods after which a checkpoint was written."""
    checkpoint = Path(checkpoint)
    return int(checkpoint.stem.removeprefix("step-"))


def delete_checkpoints(run: str | PathLike[str], but: int = 0) -> None:
    """Delete a run's checkpoints but for the newest ones; nothing else in their folder."""
    run = Path(run)
    files = checkpoints(run)
    for file in files[: len(files) - but]:
        file.unlink(missing_ok=True)
    folder = run / CHECKPOINTS
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def save_checkpoint(run: str | PathLike[str], model: Model, env: TrainingTables) -> Path:
    """Write a checkpoint of a model between two roll-outs, and delete all but the newest ones.

    Raises
    ------
    FileError
        If the disk is full, or the folder cannot be written.
    """
    run = Path(run)
    final = run / CHECKPOINTS / f"step-{model.num_timesteps:012d}.safetensors"
    if not final.exists():
        values, arrays = split_state(_state(model, env))
        header = {"format": FORMAT, "state": values}
        write_bytes(final, save(arrays, {"shake": json.dumps(header)}))
    with file_errors(final.parent):
        delete_checkpoints(run, KEPT)
    return final


def load_checkpoint(run: str | PathLike[str], config: TrainConfig, env: TrainingTables) -> Model:
    """Return the model of the newest readable checkpoint; `env` and all generators go on from it.

    Raises
    ------
    RunDirectoryError
        If there is no readable checkpoint, or only those of an earlier version, which hold pickles.
    """
    run = Path(run)
    files, failures = checkpoints(run), []
    if not files:
        require_no_pickles(run)
    model: Model | None = None
    for file in reversed(files):
        try:
            state = _read(file)
            if model is None:
                direct = state["direct"] is True
                model = new_model(config, config.scenario.build(), env, direct=direct)
            _restore(model, env, state)
            return model
        # What a damaged file raises where its numbers meet the model: a missing part, another shape.
        except (SafetensorError, OSError, ValueError, TypeError, LookupError, RuntimeError,
                AttributeError, OverflowError) as error:  # fmt: skip
            failures.append(f"{file.name}: {(str(error) or type(error).__name__).splitlines()[0]}")
    raise RunDirectoryError(
        "run directory",
        str(run),
        f"holds no readable checkpoint ({names_in_words(failures) or 'none at all'}): start a new run",
    )


def require_no_pickles(run: str | PathLike[str]) -> None:
    """Raise RunDirectoryError if the only checkpoints are those of an earlier version.

    Those are pickles, and a pickle runs whatever code its author put in it.
    """
    run = Path(run)
    folder = run / CHECKPOINTS
    earlier = [p.name for p in folder.glob("step-*") if p.is_dir() and _EARLIER.fullmatch(p.name)]
    if earlier and not checkpoints(run):
        raise RunDirectoryError(
            "checkpoints",
            str(folder),
            f"are of an earlier version ({names_in_words(sorted(earlier))}) and hold pickles, which "
            "run code when they are read: they are not read. Train in a new directory; the best policy "
            "so far is best.safetensors in this one, with which --config.init-policy can begin",
        )


def _read(file: Path) -> dict[str, Any]:
    with safe_open(str(file), framework="np") as opened:
        header = parse_json((opened.metadata() or {}).get("shake", "{}"))
        if not isinstance(header, dict) or header.get("format") != FORMAT:
            raise ValueError(f"is no checkpoint of this version ({FORMAT})")
        arrays = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118
    try:
        state: dict[str, Any] = join_state(header["state"], arrays)
    except RecursionError:
        raise ValueError("is nested too deeply") from None
    return state


def _state(model: Model, env: TrainingTables) -> dict[str, Any]:
    parameters = model.get_parameters()
    buffer = model.replay_buffer if isinstance(model, OffPolicyAlgorithm) else None
    _, variables = model._get_torch_save_params()
    return {
        "direct": isinstance(model.policy, DirectPolicy),
        "counters": {name: getattr(model, name) for name in _COUNTERS if hasattr(model, name)},
        "progress_remaining": float(model._current_progress_remaining),
        "episodes": [[float(e["r"]), int(e["l"])] for e in model.ep_info_buffer or ()],
        "last_observation": model._last_obs,
        "last_episode_starts": model._last_episode_starts,
        "parameters": {n: v for n, v in parameters.items() if not _optimiser(model, n)},
        "optimisers": {n: _optimiser_state(v) for n, v in parameters.items() if _optimiser(model, n)},
        "variables": {name: _part(model, name) for name in variables if _part(model, name) is not None},
        "memory": _memory(model),
        "replay_buffer": None if buffer is None else _replay(buffer),
        "rounds": [vars(each) for each in model.rounds] if isinstance(model, Distillation) else [],
        "tables": tables_state(base_tables(env)),
        "action_space": generator_state(model.action_space.np_random),
        "generators": global_generators(),
    }


def _restore(model: Model, env: TrainingTables, state: Mapping[str, Any]) -> None:
    """Give a model that was built anew, and its tables, the state of a checkpoint."""
    for name in _COUNTERS:
        if hasattr(model, name):
            setattr(model, name, whole_number(state["counters"][name], name, MOST_STEPS))
    model._current_progress_remaining = float(state["progress_remaining"])
    episodes = [{"r": float(r), "l": int(steps)} for r, steps in state["episodes"]]
    model.ep_info_buffer = deque(episodes, maxlen=model._stats_window_size)
    model.ep_success_buffer = deque(maxlen=model._stats_window_size)
    like = {
        "last_observation": env.reset(),  # each table begins an episode: its state then has every part
        "last_episode_starts": np.ones(env.num_envs, dtype=bool),
    }
    require_form({name: state[name] for name in like}, like, "model")
    model._last_obs = state["last_observation"]
    model._last_episode_starts = state["last_episode_starts"]
    _restore_parameters(model, state)
    _restore_memory(model, env, state["memory"])
    if isinstance(model, Distillation):
        model.rounds = [Labels(**each) for each in state["rounds"]]
    if isinstance(model, OffPolicyAlgorithm):
        assert model.replay_buffer is not None  # made with the model
        _refill(model.replay_buffer, state["replay_buffer"])
    restore_tables(base_tables(env), state["tables"])
    if isinstance(env, PairedVecEnv):
        env.go_on(state["last_observation"], state["last_episode_starts"])
    actions = restore_generator(state["action_space"])
    if actions is None:
        raise ValueError("action_space must describe a random generator")
    model.action_space._np_random = actions
    set_global_generators(state["generators"])


# Parameters and optimisers


def _part(model: Model, path: str) -> Any:
    part: Any = model
    for name in path.split("."):
        part = getattr(part, name)
    return part


def _optimiser(model: Model, name: str) -> bool:
    return isinstance(_part(model, name), torch.optim.Optimizer)


def _optimiser_state(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return moments and steps of each parameter, and the rates; the rest is the configuration's."""
    return {"moments": state["state"], "rates": [group["lr"] for group in state["param_groups"]]}


def _restore_parameters(model: Model, state: Mapping[str, Any]) -> None:
    whole: dict[str, Any] = {}
    for name, own in model.get_parameters().items():
        if _optimiser(model, name):
            parameters = [p for g in _part(model, name).param_groups for p in g["params"]]
            whole[name] = _filled(own, state["optimisers"][name], parameters, name)
        else:
            stored = state["parameters"][name]
            require_form(stored, {key: value.cpu().numpy() for key, value in own.items()}, name)
            whole[name] = {key: torch.from_numpy(value) for key, value in stored.items()}
    model.set_parameters(whole, exact_match=True, device=model.device)
    for name in model._get_torch_save_params()[1]:
        variable = _part(model, name)
        if variable is not None:
            stored = state["variables"][name]
            require_form(stored, variable.detach().cpu().numpy(), name)
            variable.data = torch.from_numpy(stored).to(model.device)


def _filled(
    own: Mapping[str, Any], stored: Mapping[str, Any], parameters: list[torch.Tensor], name: str
) -> dict[str, Any]:
    """Return an optimiser's state with the moments and rates of a checkpoint."""
    moments = {}
    for key, held in stored["moments"].items():
        parameter = parameters[whole_number(int(key), name, len(parameters) - 1)]
        for part, array in held.items():
            shapes = ((), tuple(parameter.shape))
            if not isinstance(array, np.ndarray) or array.shape not in shapes:
                raise ValueError(f"{name}.{key}.{part} has another shape than its parameter")
        moments[int(key)] = {part: torch.from_numpy(array) for part, array in held.items()}
    rates = [float(rate) for rate in stored["rates"]]
    groups = [{**g, "lr": rate} for g, rate in zip(own["param_groups"], rates, strict=True)]
    return {"state": moments, "param_groups": groups}


# Memories and the replay buffer


def _memory(model: Model) -> Any:
    if isinstance(model, RecurrentPPO):
        states: Any = model._last_lstm_states  # None until it is set up, says sb3-contrib
        return tuple(states)
    return model.memory if isinstance(model, AnalyticPolicyGradient) else None


def _restore_memory(model: Model, env: TrainingTables, memory: Any) -> None:
    if isinstance(model, RecurrentPPO):
        states: Any = model._last_lstm_states  # as in `_memory`
        like = [[part.cpu().numpy() for part in pair] for pair in states]
        require_form(memory, like, "memory")
        pairs = (tuple(torch.from_numpy(part).to(model.device) for part in pair) for pair in memory)
        model._last_lstm_states = RNNStates(*pairs)  # type: ignore[assignment]
    elif isinstance(model, AnalyticPolicyGradient):
        if memory is not None and (memory.ndim != 2 or len(memory) != env.num_envs):
            raise ValueError("memory has another shape")
        model.memory = None if memory is None else torch.from_numpy(memory).to(model.device)


def _replay(buffer: ReplayBuffer) -> dict[str, Any]:
    """Return what a replay buffer holds; the rest of it is zeros that need no room on disk."""
    rows = buffer.size()
    held = {name: getattr(buffer, name)[:rows] for name in _REMEMBERED}
    return {"pos": buffer.pos, "full": buffer.full, **held}


def _refill(buffer: ReplayBuffer, held: Mapping[str, Any]) -> None:
    full = held["full"] is True
    place = whole_number(held["pos"], "replay_buffer.pos", buffer.buffer_size - 1)
    rows = buffer.buffer_size if full else place
    stored = {name: held[name] for name in _REMEMBERED}
    require_form(stored, {name: getattr(buffer, name)[:rows] for name in _REMEMBERED}, "replay_buffer")
    buffer.pos, buffer.full = place, full
    for name in _REMEMBERED:
        getattr(buffer, name)[:rows] = stored[name]
