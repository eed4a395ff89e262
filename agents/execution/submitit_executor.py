"""Jobs of Slurm through submitit; processes of this machine where there is no Slurm."""

from __future__ import annotations

import math
import os
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager, nullcontext
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from agents.execution.executor import Executor
from agents.execution.worker import THREAD_VARIABLES, Outcome, perform_calls
from shake_env.errors import ParameterError, ShakeError, install_hint
from shake_env.files import file_errors

WAVES = 4  # jobs for each worker that many short calls become
POLL = 0.2  # [s] between two looks at the jobs
ENDING = 10.0  # [s] that cancelled processes of this machine are waited for
MINUTES = 24 * 60  # time limit of a job, unless a parameter says otherwise


class SubmititExecutor(Executor):
    """One job a submission. A job that Slurm preempts or requeues begins its calls again.

    Parameters
    ----------
    workers
        Jobs at a time.
    folder
        For submitit's own files, on a file system that all nodes share.
    memory
        Of a job [GiB].
    parameters
        Further ones of `submitit.AutoExecutor`, such as ``slurm_partition``, as ``KEY=VALUE``.

    Raises
    ------
    ShakeError
        If submitit is not installed.
    ParameterError
        If a parameter is unknown.
    """

    def __init__(
        self, workers: int, folder: Path, memory: float = 4.0, parameters: tuple[str, ...] = ()
    ) -> None:
        try:
            import submitit
        except ImportError:
            raise ShakeError("submitit", "missing", install_hint("slurm")) from None
        super().__init__(workers, memory)
        self.lost = (submitit.core.utils.UncompletedJobError,)
        with file_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            self._engine = _engine(folder, memory, parameters)
        self._folder = folder
        self._jobs: dict[Future[list[Outcome]], Any] = {}
        self._lock, self._over = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._poll, name="shake-jobs", daemon=True)
        self._thread.start()

    def group(self, number: int) -> int:
        """Return how many of so many short calls are one job."""
        return max(1, math.ceil(number / (WAVES * self.workers)))

    def submit(self, content: bytes) -> Future[list[Outcome]]:
        """Submit a job."""
        future: Future[list[Outcome]] = Future()
        # What watches a job on this machine ends with a traceback when it is interrupted.
        local = self._engine.cluster == "local"
        log = self._folder / "local.log"
        with file_errors(self._folder), _errors_into(log) if local else nullcontext():
            job = self._engine.submit(perform_calls, content)
        with self._lock:
            self._jobs[future] = job
        return future

    def cancel(self) -> None:
        """Cancel the jobs."""
        with self._lock:
            jobs = [*self._jobs.values()]
            self._jobs.clear()
        for job in jobs:
            job.cancel()
        end = time.monotonic() + ENDING
        while self._engine.cluster == "local" and time.monotonic() < end:
            if all(job.done() for job in jobs):
                break
            time.sleep(POLL)

    def shutdown(self) -> None:
        """Cancel the jobs and look at no more."""
        self.cancel()
        self._over.set()
        self._thread.join()

    def _poll(self) -> None:
        while not self._over.wait(POLL):
            with self._lock:
                done = [(future, job) for future, job in self._jobs.items() if job.done()]
                for future, _ in done:
                    del self._jobs[future]
            for future, job in done:
                try:
                    future.set_result(job.result())
                except BaseException as error:  # whatever submitit raises is for who waits
                    future.set_exception(error)


def require_parameters(parameters: tuple[str, ...]) -> None:
    """Raise `ParameterError` if one is not understood, as far as that can be told without submitit."""
    if find_spec("submitit") is None:
        for text in parameters:
            _parameter(text)
        return
    with tempfile.TemporaryDirectory() as name:
        _engine(Path(name), 1.0, parameters)


def _engine(folder: Path, memory: float, parameters: tuple[str, ...]) -> Any:
    """Return submitit's executor with the usual parameters and those that are given."""
    import submitit

    given = dict(_parameter(text) for text in parameters)
    engine = submitit.AutoExecutor(folder=folder)
    usual = {"name": "shake", "timeout_min": MINUTES, "cpus_per_task": 1, "mem_gb": memory}
    if engine.cluster == "slurm":
        usual["slurm_setup"] = [f"export {name}=1" for name in THREAD_VARIABLES]
    try:
        engine.update_parameters(**{**usual, **given})
    except (NameError, TypeError, ValueError, AssertionError) as error:  # the last for a wrong type
        reason = str(error).strip().splitlines()[0]
        raise ParameterError("slurm", parameters, f"is not understood ({reason})") from error
    return engine


@contextmanager
def _errors_into(file: Path) -> Iterator[None]:
    """Let processes that begin meanwhile have a file as standard error."""
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        log = os.open(file, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
        os.dup2(log, 2)
        os.close(log)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _parameter(text: str) -> tuple[str, Any]:
    key, separator, value = text.partition("=")
    if not separator or not key:
        raise ParameterError("slurm", text, "must be KEY=VALUE, such as slurm_partition=cpu")
    if key.endswith("timeout_min") and not (value.isdecimal() and int(value) > 0):
        raise ParameterError("slurm", text, "must be a whole number of minutes above 0")
    return key, int(value) if value.isdecimal() else value
