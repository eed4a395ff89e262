"""The one entry point for files of recorded motions: the content decides which reader reads."""

from __future__ import annotations

import math
import os
import stat
from collections.abc import Callable
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from shake_env.errors import ParameterError, RecordError
from shake_env.model.parameters import GRAVITY, is_number
from shake_env.records.formats.afad import is_afad, parse_afad
from shake_env.records.formats.cdmg import is_cdmg, parse_cdmg
from shake_env.records.formats.cosmos import is_cosmos, parse_cosmos
from shake_env.records.formats.csmip import is_csmip, parse_csmip
from shake_env.records.formats.cwa import is_cwa, parse_cwa
from shake_env.records.formats.embedded import is_embedded, parse_embedded
from shake_env.records.formats.esm import is_esm, parse_esm
from shake_env.records.formats.geonet import is_geonet, parse_geonet
from shake_env.records.formats.knet import is_knet, parse_knet
from shake_env.records.formats.matlab import is_matlab, parse_matlab
from shake_env.records.formats.peer import is_peer, parse_peer
from shake_env.records.formats.smc import is_smc, parse_smc
from shake_env.records.formats.spreadsheet import is_spreadsheet, parse_spreadsheet
from shake_env.records.formats.waveform import is_waveform, parse_waveform
from shake_env.records.record import Record
from shake_env.records.text.columns import parse_columns
from shake_env.records.text.encoding import plain_text
from shake_env.records.text.header import refuse_seismometers
from shake_env.records.units import Unit, unit_asked

LARGEST_FILE = 256 * 2**20  # bytes
LARGEST_ACCELERATION = 100.0 * GRAVITY  # [m/s^2] beyond it the unit must be wrong
LARGEST_UNCONFIRMED = 3.0 * GRAVITY  # [m/s^2] beyond it a unit that the caller gives is confirmed
_SUFFIXES: tuple[str, ...] = (".csv", ".txt", ".dat", ".at2", ".v1", ".v2", ".raw", ".mseed", ".sac")
_SUFFIXES += (".asc", ".smc", ".v0c", ".v1c", ".v2c", ".v1a", ".v2a", ".mat", ".xlsx")
_TABULAR = ("MATLAB", "workbook")  # readers that take `table`


class Parser(Protocol):
    """Read a whole file of one format: one record a channel, or RecordError."""

    def __call__(  # noqa: D102
        self, name: str, data: bytes, *, units: Unit | None, sampling_interval: float | None
    ) -> tuple[Record, ...]: ...


class Reader(NamedTuple):
    """One format: its name, whether a file's content is of it, and how it is read."""

    name: str
    matches: Callable[[bytes], bool]
    parse: Parser


# In the order in which they are asked. What none of them knows is read as columns of text.
READERS: tuple[Reader, ...] = (
    Reader("K-NET", is_knet, parse_knet),
    Reader("ESM", is_esm, parse_esm),
    Reader("COSMOS", is_cosmos, parse_cosmos),
    Reader("SMC", is_smc, parse_smc),
    Reader("AFAD", is_afad, parse_afad),
    Reader("GeoNet", is_geonet, parse_geonet),
    Reader("CWA", is_cwa, parse_cwa),
    Reader("CDMG", is_cdmg, parse_cdmg),
    Reader("CSMIP", is_csmip, parse_csmip),
    Reader("PEER", is_peer, parse_peer),
    Reader("MATLAB", is_matlab, parse_matlab),
    Reader("workbook", is_spreadsheet, parse_spreadsheet),
    Reader("ObsPy", is_waveform, parse_waveform),
    Reader("embedded format", is_embedded, parse_embedded),
)


