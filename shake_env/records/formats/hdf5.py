"""What an HDF5 file holds, read by a process of its own with limits on its time and memory."""

from __future__ import annotations

import importlib.util
import io
import json
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.errors import RecordError

_CHILD = Path(__file__).with_name("hdf5_child.py")
SECONDS = 20  # of processor time, and one more for each `BYTES_A_SECOND`
BYTES_A_SECOND = 10_000_000
WAITING = 10  # times the processor time that is waited for on a busy machine
DAMAGED = "h5py cannot read it: the file is damaged"


@dataclass(frozen=True)
class Item:
    """A link, group or data set of a file."""

    path: str  # from the root, with slashes
    kind: str  # array, group, link, elsewhere (in another file), large, other
    attributes: Mapping[str, str | float]
    values: NDArray[Any] | None = None  # of an array
    size: int = 0  # of one that is too large


def has_h5py() -> bool:
    """Return whether h5py is installed."""
    if "h5py" in sys.modules:
        return sys.modules["h5py"] is not None
    return importlib.util.find_spec("h5py") is not None


def hdf5_items(
    source: str, data: bytes, *, most: int, columns: int, depth: int, seconds: int = SECONDS
) -> tuple[Mapping[str, str | float], list[Item]]:
    """Return the attributes and all items of a file that was not necessarily written by this program.

    Parameters
    ----------
    source, data
        The file: its name for messages, and its bytes.
    most
        Numbers of a data set at most; larger ones are not read.
    columns
        Data sets at most; later ones count as large.
    depth
        Of groups in groups.
    seconds
        Processor time at most, before what the file's size adds.

    Raises
    ------
    RecordError
        If h5py cannot read it, or does not come to an end.
    """
    limit = seconds + len(data) // BYTES_A_SECOND
    arguments = [str(each) for each in (most, columns, depth, limit)]
    try:
        child = subprocess.run(
            [sys.executable, "-I", str(_CHILD), *arguments],
            input=data,
            capture_output=True,
            timeout=WAITING * limit,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise RecordError(source, f"{WAITING * limit} s", f"not read by then; {DAMAGED}") from None
    if child.returncode:
        said = child.stderr.decode("utf-8", "replace").strip()[-200:]
        raise RecordError(source, said or f"ended by signal {-child.returncode}", DAMAGED)
    with np.load(io.BytesIO(child.stdout), allow_pickle=False) as written:
        manifest = json.loads(written["manifest"].tobytes())
        items = [
            Item(
                path=entry["path"],
                kind=entry["kind"],
                attributes=entry["attributes"],
                values=written[entry["array"]] if "array" in entry else None,
                size=entry.get("size", 0),
            )
            for entry in manifest["items"]
        ]
    return manifest["attributes"], items


def require_here(source: str, item: Item) -> None:
    """Raise RecordError where an item of an HDF5 file lies in another file, or may."""
    if item.kind == "link":
        remedy = "is a link, perhaps to another file, and is not followed"
        raise RecordError(source, item.path, remedy)
    if item.kind == "elsewhere":
        raise RecordError(source, item.path, "lies in another file, which is not followed")
