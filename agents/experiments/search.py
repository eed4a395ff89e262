"""Search an experiment's values by short trainings, judged on validation earthquakes.

Optuna's tree-structured Parzen estimator (Bergstra et al., 2011) draws the values, and its median pruner
ends a run whose own evaluations stand behind half of those before it. Everything lies in SQLite: a
search that was interrupted, or killed, resumes the interrupted trials from their runs' checkpoints. The
sampler is seeded by the number of trials before, so that what it draws does not depend on where a search
was cut.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import shake_env
from agents.execution.executor import Executor
from agents.experiments import catalogue, study_storage
from agents.experiments.recipes import ExperimentConfig
from agents.experiments.search_objective import ValidationSet
from agents.experiments.search_space import (
    TRAIN_SEED,
    Search,
    own_values,
    search_space,
    trial_config,
)
from agents.experiments.search_trace import Trace, TrialRow
from agents.experiments.search_trials import SearchTrials, done
from agents.experiments.search_work import train_by, train_here
from agents.progress import Progress
from agents.provenance import machine
from agents.seeds import VALIDATION_SEED
from shake_env.errors import ParameterError, ScenarioError, unknown

UNJUDGED = 5  # trials that no pruner ends: a median of fewer says little


@dataclass(frozen=True)
class SearchProgress:
    """Where a search stands."""

    done: int
    total: int
    trial: int  # number of one that runs, or ended now
    progress: Progress | None  # of its training; None: it ended
    best: float | None  # cost over the reference's
    seconds_left: float | None  # wall time, as far as it can be told


def find_experiment(name: str) -> ExperimentConfig:
    """Return the experiment of a name.

    Raises
    ------
    ScenarioError
        If there is none.
    """
    experiments = {experiment.name: experiment for experiment in catalogue.EXPERIMENTS}
    if name not in experiments:
        raise unknown(ScenarioError, "experiment", name, experiments)
    return experiments[name]


def open_search(search: Search, storage: str | PathLike[str]) -> Any:
    """Return the Optuna study of a search, made if need be.

    Raises
    ------
    ParameterError
        If the storage has it with another experiment or space.
    ShakeError
        If Optuna is not installed.
    """
    return _opened(search, storage)[0]


def _opened(search: Search, storage: str | PathLike[str]) -> tuple[Any, bool]:
    """Return the study, and whether it was made now."""
    study, made = study_storage.open_study(storage, search.name)
    import optuna

    evaluations = trial_config(search.experiment, {}, search.share).evaluations
    study.pruner = optuna.pruners.MedianPruner(
        n_startup_trials=UNJUDGED, n_warmup_steps=max(1, evaluations // 3)
    )
    identity = search.identity()
    if not search.same(study.user_attrs.get("identity", identity)):
        remedy = f"holds {search.name} of another experiment or space: give another --storage or --seed"
        raise ParameterError("storage", study_storage.without_password(storage), remedy)
    study.set_user_attr("identity", identity)
    return study, made


def search_training(
    search: Search,
    storage: str | PathLike[str],
    folder: str | PathLike[str],
    *,
    trials: int = 40,
    minutes: float | None = None,
    on_update: Callable[[SearchProgress], None] = lambda standing: None,
    open_workers: Callable[[], AbstractContextManager[Executor | None]] = nullcontext,
) -> Trace:
    """Search training configurations of an experiment for the least cost, or go on with that search.

    Parameters
    ----------
    search
        What is searched.
    storage
        SQLite file that keeps the trace of every search, or the URL of a storage that several processes
        work on at a time, see `study_storage`.
    folder
        Runs lie in ``folder / SCENARIO / ALGORITHM / SEARCH / TRIAL``.
    trials
        In all, those of an earlier process counted; 0 returns what there is.
    minutes
        Wall time of this process; the trials that it ends in go on another time. None: no bound.
    on_update
        Told where the search stands, at most every half second and after each trial.
    open_workers
        Gives the executor whose workers have a trial each, called if there is one to do; None: this
        process does them, one after another. See `search_work` for what the number of workers changes.

    Raises
    ------
    ParameterError
        If a number is outside its range, or the storage holds this search with another experiment.
    RunDirectoryError
        If another process runs this search in a file, or a trial's directory holds another run.
    """
    folder = Path(folder)
    if trials < 0:
        raise ParameterError("trials", trials, "must be at least 0")
    if minutes is not None and not minutes > 0.0:
        raise ParameterError("minutes", minutes, "must be above 0")
    until = math.inf if minutes is None else time.monotonic() + 60.0 * minutes
    with study_storage.storage_errors(storage):
        study, made = _opened(search, storage)
        if len(done(study)) >= trials:
            return trace_of(search, study)
        home, shared = folder / search.name, study_storage.is_shared(storage)
        begun = SearchTrials(search, study, made, home, trials, shared)
        with begun, open_workers() as executor:
            validation = ValidationSet(search.experiment, search.earthquakes)
            study.set_user_attr("reference", validation.reference)
            study.set_user_attr("reference_lost", validation.reference_lost)
            workers = 1 if executor is None else executor.workers

            def tell(progresses: Mapping[int, Progress | None]) -> None:
                now = _standing(study, trials, until, workers, progresses)
                for number, progress in progresses.items():
                    on_update(replace(now, trial=number, progress=progress))

            options = f"--step-fraction {search.share:g} --seed {search.seed}"
            command = f"shake tune-training {search.experiment.name} {options}"
            if executor is None:
                train_here(begun, validation, command, until, tell)
            else:
                train_by(executor, begun, validation, command, until, tell)
        return trace_of(search, study)


def _standing(
    study: Any, total: int, until: float, workers: int, progresses: Mapping[int, Progress | None]
) -> SearchProgress:
    over = done(study)
    costs = [t.value for t in over if t.state.name == "COMPLETE"]
    times = [t.duration.total_seconds() for t in over]
    at_work = [p for p in progresses.values() if p is not None]
    shares = sum(p.steps / p.total_steps for p in at_work)
    left = None
    if times:
        left = max(0.0, sum(times) / len(times) * (total - len(over) - shares) / workers)
    elif shares > 0.05:
        left = sum(p.seconds for p in at_work) / shares * (total - shares) / workers
    if math.isfinite(until):
        left = min(math.inf if left is None else left, max(0.0, until - time.monotonic()))
    return SearchProgress(len(over), total, -1, None, min(costs, default=None), left)


def trace_of(search: Search, study: Any) -> Trace:
    """Return the trace of a training search as far as it is done."""
    knobs, own = search_space(search.experiment), own_values(search.experiment)
    rows = []
    for trial in done(study):
        attributes = trial.user_attrs
        failed = "failure" in attributes
        state = "pruned" if trial.state.name == "PRUNED" else "failed" if failed else "complete"
        rows.append(
            TrialRow(
                number=trial.number,
                state=state,
                values={knob.name: knob.tidy(trial.params[knob.name]) for knob in knobs},
                cost=None if failed else attributes.get("cost"),
                seconds=round(attributes.get("seconds", 0.0), 1),
                default=attributes.get("default", False),
                **{
                    key: attributes.get(key)
                    for key in ("low", "high", "lost", "ratio", "code", "failure")
                },
            )
        )
    return Trace(
        experiment=search.experiment.name,
        share=search.share,
        steps=trial_config(search.experiment, {}, search.share).steps,
        seed=search.seed,
        train_seed=TRAIN_SEED,
        earthquakes=search.earthquakes,
        validation_seed=VALIDATION_SEED,
        reference=study.user_attrs.get("reference", ""),
        reference_lost=study.user_attrs.get("reference_lost", 0),
        version=shake_env.__version__,
        machine=machine(),
        space=knobs,
        own={knob.name: own[knob.name] for knob in knobs},
        trials=tuple(rows),
    )
