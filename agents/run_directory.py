"""Run directories and result files: replaced whole, read with checks, held by one process at a time."""

from __future__ import annotations

import json
import os
import re
import socket
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from shake_env.errors import FileError, RunDirectoryError, ShakeError
from shake_env.files import file_errors, no_file, sync_folder, write_json

CONFIG = "config.json"
ENVIRONMENT = "environment.json"  # code and versions that made the run
EVALUATIONS = "evaluations.jsonl"
RESULT = "result.json"
PROGRESS = "progress.json"
POLICY = "policy.safetensors"  # of a finished run
BEST = "best.safetensors"  # the policy that did best so far
FIRST = "first.safetensors"  # the policy that the run began with, if any
CHECKPOINTS = "checkpoints"
LOCK, OWNER = ".lock", ".owner.json"

LARGEST_JSON = 256 * 2**20  # [byte] a larger file is none of this program's
_PARTIAL = re.compile(r"\..+\.\d+\.partial")  # name of a file that is not complete


class InUseError(RunDirectoryError):
    """Another process holds a folder."""


def parse_json(text: str | bytes) -> Any:
    """Return the value of a JSON text.

    Raises
    ------
    ValueError
        With one sentence, whatever is wrong with it: encoding, syntax, depth.
    """
    try:
        return json.loads(text.decode() if isinstance(text, bytes) else text)
    except UnicodeDecodeError:
        raise ValueError("is no UTF-8 text") from None
    except RecursionError:
        raise ValueError("is nested too deeply") from None
    except ValueError as error:
        raise ValueError(f"is no complete JSON ({error})") from None


def read_json(
    path: Path, kind: type[ShakeError] = FileError, field: str = "file", largest: int = LARGEST_JSON
) -> dict[str, Any]:
    """Return the JSON object that a file holds.

    Parameters
    ----------
    path
        A regular file.
    kind, field
        Of the error.
    largest
        Size [byte] above which it is not read.

    Raises
    ------
    ShakeError
        Of the `kind`, if the file is missing, no regular file, too large, or holds no JSON object.
    """
    try:
        if not path.is_file():
            raise kind(field, str(path), no_file(path))
        if path.stat().st_size > largest:
            raise kind(field, str(path), f"is larger than {largest} byte")
        value = parse_json(path.read_bytes())
    except OSError as error:
        raise kind(field, str(path), f"cannot be read ({error.strerror})") from error
    except ShakeError:
        raise
    except ValueError as error:
        raise kind(field, str(path), str(error)) from error
    if not isinstance(value, dict):
        raise kind(field, str(path), "holds no JSON object")
    return value


def append_row(path: Path, row: dict[str, Any]) -> None:
    """Append a row to a run's file of JSON lines; half a line at its end is dropped first.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    with file_errors(path), path.open("ab+") as file:
        file.seek(0)
        content = file.read()
        end = content.rfind(b"\n") + 1
        if end < len(content):
            if _object(content[end:]) is None:
                file.truncate(end)
            else:
                file.write(b"\n")
        file.write(json.dumps(row).encode() + b"\n")
        file.flush()
        os.fsync(file.fileno())


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a run's file of JSON lines, without half a line; none without a file.

    Raises
    ------
    RunDirectoryError
        If the file cannot be read, or a line before the last is no JSON object.
    """
    if not path.exists():
        return []
    try:
        lines = path.read_bytes().split(b"\n")
    except OSError as error:
        raise RunDirectoryError("file", str(path), f"cannot be read ({error.strerror})") from error
    rows = []
    for number, line in enumerate(lines, start=1):
        value = _object(line)
        if value is not None:
            rows.append(value)
        elif number < len(lines):
            raise RunDirectoryError(
                "file", str(path), f"line {number} is no JSON object: correct it, or delete that line"
            )
    return rows


def evaluations_of_run(run: Path) -> list[tuple[int, float]]:
    """Return (steps, cost relative to the reference's) of each evaluation of a run, as they were made.

    Raises
    ------
    RunDirectoryError
        If the file cannot be read, or a row is no evaluation.
    """
    file = run / EVALUATIONS
    try:
        return [(int(row["steps"]), float(row["cost_ratio"])) for row in read_rows(file)]
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, ShakeError):
            raise
        what = f"the key {error} is missing" if isinstance(error, KeyError) else error
        remedy = f"holds a row that is no evaluation ({what}): restore the file, or train anew"
        raise RunDirectoryError("file", str(file), remedy) from error


def _object(line: bytes) -> dict[str, Any] | None:
    try:
        value = parse_json(line)
    except ValueError:
        return None
    return value if isinstance(value, dict) else None


