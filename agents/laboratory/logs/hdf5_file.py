"""Logs as HDF5: a group ``channels`` of datasets with units and meanings; attributes at the root.

The HDF5 library can loop for ever on a damaged file. A log that this program wrote therefore begins with
a user block that holds the digest of what follows, and nothing is handed to the library that differs.
Of a foreign file every one-dimensional dataset of numbers is a column, titled by its path. Links to
other files are not followed.
"""

from __future__ import annotations

import hashlib
import importlib
import io
from typing import Any

import numpy as np

from agents.laboratory.logs.raw import RawTable, attributes_of, column_unit, text_value, typed
from agents.laboratory.logs.test_log import MOST, TestLog, meaning_of
from shake_env.errors import LogError, install_hint
from shake_env.model.parameters import FloatArray

_DEPTH, _COLUMNS = 6, 512
MAGIC = b"shake_env log, HDF5 from byte 512 on, SHA-256 "
_BLOCK = 512  # bytes of the user block


def library(name: str) -> Any:
    """Return a library of the extra ``laboratory``.

    Raises
    ------
    LogError
        If it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        raise LogError(name, "missing", f"this format needs it; {install_hint('laboratory')}") from None


def hdf5_bytes(log: TestLog) -> bytes:
    """Return the file of a log."""
    h5py = library("h5py")
    held = io.BytesIO()
    with h5py.File(held, "w", track_order=True, userblock_size=_BLOCK) as file:
        file.attrs.update(attributes_of(log))
        group = file.create_group("channels", track_order=True)
        for name, values in log.channels.items():
            data = group.create_dataset(name, data=values, compression="gzip", fletcher32=True)
            data.attrs["unit"] = column_unit(log, name)
            data.attrs["meaning"] = meaning_of(name)
    rest = held.getvalue()[_BLOCK:]
    return (MAGIC + hashlib.sha256(rest).hexdigest().encode() + b"\n").ljust(_BLOCK, b"\0") + rest


def read_hdf5(source: str, content: bytes) -> RawTable:
    """Return the columns of a file.

    Raises
    ------
    LogError
        If it is not as it was written, h5py cannot read it, or it holds too much.
    """
    h5py = library("h5py")
    if content.startswith(MAGIC):
        stated = content[len(MAGIC) : _BLOCK].strip(b"\0\n")
        if stated != hashlib.sha256(content[_BLOCK:]).hexdigest().encode():
            remedy = "is not that of the rest of the file, which was damaged: take another copy"
            raise LogError(f"{source}, SHA-256", stated.decode("latin-1")[:64], remedy)
    columns: dict[str, FloatArray] = {}
    units: dict[str, str] = {}
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            attributes = {str(key): text_value(value) for key, value in file.attrs.items()}
            _gather(h5py, file, "", columns, units, source)
    except Exception as error:  # what h5py raises on a damaged file is not written down
        raise typed(error, source, "h5py cannot read it: the file is damaged") from None
    prefix = "channels/"
    if all(title.startswith(prefix) for title in columns):
        columns = {title.removeprefix(prefix): values for title, values in columns.items()}
        units = {title.removeprefix(prefix): unit for title, unit in units.items()}
    return RawTable(f"{source} (HDF5)", columns, units, attributes)


def _gather(
    h5py: Any,
    group: Any,
    path: str,
    columns: dict[str, FloatArray],
    units: dict[str, str],
    source: str,
) -> None:
    for key in group:
        title = f"{path}{key}"
        if not isinstance(group.get(key, getlink=True), h5py.HardLink):
            raise LogError(source, title, "is a link, perhaps to another file, and is not followed")
        item = group[key]
        if isinstance(item, h5py.Group):
            if path.count("/") < _DEPTH:
                _gather(h5py, item, f"{title}/", columns, units, source)
            continue
        if not isinstance(item, h5py.Dataset) or item.dtype.kind not in "iuf" or item.ndim not in (1, 2):
            continue
        if item.is_virtual or item.external:
            raise LogError(source, title, "lies in another file, which is not followed")
        if item.size is None or item.size > MOST or len(columns) >= _COLUMNS:
            raise LogError(source, title, f"is too large: at most {MOST} numbers, {_COLUMNS} columns")
        values = np.asarray(item[()], dtype=np.float64)
        if values.ndim == 1 or 1 in values.shape:
            columns[title] = values.ravel()
        unit = item.attrs.get("unit", item.attrs.get("units"))
        if unit is not None:
            units[title] = str(text_value(unit))
