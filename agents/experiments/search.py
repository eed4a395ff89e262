"""Search an experiment's values by short trainings, judged on validation earthquakes.

Optuna's tree-structured Parzen estimator (Bergstra et al., 2011) draws the values, and its median pruner
ends a run whose own evaluations stand behind half of those before it. Everything lies in SQLite: a
search that was interrupted, or killed, resumes the interrupted trial from its run's checkpoint. The
sampler is seeded by the number of trials done, so that what it draws does not depend on where a search
was cut.
"""

from __future__ import annotations

import json
import math
import socket
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import shake_env
from agents.experiments import catalogue, study_storage
from agents.experiments.catalogue import ExperimentConfig
from agents.experiments.controller_tuning import FAILED
from agents.experiments.search_objective import (
    OutOfTimeError,
    PrunedError,
    PruningCallback,
    ValidationSet,
)
from agents.experiments.search_space import (
    TRAIN_SEED,
    own_values,
    search_space,
    search_space_json,
    trial_config,
)
from agents.experiments.search_trace import Trace, TrialRow
from agents.policies.policy_file import load_policy
from agents.progress import Progress
from agents.provenance import code_version, machine
from agents.run_directory import POLICY, locked_folder
from agents.seeds import VALIDATION_SEED
from agents.training.checkpoint import delete_checkpoints
from agents.training.config import config_of
from agents.training.run import train_or_resume
from shake_env.errors import ParameterError, PolicyFileError, RunDirectoryError, ScenarioError, unknown

UNJUDGED = 5  # trials that no pruner ends: a median of fewer says little


@dataclass(frozen=True, kw_only=True)
class Search:
    """What decides a search.

    Raises
    ------
    ParameterError
        If a number is outside its range.
    """

    experiment: ExperimentConfig
    share: float = 0.3
    """Share of the experiment's steps that a trial trains for."""
    seed: int = 0
    """Of what is drawn."""
    earthquakes: int = 64
    """Validation earthquakes that a trial is judged on."""

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ParameterError("seed", self.seed, "must be at least 0")
        if self.earthquakes < 1:
            raise ParameterError("earthquakes", self.earthquakes, "must be at least 1")
        trial_config(self.experiment, {}, self.share)

    @property
    def name(self) -> str:
        """Name of the study, and of the folder of its runs."""
        return f"{self.experiment.name}/share{self.share:g}-seed{self.seed}-tests{self.earthquakes}"

    def identity(self) -> str:
        """Return everything that decides a trial, so that no search mixes two kinds of them."""
        config = trial_config(self.experiment, {}, self.share).to_json()
        return json.dumps([config, search_space_json(search_space(self.experiment))])

    def same(self, identity: str) -> bool:
        """Return whether that is this search's; options that it does not know have their defaults."""
        try:
            (one, space_one), (two, space_two) = json.loads(identity), json.loads(self.identity())
            return space_one == space_two and config_of(one) == config_of(two)
        except ValueError:  # a configuration of another version
            return False


@dataclass(frozen=True)
class SearchProgress:
    """Where a search stands."""

    done: int
    total: int
    trial: int  # number of the one that runs, or ran last
    progress: Progress | None  # of its training
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


def _with_states(study: Any, *states: str) -> list[Any]:
    return [trial for trial in study.get_trials(deepcopy=False) if trial.state.name in states]


def _done(study: Any) -> list[Any]:
    return _with_states(study, "COMPLETE", "PRUNED")


def _queue(study: Any, search: Search, new: bool, worker: str) -> None:
    """Queue the experiment itself, if it is new, and the trial that was cut, with its run.

    A worker's own trials alone were cut: it holds its folder, and others may work on the study.
    """
    import optuna

    if new:
        own = own_values(search.experiment)
        start = {knob.name: own[knob.name] for knob in search_space(search.experiment)}
        study.enqueue_trial(start, user_attrs={"default": True})
    for cut in _with_states(study, "RUNNING"):
        if cut.user_attrs.get("worker", "") != worker:
            continue
        # Given up under its number, which counts for nothing, and queued under the next.
        study.tell(cut.number, state=optuna.trial.TrialState.FAIL)
        study.enqueue_trial(cut.params, user_attrs={"run": str(cut.number), **cut.user_attrs})


