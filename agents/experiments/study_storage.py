"""Storages that hold the trace of searches; Optuna reads and writes them.

A path is an SQLite file, for processes of one machine, each with a study of its own. A URL is a storage
that several processes and machines work on: ``postgresql+pg8000://...`` and whatever else SQLAlchemy
reaches, ``grpc://HOST:PORT`` (a proxy of `optuna.storages.run_grpc_proxy_server`), and ``journal:FILE``
on a shared file system.
"""

from __future__ import annotations

import json
import os
import socket
import sqlite3
import time
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Any

from agents.experiments import signs_of_life
from agents.progress import display
from agents.run_directory import InUseError, locked_folder
from shake_env.errors import ParameterError, RunDirectoryError, ShakeError, install_hint
from shake_env.files import file_errors, no_file

ATTEMPTS = 4  # to open a database in which other processes make the tables
SLOTS = 1000  # processes that work on a search from one folder
POLL = 0.5  # [s] between two looks at a study whose last trials other processes have
LONGEST_ENTRY = 100_000  # [bytes] of a journal that are read to tell what it is
_JOURNAL, _PROXY = "journal:", "grpc://"
_OF_OPTUNA = {"version_info", "studies", "trials"}  # tables of every file of Optuna's


def is_shared(storage: str | PathLike[str]) -> bool:
    """Return whether a study's storage is one that several processes work on."""
    return "://" in str(storage) or str(storage).startswith(_JOURNAL)


def open_study(storage: str | PathLike[str], name: str) -> tuple[Any, bool]:
    """Return the Optuna study of a name, and whether it was made now.

    Raises
    ------
    ParameterError
        If the storage is another program's, or cannot be used.
    ShakeError
        If Optuna is not installed.
    """
    try:
        import optuna
    except ImportError:
        raise ShakeError("optuna", "missing", install_hint("agents")) from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    with storage_errors(storage):
        backend = _shared(str(storage)) if is_shared(storage) else _own_file(Path(storage))
        try:
            return optuna.create_study(study_name=name, storage=backend), True
        except optuna.exceptions.DuplicatedStudyError:
            return optuna.load_study(study_name=name, storage=backend), False


def _own_file(file: Path) -> Any:
    import optuna
    import sqlalchemy.pool

    with file_errors(file):
        file.parent.mkdir(parents=True, exist_ok=True)
    _require_own(file)
    # A URL would give ?, # and % of a path another meaning. A pool would keep connections open.
    connect = {
        "creator": lambda: sqlite3.connect(file, timeout=60.0, check_same_thread=False),
        "poolclass": sqlalchemy.pool.NullPool,
    }
    return _with_tables(
        lambda: optuna.storages.RDBStorage("sqlite:///by-creator", engine_kwargs=connect)
    )


def _shared(url: str) -> Any:
    import optuna
    import sqlalchemy.pool

    storages = optuna.storages
    if url.startswith(_JOURNAL):
        from optuna.storages.journal import JournalFileBackend

        name = url.removeprefix(_JOURNAL).removeprefix("//")
        if not name:
            raise ParameterError("storage", url, "must be journal:FILE")
        file = Path(name)
        with file_errors(file):
            file.parent.mkdir(parents=True, exist_ok=True)
            _require_journal(url, file)
        return storages.JournalStorage(JournalFileBackend(str(file)))
    if url.startswith(_PROXY):
        host, _, port = url.removeprefix(_PROXY).rstrip("/").rpartition(":")
        if not host or not port.isdecimal():
            raise ParameterError("storage", url, "must be grpc://HOST:PORT")
        proxy = storages.GrpcStorageProxy(host=host, port=int(port))
        try:
            proxy.wait_server_ready(timeout=30.0)
        except Exception as error:  # of grpc, which is imported on use
            raise ParameterError("storage", url, "no proxy answers there: start it first") from error
        return proxy
    # Each process of a search would otherwise keep connections that it seldom needs.
    unpooled = {"poolclass": sqlalchemy.pool.NullPool}
    return _with_tables(
        lambda: storages.RDBStorage(url, engine_kwargs=unpooled, **signs_of_life.heartbeat_options())
    )


def _with_tables(make: Callable[[], Any]) -> Any:
    """Make the storage of a database, whose tables another process may make at the same time."""
    import sqlalchemy.exc

    refused = (sqlalchemy.exc.IntegrityError, sqlalchemy.exc.ProgrammingError)
    for attempt in range(1, ATTEMPTS + 1):
        try:
            return make()
        except (*refused, sqlalchemy.exc.OperationalError) as error:  # SQLite's has the last
            if attempt == ATTEMPTS or not (isinstance(error, refused) or "exists" in str(error)):
                raise
            time.sleep(attempt)
    raise AssertionError


def _require_journal(url: str, file: Path) -> None:
    """Refuse what is there and no journal, before Optuna would write its own lines into it."""
    if not file.exists():
        return
    if not file.is_file():
        raise ParameterError("storage", url, no_file(file))
    with file.open("rb") as stream:
        line = stream.readline(LONGEST_ENTRY)
    if line and not (line.startswith(b"{") and b'"op_code"' in line):
        raise ParameterError("storage", url, "is no journal of Optuna: name another file")


