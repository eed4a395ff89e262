"""Many trainings, some at a time, each in a process of its own; what is done is not done again."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from fnmatch import fnmatch
from os import PathLike
from pathlib import Path
from typing import Any, Literal

from agents.experiments.catalogue import ExperimentConfig
from agents.plain_values import typed
from agents.progress import Progress
from agents.run_directory import CONFIG, PROGRESS, read_json
from agents.training.checkpoint import checkpoint_steps, checkpoints
from agents.training.config import TrainConfig, require_same
from agents.training.run import finished, require_beginnable
from shake_env.errors import RunDirectoryError, ScenarioError, unknown
from shake_env.files import file_errors

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
        except RunDirectoryError as error:  # also that of another version, or damaged
            self.state, self.failure = "foreign", str(error)
            return
        if finished(self.run):
            self.state, self.share = "done", 1.0
        elif saved := checkpoints(self.run):
            self.state = "begun"
            self.share = checkpoint_steps(saved[-1]) / self.config.steps

    def watch(self) -> None:
        """Read the progress of the running process."""
        try:
            progress = typed(Progress, read_json(self.run / PROGRESS, largest=2**20))
        except ValueError:  # there is none yet
            return
        self.share = min(progress.steps / max(progress.total_steps, 1), 1.0)
        self.seconds, self.cost_ratio = progress.seconds, progress.cost_ratio

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
        From :func:`plan`.
    processes
        Runs at a time.
    """

    tasks: list[Task]
    processes: int = 2
    _running: dict[int, subprocess.Popen[bytes]] = field(default_factory=dict)

    def run(self, on_update: Callable[[Campaign], None] = lambda campaign: None) -> None:
        """Run what is not done. A run that fails is noted and stops no other.

        Interrupted, the processes end with it and the runs go on from their checkpoints another time.
        """
        queue = [i for i, task in enumerate(self.tasks) if task.state in ("begun", "waiting")]
        with self._ended():
            while queue or self._running:
                while queue and len(self._running) < self.processes:
                    self._start(queue.pop(0))
                time.sleep(0.25)
                for i, process in list(self._running.items()):
                    self.tasks[i].watch()
                    if process.poll() is not None:
                        self._finish(i, self._running.pop(i).returncode)
                on_update(self)

    @contextmanager
    def _ended(self) -> Iterator[None]:
        try:
            yield
        finally:
            for process in self._running.values():
                process.terminate()
            for process in self._running.values():
                process.wait()
            self._running.clear()

    def _start(self, number: int) -> None:
        task = self.tasks[number]
        task.state, task.first_share = "running", task.share
        with file_errors(task.run):
            task.run.parent.mkdir(parents=True, exist_ok=True)
            (task.run / PROGRESS).unlink(missing_ok=True)  # that of the process before
        command = f"shake run-experiments --experiments {task.experiment.name}"
        one = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
        paths = [str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")]
        with file_errors(_log(task)), _log(task).open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", "agents.experiments.worker", str(task.run), command],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**os.environ, **one, "PYTHONPATH": os.pathsep.join(p for p in paths if p)},
            )
        assert process.stdin is not None
        process.stdin.write(json.dumps(task.config.to_json()).encode())
        process.stdin.close()
        self._running[number] = process

    def _finish(self, number: int, code: int) -> None:
        task = self.tasks[number]
        if code == 0 and finished(task.run):
            task.state, task.share = "done", 1.0
            return
        lines = _log(task).read_text(encoding="utf-8", errors="replace").strip().splitlines()
        task.state = "failed"
        task.failure = lines[-1] if lines else f"ended with code {code}"

    def seconds_left(self) -> float:
        """Return the time left [s], from what is expected and how the runs so far kept to it."""
        paces = [pace for task in self.tasks if (pace := task.pace) is not None]
        usual = sum(paces) / len(paces) if paces else 1.0
        left = [
            60.0 * task.experiment.minutes * (1.0 - task.share) * (task.pace or usual)
            for task in self.tasks
            if task.state in ("begun", "waiting", "running")
        ]
        return max([sum(left) / self.processes, *left], default=0.0)

    def counts(self) -> dict[str, int]:
        """Return the number of runs in each state that there is."""
        states = [task.state for task in self.tasks]
        return {state: states.count(state) for state in sorted(set(states))}

    def failures(self) -> dict[str, str]:
        """Return why runs failed, or are not this campaign's, by their names."""
        return {t.name: t.failure for t in self.tasks if t.state in ("failed", "foreign")}


def _log(task: Task) -> Path:
    return task.run.with_name(task.run.name + ".log")


def plan(
    experiments: Sequence[ExperimentConfig],
    folder: str | PathLike[str],
    only: Sequence[str] = (),
    seeds: int | None = None,
) -> list[Task]:
    """Return the runs of a campaign with the state of each.

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
    tasks = []
    for experiment in experiments:
        if only and not any(fnmatch(experiment.name, pattern) for pattern in only):
            continue
        for seed in range(experiment.seeds if seeds is None else seeds):
            task = Task(experiment, experiment.with_seed(seed), folder / experiment.name / str(seed))
            task.look()
            tasks.append(task)
    return tasks


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
        row["minutes_left"] += task.experiment.minutes * (1.0 - task.share)
        row["why"] = task.experiment.why
    return list(rows.values())
