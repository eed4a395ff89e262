"""Search numbers for the least cost, in a study that keeps its trace.

The search is Optuna's tree-structured Parzen estimator (Bergstra et al., 2011), seeded. A study in a
file belongs to one process, which may hand out the trials to workers. Several processes add to a study
in a storage that is shared.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from os import PathLike
from typing import Any

from agents.execution.encoding import decoded
from agents.execution.executor import Executor
from agents.execution.worker import Call
from agents.experiments.signs_of_life import queue_again, retry_lost_trials, sign_of_life
from agents.experiments.study_storage import (
    POLL,
    has_free_trial,
    is_shared,
    may_begin,
    note_wait,
    open_study,
    shared_sampler,
)
from baselines.baseline import Tunable

OnTrial = Callable[[int, int, float], None]  # told trials done, those in all, the best cost


@dataclass(frozen=True)
class StudyResult:
    """What a study came to."""

    parameters: dict[str, float]
    cost: float
    default_cost: float
    trials: int


def search_parameters(
    cost: Callable[[dict[str, float]], float],
    tunable: Mapping[str, Tunable],
    storage: str | PathLike[str],
    study_name: str,
    total: int,
    seed: int,
    on_trial: OnTrial,
    starts: Sequence[Mapping[str, float]],
    executor: Executor | None = None,
    call: Callable[[int, dict[str, float]], Call] | None = None,
) -> StudyResult:
    """Search a controller's `tunable` parameters in `total` trials, those of other processes counted.

    The first trials are `starts`; what the first of them costs is the result's `default_cost`. With an
    executor its workers compute the costs of the others, by what `call` returns for the number and the
    values of a trial. By one worker a search in a file has exactly the trials of this process. By
    several the values of a trial depend on which were done when it began.
    """
    study, made = open_study(storage, study_name)
    import optuna

    distributions: dict[str, optuna.distributions.BaseDistribution] = {
        each: optuna.distributions.FloatDistribution(t.low, t.high, log=t.logarithmic)
        for each, t in tunable.items()
    }
    shared = is_shared(storage)
    if shared and made:  # by this process, and no other
        for start in starts[:total]:
            study.enqueue_trial(dict(start))
    if not shared:  # this process holds the study: what still runs is of one that was cut
        for cut in study.get_trials(deepcopy=False, states=(optuna.trial.TrialState.RUNNING,)):
            study.tell(cut.number, state=optuna.trial.TrialState.FAIL)
    done = _finished(study)
    # A resumed search draws from a seed of its own, or it would repeat its first trials.
    study.sampler = (
        shared_sampler(seed, done)
        if shared
        else optuna.samplers.TPESampler(
            seed=seed + 1000 * done, multivariate=True, constant_liar=executor is not None
        )
    )
    if not shared:
        # The starts are put in when their cost is known, and looked for by their values: a search that
        # was cut in one of them tries it again, before any other.
        new = [dict(s) for s in starts if _value_at(study, s) is None][: max(0, total - done)]
        for start in new:
            study.add_trial(
                optuna.trial.create_trial(
                    params=start, distributions=distributions, value=cost(dict(start))
                )
            )
            on_trial(_finished(study), total, study.best_value)
    if executor is None:
        while may_begin(study, total, lambda: _finished(study)):
            trial = study.ask(distributions)
            with _at_work(study, trial, shared):
                try:
                    study.tell(trial, cost(dict(trial.params)))
                except Exception:  # of whatever kind: the study must not keep a trial that runs no more
                    study.tell(trial, state=optuna.trial.TrialState.FAIL)
                    raise
            on_trial(_finished(study), total, study.best_value)
    else:
        assert call is not None
        _search_by(executor, call, study, distributions, total, on_trial, shared)
    default = _value_at(study, starts[0])
    while default is None and _is_at_work(study, starts[0]):  # in another process
        note_wait()
        retry_lost_trials(study)
        time.sleep(POLL)
        default = _value_at(study, starts[0])
    default = cost(dict(starts[0])) if default is None else default
    return StudyResult(
        dict(study.best_params), float(study.best_value), float(default), _finished(study)
    )


def _search_by(
    executor: Executor,
    call: Callable[[int, dict[str, float]], Call],
    study: Any,
    distributions: Mapping[str, Any],
    total: int,
    on_trial: OnTrial,
    shared: bool,
) -> None:
    """Have an executor's workers compute the costs of a study's trials, one each at a time."""
    handed: list[tuple[Any, ExitStack]] = []  # trials and their signs of life
    at_work: set[int] = set()

    def calls() -> Iterator[Call | None]:
        while True:
            free = None
            if len(at_work) < executor.places:
                free = has_free_trial(study, total, lambda: _finished(study))
            if free is False:
                return
            if free is None:
                if not at_work:
                    note_wait()
                yield None
                continue
            trial = study.ask(distributions)
            sign = ExitStack()
            sign.enter_context(_at_work(study, trial, shared))
            at_work.add(len(handed))
            handed.append((trial, sign))
            yield call(trial.number, dict(trial.params))

    try:
        for index, outcome in executor.results(calls()):
            trial, sign = handed[index]
            study.tell(trial, decoded(outcome.content))
            sign.close()
            at_work.discard(index)
            on_trial(_finished(study), total, study.best_value)
    finally:
        for _, sign in handed:
            sign.__exit__(*sys.exc_info())  # tells those that are at work of an error


@contextmanager
def _at_work(study: Any, trial: Any, shared: bool) -> Iterator[None]:
    """Give a sign of life of a trial; one that is cut is queued again, before that would be missed."""
    with sign_of_life(study, trial):
        try:
            yield
        except BaseException:
            if shared:
                queue_again(study, study.trials[trial.number])
            raise


def _value_at(study: Any, start: Mapping[str, float]) -> float | None:
    """Return the cost of the first finished trial of these values, None if there is none."""
    values = (t.value for t in study.trials if t.value is not None and t.params == dict(start))
    return next(values, None)


def _is_at_work(study: Any, start: Mapping[str, float]) -> bool:
    return any(t.state.name == "RUNNING" and t.params == dict(start) for t in study.trials)


def _finished(study: Any) -> int:
    return sum(trial.value is not None for trial in study.trials)
