"""The interface of executors: results as they come, lost workers replaced."""

from __future__ import annotations

import os
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from types import TracebackType
from typing import Any

from agents.execution.environment import SAME, WorkerError, environment
from agents.execution.worker import Call, Conditions, Outcome, pack_calls
from agents.progress import display
from shake_env.errors import ShakeError

ATTEMPTS = 3  # workers that a call may lose before it counts as failed
PERIOD = 0.25  # [s] between two looks at what runs
_END = object()


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
    on_this_machine = False  # whether every worker is

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
    def places(self) -> int:
        """Number of submissions that can run at a time, now."""
        return self.workers

    @property
    def depth(self) -> int:
        """Number of submissions that are out at a time."""
        return self.places

    def waiting(self) -> AbstractContextManager[Any]:
        """Return what surrounds the wait for results."""
        return nullcontext()

    def group(self, number: int) -> int:
        """Return how many of so many short calls are one submission."""
        return 1

    def results(
        self,
        calls: Iterable[Call | None],
        *,
        group: int = 1,
        on_tick: Callable[[], None] = lambda: None,
        on_submit: Callable[[int], None] = lambda index: None,
    ) -> Iterator[tuple[int, Outcome]]:
        """Yield (index, outcome) of calls as they come.

        Parameters
        ----------
        calls
            Handed out in this order, each taken when there is room for it. None stands for nothing at
            present: the next is asked for when a call has ended, or after a quarter of a second. One
            whose worker is lost is tried again, `ATTEMPTS` times in all.
        group
            Calls of a submission.
        on_tick, on_submit
            Told every quarter of a second; and of each call when it is handed out.
        """
        conditions = Conditions(environment(), os.getcwd(), self.memory)
        source, taken, more = iter(calls), list[Call](), True

        def next_group() -> list[int]:
            nonlocal more
            first = len(taken)
            while more and len(taken) < first + group:
                call = next(source, _END)
                more = call is not _END
                if not isinstance(call, Call):
                    break
                taken.append(call)
            return [*range(first, len(taken))]

        lost = deque[tuple[list[int], int]]()
        running: dict[Future[list[Outcome]], tuple[list[int], int]] = {}
        try:
            while more or lost or running:
                while len(running) < self.depth:
                    members, attempt = lost.popleft() if lost else (next_group(), 1)
                    if not members:
                        break
                    for index in members:
                        on_submit(index)
                    future = self.submit(pack_calls([taken[i] for i in members], conditions))
                    running[future] = members, attempt
                if more and not running:
                    time.sleep(PERIOD)
                with self.waiting():
                    done, _ = wait(running, timeout=PERIOD, return_when=FIRST_COMPLETED)
                for future in done:
                    members, attempt = running.pop(future)
                    try:
                        outcomes = future.result()
                    except Exception as error:  # the engine's; what a call raised is an outcome
                        gone = isinstance(error, self.lost)
                        if gone and attempt < ATTEMPTS:
                            display.note(f"{taken[members[0]].name}: its worker was lost, tried again")
                            lost.appendleft((members, attempt + 1))
                            continue
                        outcomes = [_failed(taken[i], error, gone) for i in members]
                    for index, outcome in zip(members, outcomes, strict=True):
                        for line in outcome.log.splitlines():
                            display.note(f"{taken[index].name}: {line}")
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


def _failed(call: Call, error: Exception, gone: bool) -> Outcome:
    lines = (str(error) or type(error).__name__).strip().splitlines()
    remedy = (
        f"its worker was lost {ATTEMPTS} times ({lines[0]}): perhaps for lack of memory, which "
        "--worker-memory gives"
    )
    if not gone:
        # Engines put the worker's traceback, and words of their own, around its last line.
        reason = next((line for line in reversed(lines) if "Error: " in line), lines[0])
        remedy = f"its worker could not begin ({reason}): {SAME}"
    failure: ShakeError = WorkerError("unit", call.name, remedy)
    return Outcome(None, failure)
