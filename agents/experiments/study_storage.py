"""SQLite files that hold the trace of searches; Optuna reads and writes them."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from shake_env.errors import ParameterError, ShakeError, install_hint
from shake_env.files import file_errors, no_file

_OF_OPTUNA = {"version_info", "studies", "trials"}  # tables of every file of Optuna's


def open_study(storage: Path, name: str) -> Any:
    """Return the Optuna study of a name in a file; both are made if need be.

    Raises
    ------
    ParameterError
        If the file is another program's, or cannot be used.
    ShakeError
        If Optuna is not installed.
    """
    try:
        import optuna
    except ImportError:
        raise ShakeError("optuna", "missing", install_hint("agents")) from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    with file_errors(storage):
        storage.parent.mkdir(parents=True, exist_ok=True)
    with storage_errors(storage):
        _require_own(storage)
        # A URL would give ?, # and % of a path another meaning.
        connect = {"creator": lambda: sqlite3.connect(storage, timeout=60.0, check_same_thread=False)}
        rdb = optuna.storages.RDBStorage("sqlite:///by-creator", engine_kwargs=connect)
        return optuna.create_study(study_name=name, storage=rdb, load_if_exists=True)


def _require_own(storage: Path) -> None:
    """Refuse what is there and not Optuna's, before Optuna would put its tables into it."""
    if not storage.exists():
        return
    if not storage.is_file():
        raise ParameterError("storage", str(storage), no_file(storage))
    with closing(sqlite3.connect(f"{storage.resolve().as_uri()}?mode=ro", uri=True)) as file:
        tables = {row[0] for row in file.execute("select name from sqlite_master where type = 'table'")}
    if tables and not tables >= _OF_OPTUNA:
        raise ParameterError("storage", str(storage), "is another program's SQLite file: name another")


@contextmanager
def storage_errors(storage: Path) -> Iterator[None]:
    """Turn errors of SQLite, as it is or wrapped by SQLAlchemy and Optuna, into a `ParameterError`."""
    try:
        yield
    except Exception as error:
        cause: BaseException | None = error
        while cause is not None and not isinstance(cause, sqlite3.Error):
            cause = cause.__cause__
        if cause is None:
            raise
        remedy = f"cannot be used ({cause}): free some space, or name another file"
        raise ParameterError("storage", str(storage), remedy) from error
