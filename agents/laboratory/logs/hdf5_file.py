"""Logs as HDF5: a group ``channels`` of datasets with units and meanings; attributes at the root.

The HDF5 library can loop for ever on a damaged file. A log that this program wrote therefore begins with
a user block that holds the digest of what follows; any other file is read by a process of its own with a
limit on its time (`shake_env.records.formats.hdf5`). Of a foreign file every one-dimensional dataset of
numbers is a column, titled by its path. Links to other files are not followed.
"""

from __future__ import annotations

import hashlib
import importlib
import io
from typing import Any

import numpy as np

from agents.laboratory.logs.raw import (
    Attributes,
    RawTable,
    attributes_of,
    column_unit,
    text_value,
    typed,
)
from agents.laboratory.logs.test_log import MOST, TestLog, meaning_of
from shake_env.errors import LogError, RecordError, install_hint
from shake_env.model.parameters import FloatArray
from shake_env.records.formats.hdf5 import Item, hdf5_items, require_here

_DEPTH, _COLUMNS = 6, 512
MAGIC = b"shake_env log, HDF5 from byte 512 on, SHA-256 "
_BLOCK = 512  # bytes of the user block


def import_library(name: str) -> Any:
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
    h5py = import_library("h5py")
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
    h5py = import_library("h5py")
    if content.startswith(MAGIC):
        stated = content[len(MAGIC) : _BLOCK].strip(b"\0\n")
        if stated != hashlib.sha256(content[_BLOCK:]).hexdigest().encode():
            remedy = "is not that of the rest of the file, which was damaged: take another copy"
            raise LogError(f"{source}, SHA-256", stated.decode("latin-1")[:64], remedy)
        attributes, items = _trusted(h5py, content, source)
    else:
        try:
            attributes, items = hdf5_items(source, content, most=MOST, columns=_COLUMNS, depth=_DEPTH)
        except RecordError as error:
            raise LogError(error.field, error.value, error.remedy) from None
    columns: dict[str, FloatArray] = {}
    units: dict[str, str] = {}
    for item in items:
        try:
            require_here(source, item)
        except RecordError as error:
            raise LogError(error.field, error.value, error.remedy) from None
        if item.kind == "large":
            remedy = f"is too large: at most {MOST} numbers, {_COLUMNS} columns"
            raise LogError(source, item.path, remedy)
        values = item.values
        if values is None or values.dtype.kind not in "iuf" or values.ndim not in (1, 2):
            continue
        if values.ndim == 1 or 1 in values.shape:
            columns[item.path] = values.ravel().astype(np.float64)
        unit = item.attributes.get("unit", item.attributes.get("units"))
        if unit is not None:
            units[item.path] = str(unit)
    prefix = "channels/"
    if all(title.startswith(prefix) for title in columns):
        columns = {title.removeprefix(prefix): values for title, values in columns.items()}
        units = {title.removeprefix(prefix): unit for title, unit in units.items()}
    return RawTable(f"{source} (HDF5)", columns, units, attributes)


def _trusted(h5py: Any, content: bytes, source: str) -> tuple[Attributes, list[Item]]:
    """Return attributes and columns of a file that is as this program wrote it."""
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            attributes = {str(key): text_value(value) for key, value in file.attrs.items()}
            items = [
                Item(
                    path=f"channels/{name}",
                    kind="array",
                    attributes={str(key): text_value(value) for key, value in data.attrs.items()},
                    values=data[()],
                )
                for name, data in file["channels"].items()
            ]
    except Exception as error:  # what h5py raises is not written down
        raise typed(error, source, "h5py cannot read it") from None
    return attributes, items
