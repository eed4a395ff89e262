"""Units of work: each named by what decides its result, done once, whichever engine does it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from agents.execution.encoding import decoded, encoded
from agents.execution.environment import environment, folder_token
from agents.execution.executor import Executor
from agents.execution.worker import Call
from shake_env.errors import FileError
from shake_env.files import write_bytes


@dataclass(frozen=True)
class Unit:
    """A function of a module, and the arguments that decide its result.

    It returns plain values as JSON has them, and arrays.
    """

    name: str  # for a person
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    identity: Any = None  # what decides the result; None: the arguments say it all

    def key(self) -> str:
        """Return the name of its result: a digest of all that decides it, code and versions too."""
        function = f"{self.function.__module__}.{self.function.__qualname__}"
        decides = self.arguments if self.identity is None else self.identity
        parts = [function, plain_identity(decides), environment()]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:40]


def plain_identity(value: Any) -> Any:
    """Return a value as JSON that two values share only if they are equal.

    Raises
    ------
    TypeError
        If a part is neither plain, an array, nor a dataclass of these.
    """
    if value is None or isinstance(value, bool | int | float | str):
        return value.item() if isinstance(value, np.generic) else value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, bytes):
        return ["bytes", hashlib.sha256(value).hexdigest()]
    if isinstance(value, np.ndarray):
        digest = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return ["array", value.dtype.str, list(value.shape), digest]
    if is_dataclass(value) and not isinstance(value, type):
        parts = {f.name: plain_identity(getattr(value, f.name)) for f in fields(value)}
        return [type(value).__name__, parts]
    if isinstance(value, Mapping):
        return ["mapping", [[plain_identity(k), plain_identity(v)] for k, v in value.items()]]
    if isinstance(value, list | tuple | range):
        return [plain_identity(each) for each in value]
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__} does not say what decides a result")


_report: ContextVar[Callable[[float], None]] = ContextVar("report")


def report(share: float) -> None:
    """Say from inside of a unit which share of it is done; shown where it runs in this process."""
    if (callback := _report.get(None)) is not None:
        callback(share)


class UnitRunner:
    """Runs units; those whose results lie in a folder are done.

    Parameters
    ----------
    executor
        What carries them out; None: this process, one after another.
    folder
        Of results, a file each. Workers that share it write there, for others this process does. None:
        results are not kept.
    """

    def __init__(self, executor: Executor | None = None, folder: Path | None = None) -> None:
        self.executor, self.folder = executor, folder
        self._used: set[Path] = set()

    @property
    def on_this_machine(self) -> bool:
        """Whether every unit runs on this machine."""
        return self.executor is None or self.executor.on_this_machine

    def run(
        self, units: Sequence[Unit], on_share: Callable[[int, float], None] = lambda index, share: None
    ) -> list[Any]:
        """Return the results of units, in their order.

        Parameters
        ----------
        units
            What is done. Of equal ones the first.
        on_share
            Told the index of a unit and its share done, 0 to 1.

        Raises
        ------
        ShakeError
            That a unit raised. What still runs is cancelled, and what is done stays.
        """
        values: dict[int, Any] = {}
        files: list[Path | None] = [None] * len(units)
        if self.folder is not None:
            files = [self.folder.resolve() / f"{unit.key()}.npz" for unit in units]
        missing = []
        for index, file in enumerate(files):
            if file is None or not file.is_file():
                missing.append(index)
                continue
            try:
                values[index] = decoded(file.read_bytes())
                on_share(index, 1.0)
            except FileNotFoundError:  # another command of these units has ended
                missing.append(index)
            except FileError:
                file.unlink(missing_ok=True)
                missing.append(index)
        self._used |= {file for file in files if file is not None}
        for index, content in self._contents([(i, units[i], files[i]) for i in missing], on_share):
            values[index] = decoded(content)
            if (file := files[index]) is not None and not file.is_file():
                write_bytes(file, content)
            on_share(index, 1.0)
        return [values[i] for i in range(len(units))]

    def _contents(
        self,
        units: Sequence[tuple[int, Unit, Path | None]],
        on_share: Callable[[int, float], None],
    ) -> Iterator[tuple[int, bytes]]:
        if self.executor is None:
            for index, unit, _ in units:
                token = _report.set(partial(on_share, index))
                try:
                    content = encoded(unit.function(*unit.arguments))
                finally:
                    _report.reset(token)
                yield index, content
            return
        folder = None
        if self.folder is not None and units:
            folder = self.folder.resolve(), folder_token(self.folder)
        calls = [Call(u.name, u.function, u.arguments, file, folder=folder) for _, u, file in units]
        for position, outcome in self.executor.results(calls, group=self.executor.group(len(calls))):
            yield units[position][0], outcome.content

    def forget(self) -> None:
        """Delete the results of the units that ran: what they were for is done."""
        for file in self._used:
            file.unlink(missing_ok=True)
