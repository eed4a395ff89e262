"""Processes of this machine."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import Connection

from agents.execution.executor import Executor
from agents.execution.worker import THREAD_VARIABLES, Outcome, perform_calls


class LocalExecutor(Executor):
    """Worker processes, each a pool of its own, so that a lost one takes no other with it."""

    lost = (BrokenExecutor,)
    on_this_machine = True

    def __init__(self, workers: int, memory: float | None = None) -> None:
        super().__init__(workers, memory)
        self._workers: list[_Worker | None] = [None] * workers

    def submit(self, content: bytes) -> Future[list[Outcome]]:
        """Give the calls to a process that has nothing to do; `depth` says how many there are."""
        for index, worker in enumerate(self._workers):
            if worker is None or worker.gone:
                worker = self._workers[index] = _Worker()
            if worker.idle:
                return worker.submit(content)
        raise AssertionError("more is submitted than there are workers")

    def cancel(self) -> None:
        """End the processes, whatever they do; others begin when there is more to do."""
        for worker in self._workers:
            if worker is not None:
                worker.end()
        self._workers = [None] * self.workers


class _Worker:
    """A process that ends when its parent ends, or closes its end of a pipe."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        reader, self._end = context.Pipe(duplex=False)
        self._pool = ProcessPoolExecutor(1, mp_context=context, initializer=_attach, initargs=(reader,))
        self._reader = reader
        self._future: Future[list[Outcome]] | None = None

    @property
    def idle(self) -> bool:
        return self._future is None or self._future.done()

    @property
    def gone(self) -> bool:
        done = self._future is not None and self._future.done()
        return done and isinstance(self._future.exception(), BrokenExecutor)  # type: ignore[union-attr]

    def submit(self, content: bytes) -> Future[list[Outcome]]:
        # Libraries read these when they are loaded, which in the process is after this.
        before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
        os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
        try:
            with _interruption_later():  # the process begins with it held back, until `_attach`
                self._future = self._pool.submit(perform_calls, content)
        finally:
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value
        return self._future

    def end(self) -> None:
        busy = not self.idle
        if busy:
            self._end.close()
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._end.close()
        self._reader.close()


@contextmanager
def _interruption_later() -> Iterator[None]:
    """Hold Ctrl-C back, here and in processes that begin meanwhile, where the system can."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _attach(reader: Connection) -> None:
    """Bind a process to its parent; Ctrl-C is the parent's to handle."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})

    def wait() -> None:
        try:
            reader.recv()
        except (EOFError, OSError):
            os._exit(1)

    threading.Thread(target=wait, name="shake-parent", daemon=True).start()