def _require_own(storage: Path) -> None:
    """Refuse what is there and not Optuna's, before Optuna would put its tables into it."""
    if not storage.exists():
        return
    if not storage.is_file():
        raise ParameterError("storage", str(storage), no_file(storage))
    for wait in (0.0, 1.0):  # another process may be about to make the tables
        time.sleep(wait)
        with closing(sqlite3.connect(f"{storage.resolve().as_uri()}?mode=ro", uri=True)) as file:
            rows = file.execute("select name from sqlite_master where type = 'table'").fetchall()
        tables = {row[0] for row in rows}
        if not tables or tables >= _OF_OPTUNA:
            return
    raise ParameterError("storage", str(storage), "is another program's SQLite file: name another")


def free_slot(home: Path, held: ExitStack) -> str:
    """Hold the first folder of a search that no other process has, and return its name.

    Raises
    ------
    RunDirectoryError
        If there is none.
    """
    for number in range(SLOTS):
        try:
            held.enter_context(locked_folder(home / f"worker-{number}"))
        except InUseError:
            continue
        return f"worker-{number}"
    raise RunDirectoryError("folder", str(home), f"{SLOTS} processes have it: name another")


def has_free_trial(study: Any, total: int, finished: Callable[[], int]) -> bool | None:
    """Return whether a study lacks a trial that no process has; None: those at work decide.

    Parameters
    ----------
    study
        Other processes may work on it, too.
    total
        Trials that are wanted. Processes that find the last one lacking at once each make one.
    finished
        The number of those that are done.
    """
    if (done := finished()) >= total:
        return False
    signs_of_life.retry_lost_trials(study)
    states = [trial.state.name for trial in study.get_trials(deepcopy=False)]
    return "WAITING" in states or done + states.count("RUNNING") < total or None


def may_begin(study: Any, total: int, finished: Callable[[], int]) -> bool:
    """Wait until a study lacks a trial that no process has; return whether there is one.

    The parameters are those of `has_free_trial`.
    """
    while (free := has_free_trial(study, total, finished)) is None:
        note_wait()
        time.sleep(POLL)
    return free


@lru_cache(maxsize=1)
def note_wait() -> None:
    """Say, once, what a process waits for that has no trial."""
    grace = f"{signs_of_life.GRACE} s without a sign of its process"
    display.note(f"waits for trials of other processes; one is tried again after {grace}")


def shared_sampler(seed: int, place: int) -> Any:
    """Return a sampler of a shared study, seeded by the process and the number of trials before."""
    import optuna

    own = zlib.crc32(f"{socket.gethostname()} {os.getpid()}".encode()) % 997
    return optuna.samplers.TPESampler(
        seed=seed + 1000 * place + own, multivariate=True, constant_liar=True
    )


@contextmanager
def storage_errors(storage: str | PathLike[str]) -> Iterator[None]:
    """Turn errors of a database or a journal, as they are or wrapped, into a `ParameterError`.

    What Optuna calls experimental (heartbeats, journals, the proxy) is used without a warning.
    """
    import optuna
    import sqlalchemy.exc

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            # Trials that are asked for have theirs from `signs_of_life`.
            warnings.filterwarnings("ignore", "Heartbeat of storage", UserWarning)
            yield
    except Exception as error:
        cause: BaseException | None = error
        kinds = (
            sqlite3.Error, sqlalchemy.exc.SQLAlchemyError, ModuleNotFoundError, json.JSONDecodeError,
        )  # fmt: skip
        while cause is not None and not (isinstance(cause, kinds) or _of_journal(cause, str(storage))):
            cause = cause.__cause__
        if cause is None or (isinstance(cause, ModuleNotFoundError) and not is_shared(storage)):
            raise
        while isinstance(cause.__cause__, sqlite3.Error):  # says it without SQLAlchemy's words
            cause = cause.__cause__
        words = cause.strerror if isinstance(cause, OSError) else str(cause)
        reason = (words or type(cause).__name__).strip().splitlines()[0]
        remedy = f"cannot be used ({reason}): free some space, or name another file"
        if is_shared(storage) and not isinstance(cause, OSError):
            remedy = f"cannot be used ({reason}): is the server reachable, and its driver installed?"
        raise ParameterError("storage", without_password(storage), remedy) from error


def _of_journal(error: BaseException, storage: str) -> bool:
    """Return whether an error is the operating system's with a journal, whose writes name no file."""
    if not storage.startswith(_JOURNAL) or not isinstance(error, OSError) or error.errno is None:
        return False
    file = storage.removeprefix(_JOURNAL).removeprefix("//")
    named = error.filename is not None
    return str(error.filename).startswith(file) if named else not isinstance(error, BrokenPipeError)


def without_password(storage: str | PathLike[str]) -> str:
    """Return the address of a study's storage without its password."""
    import sqlalchemy.engine
    import sqlalchemy.exc

    try:
        if "://" not in str(storage):
            return str(storage)
        return sqlalchemy.engine.make_url(str(storage)).render_as_string(hide_password=True)
    except sqlalchemy.exc.ArgumentError:
        return "a URL that is none"
