"""What a worker must have in common with the process that hands out the work."""

from __future__ import annotations

import hashlib
import importlib.metadata
import platform
import secrets
import socket
from functools import lru_cache
from os import PathLike
from pathlib import Path

from agents.provenance import PACKAGES
from shake_env.errors import FileError, ShakeError
from shake_env.files import write_text

# Distributions whose version can change a result.
LIBRARIES = (
    "numpy", "scipy", "numba", "torch", "stable-baselines3", "sb3-contrib", "gymnasium", "optuna",
    "control", "osqp",
)  # fmt: skip
SAME = "install the same version of this project and its constraints.txt on every machine"
TOKEN = ".token"  # file by which a worker knows that it sees a folder


class WorkerError(ShakeError):
    """A worker cannot do its work: another environment, no memory, a lost process."""


@lru_cache(maxsize=1)
def environment() -> dict[str, str]:
    """Return what decides a result besides its inputs: code and versions.

    ``code`` is a digest of all files of the three packages, tuned values and policies included.
    """
    return {
        "python": ".".join(platform.python_version_tuple()[:2]),
        "code": _code(),
        **{name: _version(name) for name in LIBRARIES},
    }


def require_same_environment(expected: dict[str, str]) -> None:
    """Raise `WorkerError` unless this process has the code and the versions that are expected."""
    own = environment()
    differing = [name for name in expected if own.get(name) != expected[name]]
    if not differing:
        return
    pairs = ", ".join(f"{name} {own.get(name)} where {expected[name]} is needed" for name in differing)
    raise WorkerError("worker", socket.gethostname(), f"has {pairs}: {SAME}")


def folder_token(folder: str | PathLike[str]) -> str:
    """Return the content of a folder's token, which is written if need be."""
    file = Path(folder) / TOKEN
    if not file.is_file():
        write_text(file, secrets.token_hex(16))
    return file.read_text(encoding="utf-8")


def shares_folder(folder: str | PathLike[str], token: str) -> bool:
    """Return whether this process sees the folder that a token was written into."""
    try:
        return (Path(folder) / TOKEN).read_text(encoding="utf-8") == token
    except OSError:
        return False


def require_shared_folder(folder: str | PathLike[str], token: str) -> None:
    """Raise `FileError` unless this process sees the folder that a token was written into."""
    if not shares_folder(folder, token):
        remedy = (
            f"is not the same folder on {socket.gethostname()}: name one on a file system that all "
            "machines share"
        )
        raise FileError("folder", str(folder), remedy)


def _code() -> str:
    digest = hashlib.sha256()
    root = Path(__file__).parents[2]
    for package in PACKAGES:
        for file in sorted((root / package).rglob("*")):
            if file.is_file() and "__pycache__" not in file.parts:
                digest.update(str(file.relative_to(root)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "none"
