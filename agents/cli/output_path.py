"""Where a command writes: checked before the work begins; earlier results stay unless told otherwise."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path

from shake_env.errors import ParameterError
from shake_env.files import no_file

# Folders that commands made before their work, outermost first, until `without_empty_folders` ends.
_made: list[Path] = []


@contextmanager
def without_empty_folders() -> Iterator[None]:
    """Remove, at the end, the folders that `require_writable` made in between and nobody wrote to."""
    before = len(_made)
    try:
        yield
    finally:
        for folder in reversed(_made[before:]):
            with suppress(OSError):  # it holds files, or another program removed it
                folder.rmdir()
        del _made[before:]


def output_folder(
    given: Path | None, usual: Path, *, force: bool = False, field: str = "output"
) -> Path:
    """Make a folder for results, and return it.

    Parameters
    ----------
    given
        What was asked for; it must be new or empty, unless `force`.
    usual
        Taken where nothing was asked for; where it holds files already, the next free one of
        ``usual-2``, ``usual-3``, and so on.
    force
        Whether `given` may hold files.
    field
        Name of the option, for errors.

    Raises
    ------
    ParameterError
        If it cannot be made or written to, or holds files.
    """
    if given is None:
        numbered = (usual.with_name(f"{usual.name}-{number}") for number in count(2))
        folder = usual if _is_free(usual) else next(filter(_is_free, numbered))
    else:
        folder = given
        if not force and folder.is_dir() and not _is_free(folder):
            raise ParameterError(
                field,
                str(folder),
                "holds files already: give another folder, or --force to replace those of the same name",
            )
    require_writable(folder, field)
    return folder


def output_file(given: Path | None, usual: Path, field: str = "output") -> Path:
    """Make the folder of a file, and return the file: a named one is replaced, the usual one numbered.

    Raises
    ------
    ParameterError
        If the file cannot be written.
    """
    file = usual
    if given is not None:
        file = given
    elif usual.exists():
        numbered = (usual.with_name(f"{usual.stem}-{n}{usual.suffix}") for n in count(2))
        file = next(path for path in numbered if not path.exists())
    require_writable_file(file, field)
    return file


def require_writable_file(file: Path, field: str) -> None:
    """Raise ParameterError unless a file can be written; make its folder."""
    if file.is_dir():
        raise ParameterError(field, str(file), "is a folder: name a file in it")
    if file.exists() and not file.is_file():  # opening a pipe would wait for its reader
        raise ParameterError(field, str(file), f"{no_file(file)}: name another")
    require_writable(file.parent, field)
    if file.exists():
        try:
            file.open("ab").close()
        except OSError as error:
            raise _refused(file, field, error) from None


def require_storage(storage: str) -> None:
    """Raise ParameterError unless a search's storage is a URL, or a file that can be written."""
    if "://" not in storage and not storage.startswith("journal:"):
        require_writable_file(Path(storage), "storage")


def require_writable(folder: Path, field: str) -> None:
    """Raise ParameterError unless a folder can be written to; make it."""
    try:
        missing = [path for path in (folder, *folder.parents) if not path.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        _made.extend(reversed(missing))
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise _refused(folder, field, error) from None


def _refused(path: Path, field: str, error: OSError) -> ParameterError:
    return ParameterError(
        field, str(path), f"cannot be written ({error.strerror}): give a place that can"
    )


def _is_free(folder: Path) -> bool:
    try:
        return not folder.exists() or (folder.is_dir() and not any(folder.iterdir()))
    except OSError as error:
        raise _refused(folder, "output", error) from None