def search_training(
    search: Search,
    storage: str | PathLike[str],
    folder: str | PathLike[str],
    *,
    trials: int = 40,
    minutes: float | None = None,
    on_update: Callable[[SearchProgress], None] = lambda standing: None,
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
        Wall time of this process; the trial that it ends in goes on another time. None: no bound.
    on_update
        Told where the search stands, at most every half second and after each trial.

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
        return _searched(search, storage, folder / search.name, trials, until, on_update)


def _searched(
    search: Search,
    storage: str | PathLike[str],
    home: Path,
    trials: int,
    until: float,
    on_update: Callable[[SearchProgress], None],
) -> Trace:
    study, made = _opened(search, storage)
    if len(_done(study)) >= trials:
        return trace_of(search, study)
    shared = study_storage.is_shared(storage)
    with ExitStack() as held:
        slot = ""
        if shared:
            slot = study_storage.free_slot(home, held)
        else:
            held.enter_context(locked_folder(home))
            made = not _with_states(study, "COMPLETE", "PRUNED", "RUNNING", "WAITING")
        worker = f"{socket.gethostname()}:{home.resolve()}/{slot}" if shared else ""
        validation = ValidationSet(search.experiment, search.earthquakes)
        study.set_user_attr("reference", validation.reference)
        study.set_user_attr("reference_lost", validation.reference_lost)
        _queue(study, search, made, worker)

        def lacks_one() -> bool:
            if shared:
                return study_storage.may_begin(study, trials, lambda: len(_done(study)))
            return len(_done(study)) < trials

        while time.monotonic() < until and lacks_one():

            def tell(number: int, progress: Progress | None) -> None:
                on_update(_standing(study, trials, until, number, progress))

            try:
                _trial(study, search, validation, home, until, tell, slot, worker)
            except OutOfTimeError:
                break
    return trace_of(search, study)


def _trial(
    study: Any,
    search: Search,
    validation: ValidationSet,
    home: Path,
    until: float,
    tell: Callable[[int, Progress | None], None],
    slot: str,
    worker: str,
) -> None:
    import optuna

    if worker:
        study.sampler = study_storage.shared_sampler(search.seed, len(_done(study)))
    else:
        seed = search.seed + 1000 * len(_done(study))
        study.sampler = optuna.samplers.TPESampler(seed=seed, multivariate=True)
    trial = study.ask()
    if worker:
        trial.set_user_attr("worker", worker)
        trial.set_user_attr("run", trial.user_attrs.get("run", f"{slot}/{trial.number}"))
    with study_storage.sign_of_life(study, trial):
        _judged(study, trial, search, validation, home, until, tell)


def _judged(
    study: Any,
    trial: Any,
    search: Search,
    validation: ValidationSet,
    home: Path,
    until: float,
    tell: Callable[[int, Progress | None], None],
) -> None:
    import optuna

    values = {knob.name: knob.suggest(trial) for knob in search_space(search.experiment)}
    config = trial_config(search.experiment, values, search.share)
    run = home / trial.user_attrs.get("run", str(trial.number))
    before, began = trial.user_attrs.get("seconds", 0.0), time.process_time()
    trial.set_user_attr("code", code_version())
    judge = PruningCallback(trial, config, run, until)

    def report(progress: Progress) -> None:
        trial.set_user_attr("seconds", before + time.process_time() - began)
        judge(progress)
        tell(trial.number, progress)

    try:
        options = f"--step-fraction {search.share:g} --seed {search.seed}"
        command = f"shake tune-training {search.experiment.name} {options}"
        train_or_resume(config, run, report=report, command=command)
        judge.report()
        outcome = validation.judge(load_policy(run / POLICY))
    except PrunedError:
        outcome = None
    except (ParameterError, ScenarioError, RunDirectoryError):
        raise  # a mistake in what was asked, no property of the values
    # A network or a design that came to no numbers.
    except (PolicyFileError, ValueError, ArithmeticError) as error:
        if trial.user_attrs.get("default"):
            raise  # nor is this
        reason = (str(error) or "no reason told").splitlines()[0]
        outcome = {"cost": FAILED, "failure": f"{type(error).__name__}: {reason}"}
    trial.set_user_attr("seconds", before + time.process_time() - began)
    trial.set_user_attr("ratio", judge.best if math.isfinite(judge.best) else None)
    for key, value in (outcome or {}).items():
        trial.set_user_attr(key, value)
    if outcome is None:
        study.tell(trial, state=optuna.trial.TrialState.PRUNED)
    else:
        study.tell(trial, outcome["cost"])
    # What is done is not gone on with, and a replay buffer is large.
    delete_checkpoints(run)
    tell(trial.number, None)


def _standing(
    study: Any, total: int, until: float, number: int, progress: Progress | None
) -> SearchProgress:
    done = _done(study)
    costs = [t.value for t in done if t.state.name == "COMPLETE"]
    times = [t.duration.total_seconds() for t in done]
    share = progress.steps / progress.total_steps if progress else 0.0
    left = None
    if times:
        left = max(0.0, sum(times) / len(times) * (total - len(done) - share))
    elif progress and share > 0.05:
        left = progress.seconds / share * (total - share)
    if math.isfinite(until):
        left = min(math.inf if left is None else left, max(0.0, until - time.monotonic()))
    return SearchProgress(len(done), total, number, progress, min(costs, default=None), left)


def trace_of(search: Search, study: Any) -> Trace:
    """Return the trace of a training search as far as it is done."""
    knobs, own = search_space(search.experiment), own_values(search.experiment)
    rows = []
    for trial in _done(study):
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
