"""Train a policy on a scenario, with evaluation, checkpoints and exact resumption."""

from __future__ import annotations

import shlex
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from os import PathLike
from pathlib import Path

import torch
from threadpoolctl import threadpool_limits

import shake_env
from agents.execution.environment import environment
from agents.plain_values import typed
from agents.policies.policy_file import file_digest, load_policy
from agents.progress import Progress
from agents.provenance import code_version
from agents.run_directory import (
    BEST,
    CONFIG,
    ENVIRONMENT,
    FIRST,
    POLICY,
    RESULT,
    create_run_directory,
    folder_contents,
    forget_attempt,
    locked_folder,
    names_in_words,
    read_json,
)
from agents.seeds import RUN_SEEDS
from agents.training.checkpoint import checkpoints, load_checkpoint, require_no_pickles, save_checkpoint
from agents.training.config import TrainConfig, read_config, require_same
from agents.training.event_log import event_log
from agents.training.model_factory import Model, new_model
from agents.training.tables import TrainingTables, base_tables, training_tables
from agents.training.warm_start import first_file, load_actor_weights
from agents.training.watch import TrainingWatch, evaluation_curve
from shake_env.errors import RunDirectoryError
from shake_env.files import file_errors, replacing, write_json


@dataclass(frozen=True)
class TrainResult:
    """What a finished run came to."""

    run: str
    steps: int
    seconds: float
    cost_ratio: float
    cost: float
    reference: str  # LQR, or the oracle where LQR is none (see _reference)
    reference_cost: float
    best_steps: int  # at which the policy that is kept was evaluated; its are the costs above


def train(
    config: TrainConfig,
    run: str | PathLike[str],
    *,
    report: Callable[[Progress], None] = lambda progress: None,
    command: str | None = None,
    first: Path | None = None,
) -> TrainResult:
    """Train a policy from scratch, or from `config.init_policy`, into a new run directory.

    Parameters
    ----------
    config, run
        What is trained, and where its files go.
    report
        Told where the run stands, every half second at most.
    command
        What the policy's card says it was made by; None: this process's own command line.
    first
        Policy to begin with, a file or a run directory; None: what `config.init_policy` names.

    Raises
    ------
    RunDirectoryError
        If the directory holds a run already, or anything else, or another process runs it.
    FileError
        If it cannot be written, or the disk is full.
    PolicyFileError
        If the policy to begin with cannot be read, or is of another kind than what is trained.
    """
    run = Path(run)
    require_beginnable(config, run)
    model, env, file = _new(config, first_file(config, first))
    create_run_directory(run, lambda folder: _describe(folder, config, file))
    with locked_folder(run), file_errors(run):
        require_beginnable(config, run)  # nor has another process begun it since
        forget_attempt(run)
        return _run(model, config, env, run, report, command)


def resume(
    run: str | PathLike[str],
    *,
    report: Callable[[Progress], None] = lambda progress: None,
    command: str | None = None,
) -> TrainResult:
    """Go on with an interrupted run, exactly as if it had not been interrupted; see :func:`train`.

    Of a finished run it returns the result, and changes nothing.

    Raises
    ------
    RunDirectoryError
        If the directory holds no run, none of its checkpoints can be read, or another process runs it.
    """
    run = Path(run)
    config = read_config(run)
    with locked_folder(run), file_errors(run):
        return read_train_result(run) if is_finished(run) else _train_on(config, run, report, command)


def train_or_resume(
    config: TrainConfig,
    run: str | PathLike[str],
    *,
    report: Callable[[Progress], None] = lambda progress: None,
    command: str | None = None,
    wait: float = 0.0,
    first: Path | None = None,
) -> None:
    """Train a run, or go on with it, or do nothing where it is done; see :func:`train`.

    It waits up to `wait` [s] for another process that runs it to end.

    Raises
    ------
    RunDirectoryError
        If the directory holds another run, or something else.
    """
    run = Path(run)
    if not (run / CONFIG).exists():
        train(config, run, report=report, command=command, first=first)
        return
    require_same(config, run, "move it away, or name another")
    with locked_folder(run, wait), file_errors(run):
        if not is_finished(run):
            _train_on(config, run, report, command, first)


def require_beginnable(config: TrainConfig, run: str | PathLike[str]) -> None:
    """Raise RunDirectoryError unless a run can begin in a directory.

    It can where there is none, where it is empty, and where an attempt at the same run was interrupted
    before its first checkpoint.
    """
    run = Path(run)
    present = folder_contents(run)
    if run.exists() and not run.is_dir():
        raise RunDirectoryError("run directory", str(run), "is a file: name another")
    if not present:
        return
    if CONFIG not in present:
        held = names_in_words(present)
        remedy = f"exists already and holds no run, but {held}: move it away, or name another"
        raise RunDirectoryError("run directory", str(run), remedy)
    if POLICY in present or checkpoints(run):
        remedy = (
            f"exists already and holds {names_in_words(present)}: name another, or go on with --resume"
        )
        raise RunDirectoryError("run directory", str(run), remedy)
    require_no_pickles(run)
    require_same(config, run, "name another, or move it away")


def read_train_result(run: str | PathLike[str]) -> TrainResult:
    """Return what a finished run came to.

    Raises
    ------
    RunDirectoryError
        If there is no result, or it is not complete.
    """
    run = Path(run)
    file = run / RESULT
    try:
        return typed(TrainResult, read_json(file, RunDirectoryError, "result", largest=2**20))
    except RunDirectoryError:
        raise
    except ValueError as error:
        raise RunDirectoryError("result", str(file), f"is no result of a run ({error})") from error