def read_motion(
    path: str | PathLike[str],
    *,
    units: str | None = None,
    sampling_interval: float | None = None,
    column: str | int | None = None,
    table: str | None = None,
    allow_large: bool = False,
    allow_seismometers: bool = False,
) -> tuple[Record, ...]:
    """Read a file of recorded ground acceleration.

    Known by content: PEER ``.AT2``, CSMIP (CESMD) volumes 1 and 2, K-NET and KiK-net ASCII, the embedded
    format, CSV and text in columns; MiniSEED, SAC and other binary files through ObsPy. What a header
    says of count, step, unit, length, peak and channels is checked against the data.

    Also ESM and ITACA ASCII, COSMOS, SMC, AFAD, GeoNet, CWA, CDMG and Caltech volumes 1 and 2,
    ``.mat`` and ``.xlsx``.

    Parameters
    ----------
    path
        The file: a regular file of at most `LARGEST_FILE` bytes.
    units
        Unit of a file that states none: ``"g"``, ``"m/s^2"``, ``"cm/s^2"``, ``"gal"``, ``"mm/s^2"``,
        ``"in/s^2"``, ``"ft/s^2"``, ``"%g"`` or ``"mg"``; for counts, with their sensitivity:
        ``"4.2e-7 m/s^2"``. A file's own unit must agree.
    sampling_interval
        Step [s] of a file that states none; a file's own must agree.
    column
        The one column to take: its title, or its number in the file, counted from 1. In a format of
        channels, the channel's name or its place in the file. None takes every acceleration.
    table
        Variable of a ``.mat`` file or sheet of a workbook, where it holds several.
    allow_large
        Whether a peak above 3 g is accepted where `units` gave the unit.
    allow_seismometers
        Whether channels of seismometers (codes such as HHE, BHN, EHZ) are read; their samples must then
        be accelerations all the same.

    Returns
    -------
    One record a channel, in m/s^2, with the file's header as attribution.

    Raises
    ------
    RecordError
        If the file cannot be read, does not fit itself, contradicts an option, holds accelerations
        above 100 g, or above 3 g by the given unit without `allow_large`. The message names file, line
        and value.
    ParameterError
        If `path`, `units`, `sampling_interval` or `column` is none, or `table` is given for a file
        that has none.
    """
    try:
        path = Path(path)
    except TypeError:
        raise ParameterError("path", path, "must be a str or os.PathLike[str]") from None
    records = parse_motion(
        path.name,
        file_content(path),
        units=units,
        sampling_interval=sampling_interval,
        column=column,
        table=table,
        allow_large=allow_large,
        allow_seismometers=allow_seismometers,
    )
    if path.suffix.lower() not in _SUFFIXES:  # as K-NET's, which name the component
        return records
    # Messages name the whole file; records go by its stem.
    return tuple(replace(r, name=path.stem + r.name.removeprefix(path.name)) for r in records)


def file_content(path: str | os.PathLike[str]) -> bytes:
    """Return the bytes of a regular file of at most `LARGEST_FILE`.

    Raises
    ------
    RecordError
        If it is larger, cannot be read, or is a folder, a pipe or a device, which is not opened.
    """
    path = Path(path)
    try:
        _check_door(path, os.stat(path))
        flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        with open(os.open(path, flags), "rb") as stream:
            status = os.fstat(stream.fileno())  # another file may stand there by now
            _check_door(path, status)
            return stream.read(status.st_size)
    except (OSError, ValueError) as error:
        if isinstance(error, RecordError):
            raise
        raise RecordError(
            str(path), str(getattr(error, "strerror", None) or error), "must be a file that can be read"
        ) from None


