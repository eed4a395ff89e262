"""What runs on a worker: calls in their order, each with one thread, bounded memory and its own log."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import os
import socket
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import cloudpickle
from threadpoolctl import threadpool_limits

from agents.execution.encoding import encoded
from agents.execution.environment import (
    WorkerError,
    require_same_environment,
    require_shared_folder,
    shares_folder,
)
from agents.progress import LOGGERS
from shake_env.errors import ShakeError
from shake_env.files import file_errors, write_bytes

GIB = 2**30  # [byte]
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Call:
    """A function of a module with its arguments; what it returns is plain values and arrays.

    Its result is a file where the worker sees `file`'s folder, and comes back by the engine in any
    case.
    """

    name: str  # for a person
    function: Callable[..., Any]
    arguments: tuple[Any, ...] = ()
    file: Path | None = None  # of the result
    log: Path | None = None  # of what it prints; None: that comes back with the result
    folder: tuple[Path, str] | None = None  # that machines may share, and its token
    needs_folder: bool = False  # whether the worker must see it


@dataclass(frozen=True)
class Outcome:
    """What came of a call."""

    value: bytes | None  # encoded; None: it failed
    error: ShakeError | None
    log: str = ""  # what it printed, where it has no file for that

    @property
    def content(self) -> bytes:
        """What the call returned, encoded.

        Raises
        ------
        ShakeError
            That the call raised.
        """
        if self.error is not None:
            raise self.error
        assert self.value is not None
        return self.value


@dataclass(frozen=True)
class Conditions:
    """What holds on every worker of an executor."""

    environment: dict[str, str]
    working_folder: str
    memory: float | None = None  # [GiB] bound of a process; None: none


def pack_calls(calls: list[Call], conditions: Conditions) -> bytes:
    """Return calls in the form in which they travel to a worker."""
    for name, module in list(sys.modules.items()):
        if name.startswith("shake_own_"):  # a file's module, which no other process can import
            cloudpickle.register_pickle_by_value(module)
    # A worker of other code may not be able to read the calls: what it needs to say so stands before.
    header = json.dumps([conditions.environment, len(calls)]).encode()
    packed: bytes = cloudpickle.dumps((calls, conditions))
    return header + b"\n" + packed


def perform_calls(content: bytes) -> list[Outcome]:
    """Return the outcomes of calls that `pack_calls` packed; runs on the worker."""
    header, _, packed = content.partition(b"\n")
    expected, number = json.loads(header)
    try:
        require_same_environment(expected)
    except ShakeError as error:
        return [Outcome(None, error)] * number
    calls, conditions = cloudpickle.loads(packed)
    _bound_memory(conditions.memory)
    with contextlib.suppress(OSError):  # names of files and modules may be relative to it
        os.chdir(conditions.working_folder)
    return [outcome_of(call) for call in calls]


def outcome_of(call: Call) -> Outcome:
    """Run a call, or read its result where it is there; write the result where the folder is shared."""
    shared = call.folder is not None and shares_folder(*call.folder)
    lines = io.StringIO()
    try:
        if call.needs_folder and call.folder is not None:
            require_shared_folder(*call.folder)
        if shared and call.file is not None:
            with contextlib.suppress(FileNotFoundError):
                return Outcome(call.file.read_bytes(), None)
        with _log(call, lines), threadpool_limits(1):
            content = encoded(_run(call))
        if shared and call.file is not None:
            write_bytes(call.file, content)
        return Outcome(content, None, lines.getvalue())
    except ShakeError as error:
        return Outcome(None, error, lines.getvalue())


def _run(call: Call) -> Any:
    try:
        return call.function(*call.arguments)
    except ShakeError:
        raise
    except MemoryError as error:
        remedy = f"needs more memory than a worker has: --worker-memory allows it more ({error})"
        raise WorkerError("unit", call.name, remedy) from error
    except Exception as error:
        traceback.print_exc()  # into the log
        at = traceback.extract_tb(error.__traceback__)[-1]
        text = f"{type(error).__name__} at {Path(at.filename).name}:{at.lineno}: {error}"
        raise WorkerError("unit", call.name, f"failed on {socket.gethostname()}: {text}") from error


@contextmanager
def _log(call: Call, lines: TextIO) -> Iterator[None]:
    """Let what a call prints and logs go to its log."""
    with contextlib.ExitStack() as stack:
        if call.log is not None:
            with file_errors(call.log):
                call.log.parent.mkdir(parents=True, exist_ok=True)
                lines = stack.enter_context(call.log.open("w", encoding="utf-8", buffering=1))
        stack.enter_context(contextlib.redirect_stdout(lines))
        stack.enter_context(contextlib.redirect_stderr(lines))
        handler = logging.StreamHandler(lines)
        for name in LOGGERS:
            logging.getLogger(name).addHandler(handler)
            logging.getLogger(name).setLevel(logging.INFO)
        try:
            yield
        finally:
            for name in LOGGERS:
                logging.getLogger(name).removeHandler(handler)


def _bound_memory(gib: float | None) -> None:
    """Let an allocation beyond the bound fail, where the operating system has such a bound."""
    if gib is None or sys.platform == "win32":
        return
    import resource

    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    bound = int(gib * GIB)
    if hard == resource.RLIM_INFINITY or bound <= hard:
        with contextlib.suppress(ValueError, OSError):  # macOS refuses it
            resource.setrlimit(resource.RLIMIT_DATA, (bound, hard))