@contextmanager
def locked_folder(folder: Path, wait: float = 0.0, field: str = "run directory") -> Iterator[None]:
    """Hold a run's folder, which is made if need be, against every other process.

    The lock is the operating system's and ends with the process, so that the next one takes over what
    a killed one held. A file beside it says who holds it.

    Parameters
    ----------
    folder
        A run directory, or the folder of a search.
    wait
        Time to wait for another process to end [s].
    field
        Of the error.

    Raises
    ------
    InUseError
        If another process holds it.
    FileError
        If the folder cannot be written.
    """
    owner = folder / OWNER
    with file_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / LOCK)
        try:
            lock.acquire(timeout=wait)
        except Timeout:
            raise InUseError(field, str(folder), _held_by(owner)) from None
    try:
        _remove(entry for entry in folder.iterdir() if _PARTIAL.fullmatch(entry.name))
        write_json(
            owner, {"pid": os.getpid(), "host": socket.gethostname(), "started": time.ctime()}, None
        )
        yield
    finally:
        with suppress(OSError):  # the lock is what counts
            owner.unlink(missing_ok=True)
        lock.release()


def _held_by(owner: Path) -> str:
    try:
        known = read_json(owner, largest=4096)
    except ShakeError:  # the other process is about to write it
        known = {}
    who = f"process {known.get('pid', 'unknown')} on host {known.get('host', 'unknown')}"
    return (
        f"is in use by {who}, since {known.get('started', 'now')}: wait until it has ended, or end it, "
        "or name another"
    )


def folder_contents(run: Path) -> list[str]:
    """Return the sorted names in a run's directory, but for the lock's and incomplete files."""
    if not run.is_dir():
        return []
    with file_errors(run):
        names = [entry.name for entry in run.iterdir()]
    return sorted(n for n in names if n not in (LOCK, OWNER) and not _PARTIAL.fullmatch(n))


def names_in_words(names: Iterable[str], most: int = 6) -> str:
    """Return file names in a sentence's form, at most so many of them."""
    names = list(names)
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def create_run_directory(run: Path, fill: Callable[[Path], None]) -> None:
    """Make a run directory that exists under its name only when `fill` has put its first files in it.

    A directory that is there already and empty is filled in place.

    Raises
    ------
    FileError
        If it cannot be written, or another process made one of that name in the meantime.
    """
    with file_errors(run):
        if run.is_dir():
            fill(run)
            return
        run.parent.mkdir(parents=True, exist_ok=True)
        partial = run.with_name(f".{run.name}.{os.getpid()}.partial")
        try:
            partial.mkdir(exist_ok=True)
        except OSError as error:
            error.filename = str(run)  # the name that was given
            raise
        try:
            fill(partial)
            partial.rename(run)
        except BaseException:
            _remove(partial.iterdir())
            partial.rmdir()
            raise
        sync_folder(run.parent)


def forget_attempt(run: Path) -> None:
    """Delete what an attempt that left no checkpoint has written: evaluations, best policy, progress.

    The caller has made sure that the directory is a run of this configuration. Nothing else is touched.
    """
    with file_errors(run):
        _remove(run / name for name in (EVALUATIONS, BEST, PROGRESS))


def policy_of_run(run: Path) -> Path:
    """Return the policy file of a run directory: of a finished run its policy, else its best so far."""
    best = run / BEST
    return best if best.is_file() and not (run / POLICY).is_file() else run / POLICY


def cache_folder() -> Path:
    """Return the user's cache: SHAKE_ENV_CACHE, or shake-env in XDG_CACHE_HOME or ~/.cache."""
    given = os.environ.get("SHAKE_ENV_CACHE")
    if given:
        return Path(given)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "shake-env"


def _remove(files: Iterable[Path]) -> None:
    for file in files:
        if file.is_file() or file.is_symlink():
            file.unlink(missing_ok=True)


def learning_curve(controller: str) -> list[tuple[int, float]]:
    """Return (steps, cost relative to its reference) of a policy's run, empty if it has none.

    Parameters
    ----------
    controller
        Path of a run directory, or of a policy file in one.
    """
    path = Path(controller)
    file = (path if path.is_dir() else path.parent) / "evaluations.jsonl"
    if not path.exists() or not file.is_file():
        return []
    curve = []
    for line in file.read_text(encoding="utf-8").splitlines():
        try:
            row = json.loads(line)
            curve.append((int(row["steps"]), float(row["cost_ratio"])))
        except (ValueError, KeyError, TypeError):
            continue  # a killed run leaves half a line
    return curve
