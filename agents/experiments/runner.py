"""Many trainings by the workers of an executor; what is done is not done again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, Literal

from agents.execution.environment import folder_token
from agents.execution.executor import Executor
from agents.execution.worker import Call, Outcome
from agents.experiments.recipes import ExperimentConfig
from agents.experiments.run_watch import RunWatch, log_of
from agents.experiments.worker import train_run
from agents.run_directory import CONFIG, POLICY
from agents.training.checkpoint import checkpoint_steps, checkpoints
from agents.training.config import TrainConfig, require_same
from agents.training.run import is_finished, require_beginnable, require_this_code
from shake_env.errors import RunDirectoryError, ScenarioError, unknown

State = Literal["done", "begun", "waiting", "running", "failed", "foreign"]


@dataclass
class Task:
    """One run of a campaign."""

    experiment: ExperimentConfig
    config: TrainConfig
    run: Path
    state: State = "waiting"
    share: float = 0.0  # of its steps that is done
    first_share: float = 0.0  # of it, when this process began
    seconds: float = 0.0  # since then
    cost_ratio: float | None = None
    failure: str = ""
    any_code: bool = False  # whether a run counts that other code or versions made
    first: Task | None = None  # the run whose policy this one begins with

    @property
    def name(self) -> str:
        """``SCENARIO/ALGORITHM/SEED``."""
        return f"{self.experiment.name}/{self.config.seed}"

    def look(self) -> None:
        """Read the state of the run from its directory."""
        try:
            if not (self.run / CONFIG).exists():
                require_beginnable(self.config, self.run)
                return
            require_same(self.config, self.run, "move it away")
            begun = (self.run / POLICY).exists() or bool(checkpoints(self.run))
            if begun and not self.any_code:
                require_this_code(self.run, "move it away, or count it with --any-code")
        except RunDirectoryError as error:  # also that of another version, or damaged
            self.state, self.failure = "foreign", str(error)
            return
        if is_finished(self.run):
            self.state, self.share = "done", 1.0
        elif saved := checkpoints(self.run):
            self.state = "begun"
            self.share = checkpoint_steps(saved[-1]) / self.config.steps

    @cached_property
    def _watch(self) -> RunWatch:
        return RunWatch(self.name, self.run)

    @property
    def before(self) -> int:
        """Runs that must be done before this one, each beginning with the one ahead of it."""
        return 0 if self.first is None else 1 + self.first.before

    def require_first(self) -> None:
        """Note a failure where the run that this one would begin with is not done."""
        if self.first is not None and self.state == "waiting" and self.first.state != "done":
            self.state, self.failure = "failed", f"begins with {self.first.name}, which is not done"

    def begin(self) -> None:
        """Forget what the worker before has said of the run."""
        self.first_share = self.share
        self._watch.begin()

    def call(self) -> Call:
        """Return what a worker does for the run; it must see the folder."""
        folder = self.run.parents[2].resolve()  # of the campaign
        command = f"shake run-experiments --experiments {self.experiment.name}"
        return Call(
            self.name,
            train_run,
            (str(self.run), self.config.to_json(), command, self.first and str(self.first.run)),
            log=log_of(self.run),
            folder=(folder, folder_token(folder)),
            needs_folder=True,
        )

    def watch(self) -> None:
        """Read what the worker says of the run: its progress, and new lines of its log."""
        if not self._watch.begun:
            return
        self.state = "running"
        if (progress := self._watch.look()) is not None:
            self.share = min(progress.steps / max(progress.total_steps, 1), 1.0)
            self.seconds, self.cost_ratio = progress.seconds, progress.cost_ratio

    def finish(self, outcome: Outcome) -> None:
        """Take in what came of the run."""
        if outcome.error is None and is_finished(self.run):
            self.state, self.share = "done", 1.0
        else:
            self.state, self.failure = "failed", str(outcome.error or "left no complete result")

    @property
    def pace(self) -> float | None:
        """Time that it takes over the time that was expected, as far as it is known."""
        done = self.share - self.first_share
        expected = 60.0 * self.experiment.minutes * done
        return self.seconds / expected if done > 0.02 and self.seconds > 5.0 else None


@dataclass
class Campaign:
    """The runs of some experiments, and how far they are.

    Parameters
    ----------
    tasks
        From :func:`plan_runs`.
    workers
        Runs at a time, for the time left.
    """

    tasks: list[Task]
    workers: int = 2

    def run(
        self, executor: Executor, on_update: Callable[[Campaign], None] = lambda campaign: None
    ) -> None:
        """Run what is not done. A run that fails is noted and stops no other.

        Interrupted, the workers end and the runs go on from their checkpoints another time, by any
        executor.

        Raises
        ------
        FileError
            If the folder of a run cannot be written.
        """
        for before in range(1 + max((task.before for task in self.tasks), default=0)):
            tasks = [task for task in self.tasks if task.before == before]
            for task in tasks:
                task.require_first()
            self._run(executor, tasks, on_update)

    def _run(self, executor: Executor, tasks: list[Task], on_update: Callable[[Campaign], None]) -> None:
        tasks = [task for task in tasks if task.state in ("begun", "waiting")]
        if not tasks:
            return
        self.workers = executor.workers
        out: set[int] = set()

        def on_submit(index: int) -> None:
            tasks[index].begin()
            out.add(index)

        def on_tick() -> None:
            for index in out:
                tasks[index].watch()
            on_update(self)

        calls = [task.call() for task in tasks]
        for index, outcome in executor.results(calls, on_submit=on_submit, on_tick=on_tick):
            tasks[index].watch()
            tasks[index].finish(outcome)
            out.discard(index)

    def seconds_left(self) -> float:
        """Return the time left [s], from what is expected and how the runs so far kept to it."""
        paces = [pace for task in self.tasks if (pace := task.pace) is not None]
        usual = sum(paces) / len(paces) if paces else 1.0
        left = [
            60.0 * task.experiment.minutes * (1.0 - task.share) * (task.pace or usual)
            for task in self.tasks
            if task.state in ("begun", "waiting", "running")
        ]
        return max([sum(left) / self.workers, *left], default=0.0)

    def counts(self) -> dict[str, int]:
        """Return the number of runs in each state that there is."""
        states = [task.state for task in self.tasks]
        return {state: states.count(state) for state in sorted(set(states))}

    def failures(self) -> dict[str, str]:
        """Return why runs failed, or are not this campaign's, by their names."""
        return {t.name: t.failure for t in self.tasks if t.state in ("failed", "foreign")}