def _check_door(path: Path, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "no regular file"
        raise RecordError(str(path), kind, "must be a regular file that can be read")
    if status.st_size > LARGEST_FILE:
        raise RecordError(str(path), f"{status.st_size} bytes", f"may have {LARGEST_FILE} at most")


def parse_motion(
    name: str,
    data: bytes,
    *,
    units: str | None = None,
    sampling_interval: float | None = None,
    column: str | int | None = None,
    table: str | None = None,
    allow_large: bool = False,
    allow_seismometers: bool = False,
) -> tuple[Record, ...]:
    """Read a file that is already in memory; see :func:`read_motion`.

    Parameters
    ----------
    name
        What its records and messages call it.
    data
        The whole file.
    units, sampling_interval, column, table, allow_large, allow_seismometers
        As for :func:`read_motion`.
    """
    unit = unit_asked(units)
    if sampling_interval is not None and not (
        is_number(sampling_interval) and math.isfinite(sampling_interval) and sampling_interval > 0.0
    ):
        raise ParameterError("sampling_interval", sampling_interval, "must be a number above 0 s")
    if column is not None and (
        isinstance(column, bool) or not isinstance(column, str | int) or column == "" or column in (0,)
    ):
        raise ParameterError("column", column, "must be a title, or a number from 1 on")
    if len(data) > LARGEST_FILE:
        raise RecordError(name, f"{len(data)} bytes", f"may have {LARGEST_FILE} at most")
    data = plain_text(name, data)
    if not data.strip():
        raise RecordError(name, f"{len(data)} bytes", "the file is empty")

    def parsed(given: Unit | None) -> tuple[Record, ...]:
        more: dict[str, Any]
        for reader in READERS:
            if reader.matches(data):
                if reader.name in _TABULAR:
                    more = {"column": column, "table": table}
                    return reader.parse(
                        name, data, units=given, sampling_interval=sampling_interval, **more
                    )
                _refuse_table(name, reader.name, table)
                records = reader.parse(name, data, units=given, sampling_interval=sampling_interval)
                return records if column is None else (_picked(name, records, column),)
        _refuse_table(name, "columns", table)
        formats = [*(reader.name for reader in READERS), "columns of text"]
        more = {"column": column, "formats": formats}
        return parse_columns(name, data, units=given, sampling_interval=sampling_interval, **more)

    with np.errstate(over="ignore", invalid="ignore"):  # a Record refuses what is not finite
        records = parsed(unit)
        peaks = [max(-float(np.min(r.acceleration)), float(np.max(r.acceleration))) for r in records]
        for record, peak in zip(records, peaks, strict=True):
            if peak > LARGEST_ACCELERATION:
                remedy = f"{peak / GRAVITY:.4g} g is no acceleration of a table: the unit is wrong"
                raise RecordError(f"{record.name}, peak", f"{peak:.6g} m/s^2", remedy)
        if unit is not None and not allow_large and max(peaks) > LARGEST_UNCONFIRMED:
            try:
                parsed(None)
            except RecordError:  # the file states no unit: nothing but the option says what it is
                worst = max(peaks)
                raise RecordError(
                    f"{records[peaks.index(worst)].name}, peak", f"{worst:.6g} m/s^2",
                    f"with units {unit} the peak is {worst / GRAVITY:.3g} g: give another unit, or "
                    "allow_large=True (--allow-large) if it is right",
                ) from None  # fmt: skip
    if not allow_seismometers:
        refuse_seismometers(records)
    return records


def _refuse_table(name: str, form: str, table: str | None) -> None:
    if table is not None:
        raise ParameterError("table", table, f"{name} is read as {form}, which has no tables")


def _picked(name: str, records: tuple[Record, ...], column: str | int) -> Record:
    """Return the channel of a place in the file, counted from 1, or of a name."""
    names = [record.name.removeprefix(name).strip() or record.name for record in records]
    if isinstance(column, str) and not column.isdecimal():
        chosen = [r for r, known in zip(records, names, strict=True) if known.lower() == column.lower()]
    else:
        chosen = list(records[int(column) - 1 : int(column)]) if int(column) > 0 else []
    if len(chosen) != 1:
        known = ", ".join(f"{i + 1} {text!r}" for i, text in enumerate(names))
        raise RecordError(
            f"{name}, column", column, f"must be one of the file's channels: {known}"[:400]
        )
    return chosen[0]
