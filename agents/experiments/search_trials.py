"""The trials that a command has of a search's study: asked of it and told to it, whoever trains them."""

from __future__ import annotations

import math
import socket
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from agents.experiments import signs_of_life, study_storage
from agents.experiments.search_objective import PruningCallback
from agents.experiments.search_space import Search, own_values, search_space, trial_config
from agents.provenance import code_version
from agents.run_directory import locked_folder
from agents.training.checkpoint import delete_checkpoints
from agents.training.config import TrainConfig


@dataclass
class BegunTrial:
    """A trial that is at work."""

    trial: Any  # Optuna's
    config: TrainConfig
    run: Path
    judge: PruningCallback
    before: float  # [s] processor time of earlier processes
    held: ExitStack = field(default_factory=ExitStack)  # its sign of life

    @property
    def number(self) -> int:
        """Number in the study."""
        return int(self.trial.number)

    @property
    def is_default(self) -> bool:
        """Whether its values are the experiment's own."""
        return bool(self.trial.user_attrs.get("default"))

    def note_seconds(self, spent: float) -> None:
        """Note the processor time [s] that this process has spent on it so far."""
        self.trial.set_user_attr("seconds", self.before + spent)


class SearchTrials:
    """Trials of a command; a context that holds the search's folder and ends the signs of life.

    Parameters
    ----------
    search, study
        What is searched, and its Optuna study.
    made
        Whether this process made the study.
    home
        Folder of the search's runs.
    total
        Trials that are wanted, those of other processes counted.
    shared
        Whether other processes work on the study.

    Raises
    ------
    RunDirectoryError
        On entry, if another process has the folder.
    """

    def __init__(
        self, search: Search, study: Any, made: bool, home: Path, total: int, shared: bool
    ) -> None:
        self.search, self.study, self.home, self.total, self.shared = search, study, home, total, shared
        self._made = made
        self._held = ExitStack()
        self._begun: dict[int, BegunTrial] = {}
        self._slot, self._worker = "", ""

    def __enter__(self) -> SearchTrials:
        with ExitStack() as held:
            if self.shared:
                self._slot = study_storage.free_slot(self.home, held)
                self._worker = f"{socket.gethostname()}:{self.home.resolve()}/{self._slot}"
            else:
                held.enter_context(locked_folder(self.home))
                self._made = not with_states(self.study, "COMPLETE", "PRUNED", "RUNNING", "WAITING")
            self._queue(self._made)
            self._held = held.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for begun in self._begun.values():
            begun.held.close()
        self._held.close()

    def _queue(self, new: bool) -> None:
        """Queue the experiment itself, if it is new, and the trials that were cut, with their runs.

        A command's own trials alone were cut: it holds its folder, and others may work on the study.
        """
        import optuna

        if new:
            own = own_values(self.search.experiment)
            start = {knob.name: own[knob.name] for knob in search_space(self.search.experiment)}
            self.study.enqueue_trial(start, user_attrs={"default": True})
        for cut in with_states(self.study, "RUNNING"):
            if cut.user_attrs.get("worker", "") != self._worker:
                continue
            # Given up under its number, which counts for nothing, and queued under the next.
            self.study.tell(cut.number, state=optuna.trial.TrialState.FAIL)
            self.study.enqueue_trial(cut.params, user_attrs={"run": str(cut.number), **cut.user_attrs})

    def free(self) -> bool | None:
        """Return whether a trial can begin; None: not now, those at work decide."""
        return study_storage.has_free_trial(self.study, self.total, lambda: len(done(self.study)))

    def wait(self) -> bool:
        """Wait until it is clear whether a trial can begin, and return that."""
        return study_storage.may_begin(self.study, self.total, lambda: len(done(self.study)))

    def begin(self) -> BegunTrial:
        """Begin the next trial, which is at work from now on."""
        import optuna

        # Trials before this one: the same number whether they are done or at work.
        place = len(done(self.study)) + len(self._begun)
        if self.shared:
            self.study.sampler = study_storage.shared_sampler(self.search.seed, place)
        else:
            self.study.sampler = optuna.samplers.TPESampler(
                seed=self.search.seed + 1000 * place, multivariate=True, constant_liar=True
            )
        trial = self.study.ask()
        if self.shared:
            trial.set_user_attr("worker", self._worker)
            trial.set_user_attr("run", trial.user_attrs.get("run", f"{self._slot}/{trial.number}"))
        values = {knob.name: knob.suggest(trial) for knob in search_space(self.search.experiment)}
        config = trial_config(self.search.experiment, values, self.search.share)
        run = self.home / trial.user_attrs.get("run", str(trial.number))
        trial.set_user_attr("code", code_version())
        judge = PruningCallback(trial, config, run)
        begun = BegunTrial(trial, config, run, judge, trial.user_attrs.get("seconds", 0.0))
        begun.held.enter_context(signs_of_life.sign_of_life(self.study, trial))
        self._begun[begun.number] = begun
        return begun

    def end(self, begun: BegunTrial, outcome: dict[str, Any] | None) -> None:
        """Tell the study what came of a trial; None: it was pruned."""
        import optuna

        trial, best = begun.trial, begun.judge.best
        trial.set_user_attr("ratio", best if math.isfinite(best) else None)
        for key, value in (outcome or {}).items():
            trial.set_user_attr(key, value)
        if outcome is None:
            self.study.tell(trial, state=optuna.trial.TrialState.PRUNED)
        else:
            self.study.tell(trial, outcome["cost"])
        begun.held.close()
        del self._begun[begun.number]
        # What is done is not gone on with, and a replay buffer is large.
        delete_checkpoints(begun.run)


def with_states(study: Any, *states: str) -> Sequence[Any]:
    """Return a study's trials of these states."""
    return [trial for trial in study.get_trials(deepcopy=False) if trial.state.name in states]


def done(study: Any) -> Sequence[Any]:
    """Return a study's trials that count."""
    return with_states(study, "COMPLETE", "PRUNED")
