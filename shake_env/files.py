"""The one way to write a file: it is replaced whole, and an error names it."""

from __future__ import annotations

import errno
import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from shake_env.errors import FileError

_REMEDIES = {
    errno.ENOSPC: "the disk is full: free some space, then give the same command again",
    errno.EDQUOT: "the quota is used up: free some space, then give the same command again",
    errno.EFBIG: "the file would be larger than the limit on files (ulimit -f): raise the limit",
    errno.EEXIST: "is a file, where a folder is needed: give another path",
    errno.ENOTDIR: "has a file on its way, where a folder is needed: give another path",
    errno.EROFS: "the file system is read-only: give a folder that can be written",
    errno.EACCES: "no permission: give a folder that can be written",
    errno.EPERM: "no permission: give a folder that can be written",
}


@contextmanager
def file_errors(path: Path) -> Iterator[None]:
    """Turn an `OSError` into a `FileError` that names the file; `path` where the error names none."""
    try:
        yield
    except OSError as error:
        if error.errno is None:  # none of the operating system: a library's own
            raise
        remedy = _REMEDIES.get(error.errno, f"{error.strerror}: give another path")
        raise FileError("file", os.fspath(error.filename or path), remedy) from error


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give the path of a new file that takes the place of `path` once it is complete and on the disk.

    Folders on the way are made. Readers see the old file or the new one, whatever is interrupted. Of a
    symbolic link the file that it leads to is replaced.

    Raises
    ------
    FileError
        If the folder cannot be written, the disk is full, or `path` is a folder, a pipe or a device.
    """
    with file_errors(path):
        path = Path(os.path.realpath(path))
        if path.exists() and not path.is_file():
            raise FileError("file", str(path), "is a folder, a pipe or a device: name a file")
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
        try:
            yield partial
            with partial.open("rb+") as file:
                os.fsync(file.fileno())
            partial.replace(path)
        except OSError as error:
            if error.filename == str(partial):
                error.filename = str(path)
            raise
        finally:
            with suppress(OSError):  # which would hide why it was not written
                partial.unlink(missing_ok=True)
        sync_folder(path.parent)


def write_bytes(path: Path, content: bytes) -> None:
    """Replace a file by one with this content, as :func:`replacing` does."""
    with replacing(path) as partial:
        partial.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Replace a file by one with this text in UTF-8, as :func:`replacing` does."""
    write_bytes(path, text.encode())


def write_json(path: Path, value: Any, indent: int | None = 2) -> None:
    """Replace a file by one with this value as JSON, as :func:`replacing` does."""
    write_text(path, json.dumps(value, indent=indent) + "\n")


def no_file(path: Path) -> str:
    """Return in words what stands at a path at which no regular file does."""
    if path.is_dir():
        return "is a folder, where a file is needed"
    if path.exists():
        return "is a pipe or a device, where a file is needed"
    return "there is no such file"


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk, where the file system can."""
    if sys.platform == "win32":
        return  # folders cannot be opened there
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError:  # some network file systems have no such thing
        pass
    finally:
        os.close(descriptor)
