"""A search's trials, trained and judged by this process or by the workers of an executor.

By one worker a search in a file has the trials of this process, exactly. By several workers the first
ten have the same values (the sampler's random start, seeded by a trial's place); those after depend on
what is done when they begin, and so does whether a trial is ended before its steps are done.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agents.execution.encoding import decoded
from agents.execution.environment import folder_token
from agents.execution.executor import Executor
from agents.execution.worker import Call, Outcome
from agents.experiments.controller_tuning import FAILED
from agents.experiments.run_watch import RunWatch, log_of
from agents.experiments.search_objective import OutOfTimeError, PrunedError, ValidationSet
from agents.experiments.search_trials import BegunTrial, SearchTrials
from agents.experiments.study_storage import note_wait
from agents.experiments.worker import train_run
from agents.policies.policy_file import load_policy
from agents.progress import Progress
from agents.run_directory import POLICY
from agents.training.run import train_or_resume
from shake_env.controller import Controller
from shake_env.errors import (
    FileError,
    ParameterError,
    PolicyFileError,
    RunDirectoryError,
    ScenarioError,
)
from shake_env.files import write_bytes

PERIOD = 1.0  # [s] between two times that is told how the workers' trials stand
Tell = Callable[[Mapping[int, Progress | None]], None]  # progress of trials; None: it is done


def train_here(
    trials: SearchTrials, validation: ValidationSet, command: str, until: float, tell: Tell
) -> None:
    """Train and judge trials one after another, until there are enough or the time is over."""
    while time.monotonic() < until and trials.wait():
        begun, began = trials.begin(), time.process_time()

        def report(progress: Progress, begun: BegunTrial = begun, began: float = began) -> None:
            begun.note_seconds(time.process_time() - began)
            begun.judge.report()
            if progress.steps < progress.total_steps and time.monotonic() > until:
                raise OutOfTimeError
            tell({begun.number: progress})

        def train(begun: BegunTrial = begun, report: Callable[[Progress], None] = report) -> None:
            train_or_resume(begun.config, begun.run, report=report, command=command)
            begun.judge.report()

        try:
            outcome = outcome_of(begun.run, begun.is_default, train, validation.judge)
        except OutOfTimeError:
            return
        begun.note_seconds(time.process_time() - began)
        trials.end(begun, outcome)
        tell({begun.number: None})


def train_by(
    executor: Executor,
    trials: SearchTrials,
    validation: ValidationSet,
    command: str,
    until: float,
    tell: Tell,
) -> None:
    """Have an executor's workers train and judge trials, one each at a time; see `train_here`.

    Raises
    ------
    ShakeError
        That a worker raised, such as one that does not see the folder of the runs. What still runs is
        cancelled, and goes on another time.
    """
    home = trials.home.resolve()
    folder = home, folder_token(home)
    handed: list[_HandedTrial] = []
    at_work: dict[int, _HandedTrial] = {}
    told = time.monotonic()

    def calls() -> Iterator[Call | None]:
        while time.monotonic() < until:
            free = None if len(at_work) >= executor.places else trials.free()
            if free is False:
                return
            if free is None:
                if not at_work:
                    note_wait()
                yield None
                continue
            one = _HandedTrial(trials.begin())
            at_work[len(handed)] = one
            handed.append(one)
            yield one.call(validation, command, folder)

    def progresses() -> dict[int, Progress | None]:
        return {o.begun.number: o.progress for o in at_work.values() if o.progress is not None}

    def on_tick() -> None:
        nonlocal told
        if time.monotonic() > until:
            raise OutOfTimeError
        changed = [one for one in at_work.values() if one.look()]
        if changed and time.monotonic() - told > PERIOD:
            told = time.monotonic()
            tell(progresses())

    try:
        results = executor.results(
            calls(), on_submit=lambda index: handed[index].watch.begin(), on_tick=on_tick
        )
        for index, outcome in results:
            one = at_work.pop(index)
            trials.end(one.begun, one.finish(outcome))
            tell({**progresses(), one.begun.number: None})
    except OutOfTimeError:
        return


@dataclass
class _HandedTrial:
    """A trial that a worker has, as the commanding process sees it."""

    begun: BegunTrial
    progress: Progress | None = None
    pruned: bool = False

    def __post_init__(self) -> None:
        self.watch = RunWatch(f"trial {self.begun.number}", self.begun.run)
        self._sign = stop_sign(self.begun.run)
        self._sign.unlink(missing_ok=True)

    def call(self, validation: ValidationSet, command: str, folder: tuple[Path, str]) -> Call:
        """Return what a worker does; it must see the folder."""
        run = self.begun.run.resolve()
        arguments = (str(run), self.begun.config.to_json(), command, validation, self.begun.is_default)
        return Call(
            self.watch.name, carry_out, arguments, log=log_of(run), folder=folder, needs_folder=True
        )

    def look(self) -> bool:
        """Read how far it is, and have it end if it is behind; return whether it came further."""
        progress = self.watch.look()
        if progress is None or progress == self.progress:
            return False
        self.progress = progress
        self._judge()
        return True

    def finish(self, outcome: Outcome) -> dict[str, Any] | None:
        """Return what came of it; None: it was pruned."""
        self.watch.look()
        found = decoded(outcome.content)
        self._judge()
        self.begun.note_seconds(found["seconds"])
        self._sign.unlink(missing_ok=True)
        return None if self.pruned else found["outcome"]

    def _judge(self) -> None:
        if self.pruned:
            return
        try:
            self.begun.judge.report()
        except PrunedError:
            self.pruned = True
            write_bytes(self._sign, b"")


def stop_sign(run: str | os.PathLike[str]) -> Path:
    """Return the file whose presence ends a run in work."""
    run = Path(run)
    return run.with_name(run.name + ".stop")


def carry_out(
    run: str, values: dict[str, Any], command: str, validation: ValidationSet, is_default: bool
) -> dict[str, Any]:
    """Train a trial's configuration and judge its policy; runs on a worker.

    Returns
    -------
    The outcome, see `outcome_of`, and the processor time [s].
    """
    began, sign = time.process_time(), stop_sign(run)

    def end_if_asked(progress: Progress) -> None:
        if progress.steps < progress.total_steps and sign.exists():
            raise PrunedError

    outcome = outcome_of(
        Path(run),
        is_default,
        lambda: train_run(run, values, command, on_progress=end_if_asked),
        validation.judge,
    )
    return {"outcome": outcome, "seconds": time.process_time() - began}


def outcome_of(
    run: str | os.PathLike[str],
    is_default: bool,
    train: Callable[[], None],
    judge: Callable[[Controller], dict[str, Any]],
) -> dict[str, Any] | None:
    """Train a run and judge its policy.

    Returns
    -------
    What is noted of the trial: cost, interval and tables lost; or the cost of a failure, and its reason,
    where the values came to no numbers. None: the training was pruned.
    """
    try:
        train()
        return judge(load_policy(Path(run) / POLICY))
    except PrunedError:
        return None
    except (ParameterError, ScenarioError, RunDirectoryError, FileError):
        raise  # a mistake in what was asked, no property of the values
    # A network or a design that came to no numbers.
    except (PolicyFileError, ValueError, ArithmeticError) as error:
        if is_default:
            raise  # nor is this
        reason = (str(error) or "no reason told").splitlines()[0]
        return {"cost": FAILED, "failure": f"{type(error).__name__}: {reason}"}
