"""The interface of executors: results as they come, lost workers replaced."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from types import TracebackType
from typing import Any

from agents.execution.environment import WorkerError, environment
from agents.execution.worker import Call, Conditions, Outcome, pack_calls
from agents.progress import display
from shake_env.errors import ShakeError

ATTEMPTS = 3  # workers that a call may lose before it counts as failed
PERIOD = 0.25  # [s] between two looks at what runs


class Executor(ABC):
    """Carries out packed calls somewhere; a context that ends what still runs.

    Parameters
    ----------
    workers
        Calls, or groups of them, at a time.
    memory
        Bound of a worker [GiB]; None: none.
    """

    lost: tuple[type[BaseException], ...] = ()  # what a future raises whose worker is gone
    where = "this process"

    def __init__(self, workers: int, memory: float | None = None) -> None:
        self.workers, self.memory = workers, memory

    @abstractmethod
    def submit(self, content: bytes) -> Future[list[Outcome]]:
        """Have `worker.perform_calls` carry out packed calls."""

    @abstractmethod
    def cancel(self) -> None:
        """End what is submitted and has no result yet, at once."""

    def shutdown(self) -> None:
        """Give up the workers; what still runs is cancelled."""
        self.cancel()

    @property
    def depth(self) -> int:
        """Number of submissions that are out at a time."""
        return self.workers

    def waiting(self) -> AbstractContextManager[Any]:
        """Return what surrounds the wait for results."""
        return nullcontext()

    def group(self, number: int) -> int:
        """Return how many of so many short calls are one submission."""
        return 1

    def results(
        self,
        calls: Sequence[Call],
        *,
        group: int = 1,
        on_tick: Callable[[], None] = lambda: None,
        on_submit: Callable[[int], None] = lambda index: None,
    ) -> Iterator[tuple[int, Outcome]]:
        """Yield (index, outcome) of calls as they come.

        Parameters
        ----------
        calls
            Handed out in this order. One whose worker is lost is tried again, `ATTEMPTS` times in all.
        group
            Calls of a submission.
        on_tick, on_submit
            Told every quarter of a second; and of each call when it is handed out.
        """
        conditions = Conditions(environment(), os.getcwd(), self.memory)
        waiting = deque(
            (list(range(i, min(i + group, len(calls)))), 1) for i in range(0, len(calls), group)
        )
        running: dict[Future[list[Outcome]], tuple[list[int], int]] = {}
        try:
            while waiting or running:
                while waiting and len(running) < self.depth:
                    members, attempt = waiting.popleft()
                    for index in members:
                        on_submit(index)
                    future = self.submit(pack_calls([calls[i] for i in members], conditions))
                    running[future] = members, attempt
                with self.waiting():
                    done, _ = wait(running, timeout=PERIOD, return_when=FIRST_COMPLETED)
                for future in done:
                    members, attempt = running.pop(future)
                    try:
                        outcomes = future.result()
                    except self.lost as error:
                        if attempt < ATTEMPTS:
                            display.note(f"{calls[members[0]].name}: its worker was lost, tried again")
                            waiting.appendleft((members, attempt + 1))
                            continue
                        outcomes = [_lost(calls[i], error) for i in members]
                    for index, outcome in zip(members, outcomes, strict=True):
                        for line in outcome.log.splitlines():
                            display.note(f"{calls[index].name}: {line}")
                        yield index, replace(outcome, log="")
                on_tick()
        finally:
            if running:
                self.cancel()

    def __enter__(self) -> Executor:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.shutdown()


def _lost(call: Call, error: BaseException) -> Outcome:
    reason = (str(error) or type(error).__name__).strip().splitlines()[0]
    remedy = f"its worker was lost {ATTEMPTS} times, perhaps for lack of memory ({reason})"
    failure: ShakeError = WorkerError("unit", call.name, remedy)
    return Outcome(None, failure)