def is_finished(run: str | PathLike[str]) -> bool:
    """Return whether a run has a complete result and the policy that it is of."""
    run = Path(run)
    try:
        read_train_result(run)
    except RunDirectoryError:
        return False
    return (run / POLICY).is_file()


def require_this_code(run: str | PathLike[str], remedy: str) -> None:
    """Raise RunDirectoryError unless a run was begun by the code and library versions of this process.

    Raises
    ------
    RunDirectoryError
        With what differs, or that the run has no file that says it, and the remedy.
    """
    run = Path(run)
    file = run / ENVIRONMENT
    if not file.exists():
        reason = f"does not say which code made it: {remedy}"
        raise RunDirectoryError("run directory", str(run), reason)
    made, own = read_json(file, RunDirectoryError, "environment", largest=2**20), environment()
    if differing := [name for name in own if made.get(name) != own[name]]:
        pairs = [f"{name} {made.get(name)}, here {own[name]}" for name in differing]
        reason = f"was made by other versions ({names_in_words(pairs)}): {remedy}"
        raise RunDirectoryError("run directory", str(run), reason)


def _new(config: TrainConfig, file: Path | None) -> tuple[Model, TrainingTables, Path | None]:
    """Return a new model on its tables, and the file of the policy that it begins with."""
    scenario = config.scenario.build()
    first = None if file is None else load_policy(file)
    env = training_tables(config, scenario, first)
    torch.set_num_threads(config.threads)
    model = new_model(config, scenario, env, direct=first is not None and first.direct)
    if first is not None:
        load_actor_weights(model, base_tables(env), first)
    # After the model: SB3 seeds the environment with the run's own seed, so that the tables of run 1
    # would repeat those of run 0 but for one.
    env.seed(config.seed * RUN_SEEDS)
    return model, env, file


def _describe(folder: Path, config: TrainConfig, first: Path | None) -> None:
    """Put into a run directory what decides the run: the policy that it begins with, its options."""
    if first is not None and first != folder / FIRST:
        with replacing(folder / FIRST) as partial:
            shutil.copyfile(first, partial)
    write_json(folder / ENVIRONMENT, environment())
    write_json(folder / CONFIG, config.to_json())


def _train_on(
    config: TrainConfig,
    run: Path,
    report: Callable[[Progress], None],
    command: str | None,
    first: Path | None = None,
) -> TrainResult:
    """Go on with a run whose directory is locked; begin it where it was cut before a checkpoint."""
    if not checkpoints(run) and not (run / POLICY).exists():
        require_no_pickles(run)
        kept = run / FIRST
        model, env, _ = _new(config, kept if kept.exists() else first_file(config, first))
        forget_attempt(run)
        write_json(run / ENVIRONMENT, environment())
    else:
        _note_environment(run / ENVIRONMENT)
        first_policy = load_policy(run / FIRST) if (run / FIRST).exists() else None
        env = training_tables(config, config.scenario.build(), first_policy)
        torch.set_num_threads(config.threads)
        model = load_checkpoint(run, config, env)
    return _run(model, config, env, run, report, command)


def _note_environment(file: Path) -> None:
    """Add this process's code and versions to those that a run was made by; nothing if none are told."""
    if not file.exists():
        return
    made, own = read_json(file, RunDirectoryError, "environment", largest=2**20), environment()
    other = [name for name in own if name in made and str(made[name]).split(", ")[-1] != own[name]]
    if other:
        write_json(file, made | {name: f"{made[name]}, {own[name]}" for name in other})


def _run(
    model: Model,
    config: TrainConfig,
    env: TrainingTables,
    run: Path,
    report: Callable[[Progress], None],
    command: str | None,
) -> TrainResult:
    code = code_version()  # that runs, not that ends
    with event_log(run / "tensorboard") as logger, threadpool_limits(config.threads):
        model.set_logger(logger)
        watch = TrainingWatch(config, env, run, report)
        remaining = config.steps - model.num_timesteps
        if remaining > 0:
            # SB3 counts what is added to the steps done, and its learning rate from the sum.
            model.learn(remaining, callback=watch, reset_num_timesteps=False, log_interval=10)
        watch.init_callback(model)
        watch.evaluate()
        save_checkpoint(run, model, env)
        watch.tell()
    best_steps, best = min(evaluation_curve(run), key=lambda point: point[1])
    result = TrainResult(
        run=str(run),
        steps=model.num_timesteps,
        seconds=time.monotonic() - watch.started,
        cost_ratio=best,
        cost=best * watch.reference_cost,
        reference=watch.reference,
        reference_cost=watch.reference_cost,
        best_steps=int(best_steps),
    )
    card = {
        **watch.card,
        "command": command or shlex.join(["shake", *sys.argv[1:]]),
        "version": shake_env.__version__,
        "code": code,
        "evaluation": {key: value for key, value in asdict(result).items() if key != "run"},
        "curve": evaluation_curve(run),
    }
    if (run / FIRST).exists():
        made = load_policy(run / FIRST).card
        card["first"] = {"sha256": file_digest(run / FIRST), "command": made.get("command")}
    replace(load_policy(run / BEST), card=card).save(run / POLICY)
    write_json(run / RESULT, asdict(result))
    return result