def plan_runs(
    experiments: Sequence[ExperimentConfig],
    folder: str | PathLike[str],
    only: Sequence[str] = (),
    seeds: int | None = None,
    any_code: bool = False,
) -> list[Task]:
    """Return the runs of a campaign with the state of each.

    An experiment whose initial policy has the name of another one of its evaluation task begins with
    that one's policy of the same seed; the runs of both are the campaign's.

    Parameters
    ----------
    experiments
        What can be run.
    folder
        Runs lie in ``folder / SCENARIO / ALGORITHM / SEED``.
    only
        Names or patterns, ``linear/ppo`` or ``linear/*``; none: all.
    seeds
        Seeds of each; None: as many as each experiment asks for.
    any_code
        Whether runs count that other code, or other versions of the libraries, made or began.

    Raises
    ------
    ScenarioError
        If a pattern fits no experiment.
    """
    folder = Path(folder)
    names = [experiment.name for experiment in experiments]
    for pattern in only:
        if not any(fnmatch(name, pattern) for name in names):
            raise unknown(ScenarioError, "only", pattern, names)
    firsts = {each.name: first for each in experiments if (first := _first_of(each, experiments))}
    chosen = [
        each for each in experiments if not only or any(fnmatch(each.name, pattern) for pattern in only)
    ]
    counts = {each.name: each.seeds if seeds is None else seeds for each in chosen}
    for each in chosen:
        following = each
        while (first := firsts.get(following.name)) is not None:
            counts[first.name] = max(counts.get(first.name, 0), counts[following.name])
            following = first
    tasks: dict[tuple[str, int], Task] = {}
    for experiment in [each for each in experiments if each.name in counts]:
        for seed in range(counts[experiment.name]):
            run = folder / experiment.name / str(seed)
            task = Task(experiment, experiment.with_seed(seed), run, any_code=any_code)
            task.look()
            tasks[experiment.name, seed] = task
    for (name, seed), task in tasks.items():
        if name in firsts:
            task.first = tasks[firsts[name].name, seed]
    return list(tasks.values())


def _first_of(
    experiment: ExperimentConfig, experiments: Sequence[ExperimentConfig]
) -> ExperimentConfig | None:
    """Return the experiment whose policy of the same seed this one begins with, if there is one."""
    label = experiment.config.init_policy
    name = f"{experiment.evaluation_task}/{label}"
    return next((each for each in experiments if label and each.name == name), None)


def plan_rows(tasks: Sequence[Task]) -> list[dict[str, Any]]:
    """Return a row for each experiment of a plan: runs, those done, minutes left and why it is so."""
    rows: dict[str, dict[str, Any]] = {}
    for task in tasks:
        row = rows.setdefault(
            task.experiment.name,
            {"experiment": task.experiment.name, "runs": 0, "done": 0, "minutes_left": 0.0, "steps": 0},
        )
        row["runs"] += 1
        row["done"] += task.state == "done"
        row["steps"] = task.config.steps
        if task.state != "foreign":
            row["minutes_left"] += task.experiment.minutes * (1.0 - task.share)
        row["why"] = task.experiment.why
    return list(rows.values())
