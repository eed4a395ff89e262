"""The one entry point for files of recorded motions: the content decides which reader reads."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from shake_env.errors import ParameterError, RecordError
from shake_env.parameters import is_number
from shake_env.records.afad import is_afad, parse_afad
from shake_env.records.cdmg import is_cdmg, parse_cdmg
from shake_env.records.columns import parse_columns
from shake_env.records.cosmos import is_cosmos, parse_cosmos
from shake_env.records.csmip import is_csmip, parse_csmip
from shake_env.records.cwa import is_cwa, parse_cwa
from shake_env.records.embedded import is_embedded, parse_embedded
from shake_env.records.esm import is_esm, parse_esm
from shake_env.records.geonet import is_geonet, parse_geonet
from shake_env.records.header import refuse_seismometers
from shake_env.records.knet import is_knet, parse_knet
from shake_env.records.matlab import is_matlab, parse_matlab
from shake_env.records.peer import is_peer, parse_peer
from shake_env.records.record import Record
from shake_env.records.smc import is_smc, parse_smc
from shake_env.records.spreadsheet import is_spreadsheet, parse_spreadsheet
from shake_env.records.units import Unit, unit_asked
from shake_env.records.waveform import is_waveform, parse_waveform

_SUFFIXES: tuple[str, ...] = (".csv", ".txt", ".dat", ".at2", ".v1", ".v2", ".raw", ".mseed", ".sac")
_SUFFIXES += (".asc", ".smc", ".v0c", ".v1c", ".v2c", ".v1a", ".v2a", ".mat", ".xlsx")
_TABULAR = ("MATLAB", "workbook")  # readers that take `table`


class Parser(Protocol):
    """Read a whole file of one format: one record a channel, or RecordError."""

    def __call__(
        self, name: str, data: bytes, *, units: Unit | None = None, sampling_interval: float | None = None
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
    path: str | Path,
    *,
    units: str | None = None,
    sampling_interval: float | None = None,
    table: str | None = None,
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
        The file.
    units
        Unit of a file that states none: ``"g"``, ``"m/s^2"``, ``"cm/s^2"``, ``"gal"`` or ``"mm/s^2"``;
        for counts, with their sensitivity: ``"4.2e-7 m/s^2"``. A file's own unit must agree.
    sampling_interval
        Step [s] of a file that states none; a file's own must agree.
    table
        Variable of a ``.mat`` file or sheet of a workbook, where it holds several.
    allow_seismometers
        Whether channels of seismometers (codes such as HHE, BHN, EHZ) are read; their samples must then
        be accelerations all the same.

    Returns
    -------
    One record a channel, in m/s^2, with the file's header as attribution.

    Raises
    ------
    RecordError
        If the file cannot be read or does not fit itself. The message names file, line and value.
    ParameterError
        If `units` or `sampling_interval` is none, or `table` is given for a file that has none.
    """
    try:
        path = Path(path)
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        raise RecordError(
            str(path), str(getattr(error, "strerror", None) or error), "must be a file that can be read"
        ) from None
    records = parse_motion(
        path.name,
        data,
        units=units,
        sampling_interval=sampling_interval,
        table=table,
        allow_seismometers=allow_seismometers,
    )
    if path.suffix.lower() not in _SUFFIXES:  # as K-NET's, which name the component
        return records
    # Messages name the whole file; records go by its stem.
    return tuple(replace(r, name=path.stem + r.name.removeprefix(path.name)) for r in records)


def parse_motion(
    name: str,
    data: bytes,
    *,
    units: str | None = None,
    sampling_interval: float | None = None,
    table: str | None = None,
    allow_seismometers: bool = False,
) -> tuple[Record, ...]:
    """Read a file that is already in memory; see :func:`read_motion`.

    Parameters
    ----------
    name
        What its records and messages call it.
    data
        The whole file.
    units, sampling_interval, table, allow_seismometers
        As for :func:`read_motion`.
    """
    unit = unit_asked(units)
    if sampling_interval is not None and not (
        is_number(sampling_interval) and math.isfinite(sampling_interval) and sampling_interval > 0.0
    ):
        raise ParameterError("sampling_interval", sampling_interval, "must be a number above 0 s")
    if not data.strip():
        raise RecordError(name, f"{len(data)} bytes", "the file is empty")
    columns = Reader("columns", lambda _: True, parse_columns)
    reader = next((reader for reader in READERS if reader.matches(data)), columns)
    if table is not None and reader.name not in _TABULAR:
        raise ParameterError("table", table, f"{name} is read as {reader.name}, which has no tables")
    extra: dict[str, Any] = {} if table is None else {"table": table}
    with np.errstate(over="ignore", invalid="ignore"):  # a Record refuses what is not finite
        records = reader.parse(name, data, units=unit, sampling_interval=sampling_interval, **extra)
    if not allow_seismometers:
        refuse_seismometers(records)
    return records
