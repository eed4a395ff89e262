"""Where a command's work runs, as options of the command line; nothing else knows of the engines."""

from __future__ import annotations

import os
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from agents.execution.executor import Executor
from agents.execution.units import UnitRunner
from agents.run_directory import cache_folder
from shake_env.errors import ParameterError
from shake_env.files import file_errors

MEMORY, MOST_MEMORY = 4.0, 1e5  # [GiB] of a worker: usual, and what is no mistake


@dataclass(frozen=True, kw_only=True)
class ExecutionOptions:
    """Where work runs.

    Raises
    ------
    ParameterError
        If a number is outside its range, or an option is another executor's.
    """

    executor: Literal["local", "ray", "submitit"] = "local"
    """What runs the work: processes of this machine, a Ray cluster, or jobs of Slurm by submitit."""
    processes: int | None = None
    """Workers at a time, each of one thread (unset: two for runs and forecasts, otherwise this process
    alone; of a Ray cluster all cores)."""
    ray_address: str | None = None
    """Ray cluster: auto, HOST:6379 or ray://HOST:10001 (unset: one is started on this machine)."""
    slurm: tuple[str, ...] = ()
    """Parameters of the jobs as submitit has them, KEY=VALUE: slurm_partition=cpu timeout_min=240."""
    worker_memory: float | None = None
    """Memory of a worker [GiB]: what Ray or Slurm reserves, and the bound of its allocations (unset: 4;
    none where this process does the work itself). Given, one process is a worker, too."""
    units: Path | None = None
    """Folder of the parts that are done, until all is: the same command goes on from them, with any
    executor (unset: `units` in the user's cache, SHAKE_ENV_CACHE or ~/.cache/shake-env)."""

    def __post_init__(self) -> None:
        if self.processes is not None and self.processes < 1:
            raise ParameterError("processes", self.processes, "must be at least 1")
        if self.worker_memory is not None and not 0.0 < self.worker_memory <= MOST_MEMORY:
            remedy = f"must be above 0, at most {MOST_MEMORY:g} GiB"
            raise ParameterError("worker-memory", self.worker_memory, remedy)
        for option, engine in (("ray_address", "ray"), ("slurm", "submitit")):
            if getattr(self, option) and self.executor != engine:
                name = option.replace("_", "-")
                raise ParameterError(name, getattr(self, option), f"goes with --executor {engine}")
        if self.executor == "submitit":
            from agents.execution.submitit_executor import require_parameters

            require_parameters(self.slurm)

    @property
    def folder(self) -> Path:
        """Folder of finished units."""
        return self.units or cache_folder() / "units"

    @contextmanager
    def open_executor(self, usual: int = 2) -> Iterator[Executor]:
        """Give the executor, and end it; `usual` is the number of workers where none is given.

        Raises
        ------
        ShakeError
            If the engine is not installed or cannot be reached.
        """
        new = not self.folder.exists()
        with file_errors(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
        try:
            with self._executor(self.processes or usual) as executor:
                yield executor
        finally:
            if new:  # what has no unit in it, such as after a refusal, does not stay
                with suppress(OSError):
                    self.folder.rmdir()

    @contextmanager
    def _executor(self, number: int) -> Iterator[Executor]:
        memory = MEMORY if self.worker_memory is None else self.worker_memory
        executor: Executor
        if self.executor == "local":
            from agents.execution.local_executor import LocalExecutor

            executor = LocalExecutor(number, memory)
        elif self.executor == "ray":
            from agents.execution.ray_executor import RayExecutor

            executor = RayExecutor(self.processes, self.ray_address, memory)
        else:
            from agents.execution.submitit_executor import SubmititExecutor

            own = self.folder / f"submitit-{socket.gethostname()}-{os.getpid()}"
            executor = SubmititExecutor(number, own, memory, self.slurm)
            with executor:
                yield executor
            shutil.rmtree(own, ignore_errors=True)  # logs and pickles of jobs that all ended well
            return
        with executor:
            yield executor

    @contextmanager
    def open_workers(self, usual: int = 1) -> Iterator[Executor | None]:
        """Give the executor, and end it; None: this process does the work itself.

        `usual` is the number of local workers where none is given; one is this process, unless its
        memory is to be bounded.

        Raises
        ------
        ShakeError
            As `open_executor`.
        """
        number = self.processes or usual
        if self.executor == "local" and number == 1 and self.worker_memory is None:
            yield None
            return
        with self.open_executor(number if self.executor == "local" else max(2, usual)) as executor:
            yield executor

    @contextmanager
    def open_runner(self, usual: int = 1) -> Iterator[UnitRunner]:
        """Give what runs the units of a command; when the command has ended, their results go.

        `usual` and what is raised are those of `open_workers`.
        """
        with self.open_workers(usual) as executor:
            runner = UnitRunner(executor, self.folder)
            yield runner
        runner.forget()
