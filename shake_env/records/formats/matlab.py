"""MATLAB's ``.mat``: variables as columns of a table. Version 5, and 7.3 through h5py.

Vectors of one length become columns titled by their names, fields of structures by ``name.field``. A
variable called ``t`` or ``time`` is the time; ``dt`` or ``fs`` the step, ``units`` the unit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from shake_env.errors import RecordError
from shake_env.model.parameters import FloatArray
from shake_env.records.formats.hdf5 import has_h5py, hdf5_items, require_here
from shake_env.records.formats.mat5 import Mat5
from shake_env.records.record import Record
from shake_env.records.text.header import LARGEST_TABLE, labelled, naming
from shake_env.records.text.table import Table
from shake_env.records.text.times import is_even
from shake_env.records.text.titles import Title, column_title
from shake_env.records.units import Unit

_HDF5 = b"\x89HDF\r\n\x1a\n"
_TIMES = ("t", "time", "times", "time_s", "t_s")
_STEPS = ("dt", "step", "time_step", "timestep", "sampling_interval", "sampling_interval_s")
_RATES = ("fs", "rate", "sampling_rate", "sample_rate", "sampling_frequency")
_UNITS = ("unit", "units")
_DIRECTIONS = ("n", "s", "e", "w", "h", "N", "S", "E", "W", "H")
_DEPTH = 4  # of structures in structures
_VARIABLES = 4096  # of a file at most
_CHANNELS = 64  # columns of one array at most

Variables = dict[str, Any]


def is_matlab(data: bytes) -> bool:
    """Return whether a file is MATLAB's, version 5 or later."""
    return data.startswith((b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file", _HDF5))


def parse_matlab(
    name: str,
    data: bytes,
    *,
    units: Unit | None = None,
    sampling_interval: float | None = None,
    column: str | int | None = None,
    table: str | None = None,
) -> tuple[Record, ...]:
    """Read a ``.mat`` file: one record a column of acceleration.

    Parameters
    ----------
    name, data, units, sampling_interval, column
        As for :func:`shake_env.records.text.columns.parse_columns`; a column's title is its variable's
        name.
    table
        Variable, field (``eq.acc``) or structure to read; None where its vectors have one length.

    Raises
    ------
    RecordError
        If the file cannot be read, the choice is not one, or what is chosen is no acceleration.
    """
    hdf5 = not data.startswith(b"MATLAB 5.0")
    variables = matlab_variables(name, data)
    arrays = {key: array for key, value in variables.items() if (array := _array(value)) is not None}
    chosen = _chosen(name, arrays, table)
    times = _times(arrays, chosen)
    unit, step = _unit_and_step(variables, chosen[0].rpartition(".")[0])
    columns, titles = _columns({key: arrays[key] for key in (*times, *chosen)})
    content = Table(
        name=name,
        columns=columns,
        titles=titles,
        titled=any(title.kind for title in titles),
        row_place=lambda row: f"{name}, {', '.join(chosen)}, sample {row + 1}",
        title_place=f"{name}, {', '.join(chosen)}",
        unit=unit and (f"{name}, {unit[0]}", unit[1]),
        step=step,
    )
    records = content.records(units, sampling_interval, column)
    label = f"MATLAB {'7.3' if hdf5 else '5'}, {', '.join(chosen)}"
    return naming(labelled(records, label), sorted(set(arrays) - set(chosen) - set(times)))


def matlab_variables(name: str, data: bytes) -> Variables:
    """Return every variable of a ``.mat`` file, and every field of a structure by its whole name.

    Values are arrays of numbers, texts, or None for other classes.

    Raises
    ------
    RecordError
        If the file is damaged, holds more than `LARGEST_TABLE` numbers, or is 7.3 and h5py is missing.
    """
    hdf5 = not data.startswith(b"MATLAB 5.0")
    return dict(_flat(_hdf5(name, data) if hdf5 else Mat5(name, data, LARGEST_TABLE).variables))


def _hdf5(name: str, data: bytes) -> Variables:
    """Return the variables, fields as ``name.field``: texts, transposed arrays, else None."""
    if not has_h5py():
        raise RecordError(
            name, "MATLAB 7.3, which is HDF5", "save it with save(..., '-v7'), or: pip install h5py"
        )
    _, items = hdf5_items(name, data, most=LARGEST_TABLE, columns=_VARIABLES, depth=_DEPTH)
    variables: Variables = {}
    for item in items:
        require_here(name, item)
        if item.kind == "large":
            _check_size(name, max(item.size, LARGEST_TABLE + 1))
        if item.kind == "group":
            continue
        value: Any = item.values
        if value is not None and item.attributes.get("MATLAB_class") == "char":
            value = "".join(chr(int(code)) for code in value.ravel()[:200])
        variables[item.path.replace("/", ".")] = value if value is None else _squeezed(value)
    return variables


def _squeezed(value: Any) -> Any:
    return value if isinstance(value, str) else np.squeeze(value.T)


def _check_size(name: str, elements: int) -> None:
    if elements > LARGEST_TABLE:
        raise RecordError(name, f"{elements} elements", f"at most {LARGEST_TABLE} are read")


def _flat(variables: Variables, prefix: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Yield every variable and every field of a structure by its whole name."""
    for key, value in variables.items():
        if isinstance(value, dict) and depth < _DEPTH:
            yield from _flat(value, f"{prefix}{key}.", depth + 1)
        else:
            yield prefix + key, value


def _array(value: Any) -> FloatArray | None:
    """Return numbers as (samples, columns), or None of anything else."""
    if (
        not isinstance(value, np.ndarray)
        or value.dtype.kind not in "iuf"
        or value.ndim not in (1, 2)
        or not value.size
    ):
        return None
    table = value.reshape(len(value), -1).astype(np.float64)
    table = table.T if table.shape[0] < table.shape[1] else table
    return table if len(table) >= 2 and table.shape[1] <= _CHANNELS else None


def _chosen(name: str, arrays: dict[str, FloatArray], table: str | None) -> list[str]:
    """Return the names of the arrays to read: the asked ones, or all where they have one length."""
    known = ", ".join(f"{key} {array.shape}" for key, array in arrays.items())
    if not arrays:
        raise RecordError(name, "0 vectors", "the file must hold a vector of acceleration")
    if table is not None:
        chosen = [key for key in arrays if key == table or key.startswith(f"{table}.")]
        if not chosen:
            raise RecordError(name, table, f"is no variable of numbers here; there are: {known}")
    else:
        chosen = list(arrays)
    chosen = [key for key in chosen if _short(key) not in _TIMES] or chosen
    if len({len(arrays[key]) for key in chosen}) > 1:
        raise RecordError(
            name, known, "vectors of several lengths: choose one with table='NAME' (--sheet NAME)"
        )
    return chosen


def _times(arrays: dict[str, FloatArray], chosen: list[str]) -> list[str]:
    """Return the vector that holds the chosen ones' time, of their own structure before another."""
    points, structure = len(arrays[chosen[0]]), chosen[0].rpartition(".")[0]
    times = [
        key
        for key, array in arrays.items()
        if _short(key) in _TIMES and array.shape == (points, 1) and key not in chosen
        and key.rpartition(".")[0] in (structure, "")
    ]  # fmt: skip
    return sorted(times, key=lambda key: key.rpartition(".")[0] != structure)[:1]


def _unit_and_step(variables: Variables, structure: str) -> tuple[tuple[str, str] | None, float | None]:
    """Return the name and text of a unit, and a step [s], of a structure or beside it."""
    unit, step = None, None
    for key, value in variables.items():
        if key.rpartition(".")[0] not in (structure, ""):
            continue
        if isinstance(value, str) and _short(key) in _UNITS:
            unit = key, " ".join(value.split())
        elif isinstance(value, np.ndarray) and value.size == 1 and value.dtype.kind in "iuf":
            number = float(value.ravel()[0])
            if _short(key) in _STEPS:
                step = number
            elif _short(key) in _RATES and number > 0.0:
                step = 1.0 / number
    return unit, step


def _columns(arrays: dict[str, FloatArray]) -> tuple[list[FloatArray], list[Title]]:
    """Return the columns of all arrays, each (samples,), and their titles."""
    columns: list[FloatArray] = []
    titles: list[Title] = []
    for key, array in arrays.items():
        several = array.shape[1] > 1
        for index, column in enumerate(array.T):
            columns.append(np.array(column))
            if several and index == 0 and is_even(column):  # [time, acceleration] under one name
                titles.append(column_title("time"))
            else:
                title = column_title(_short(key))
                if title.unit in _DIRECTIONS and title.kind != "acceleration":  # acc_n: no newtons
                    title = column_title(title.text)
                text = f"{key}({index + 1})" if several else key
                titles.append(replace(title, text=text))
    return columns, titles


def _short(key: str) -> str:
    return key.rpartition(".")[2].lower()
