"""The one entry point for files of recorded motions: the content decides which reader reads."""

from __future__ import annotations

import math
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from shake_env.errors import ParameterError, RecordError
from shake_env.parameters import is_number
from shake_env.records.columns import parse_columns
from shake_env.records.csmip import csmip_volume, parse_csmip
from shake_env.records.embedded import is_embedded, parse_embedded
from shake_env.records.knet import is_knet, parse_knet
from shake_env.records.peer import is_peer, parse_peer
from shake_env.records.record import Record
from shake_env.records.units import unit_asked
from shake_env.records.waveform import is_waveform, parse_waveform

_SUFFIXES = (".csv", ".txt", ".dat", ".at2", ".v1", ".v2", ".raw", ".mseed", ".sac")


def read_motion(
    path: str | PathLike[str], *, units: str | None = None, sampling_interval: float | None = None
) -> tuple[Record, ...]:
    """Read a file of recorded ground acceleration.

    Known by content: PEER ``.AT2``, CSMIP (CESMD) volumes 1 and 2, K-NET and KiK-net ASCII, the embedded
    format, CSV and text in columns; MiniSEED, SAC and other binary files through ObsPy. What a header
    says of count, step, unit, length, peak and channels is checked against the data.

    Parameters
    ----------
    path
        The file.
    units
        Unit of a file that states none: ``"g"``, ``"m/s^2"``, ``"cm/s^2"``, ``"gal"`` or ``"mm/s^2"``;
        for counts, with their sensitivity: ``"4.2e-7 m/s^2"``. A file's own unit must agree.
    sampling_interval
        Step [s] of a file that states none; a file's own must agree.

    Returns
    -------
    One record a channel, in m/s^2, with the file's header as attribution.

    Raises
    ------
    RecordError
        If the file cannot be read or does not fit itself. The message names file, line and value.
    ParameterError
        If `units` or `sampling_interval` is none.
    """
    try:
        path = Path(path)
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        raise RecordError(
            str(path), str(getattr(error, "strerror", None) or error), "must be a file that can be read"
        ) from None
    records = parse_motion(path.name, data, units=units, sampling_interval=sampling_interval)
    if path.suffix.lower() not in _SUFFIXES:  # as K-NET's, which name the component
        return records
    # Messages name the whole file; records go by its stem.
    return tuple(replace(r, name=path.stem + r.name.removeprefix(path.name)) for r in records)


def parse_motion(
    name: str, data: bytes, *, units: str | None = None, sampling_interval: float | None = None
) -> tuple[Record, ...]:
    """Read a file that is already in memory; see :func:`read_motion`.

    Parameters
    ----------
    name
        What its records and messages call it.
    data
        The whole file.
    units, sampling_interval
        As for :func:`read_motion`.
    """
    unit = unit_asked(units)
    if sampling_interval is not None and not (
        is_number(sampling_interval) and math.isfinite(sampling_interval) and sampling_interval > 0.0
    ):
        raise ParameterError("sampling_interval", sampling_interval, "must be a number above 0 s")
    if not data.strip():
        raise RecordError(name, f"{len(data)} bytes", "the file is empty")
    with np.errstate(over="ignore", invalid="ignore"):  # a Record refuses what is not finite
        if is_knet(data):
            return parse_knet(name, data, units=unit, sampling_interval=sampling_interval)
        if csmip_volume(data) is not None:
            return parse_csmip(name, data, units=unit, sampling_interval=sampling_interval)
        if is_peer(data):
            return parse_peer(name, data, units=unit, sampling_interval=sampling_interval)
        if is_waveform(data):
            return parse_waveform(name, data, units=unit, sampling_interval=sampling_interval)
        if is_embedded(data):
            return (parse_embedded(name, data, units=unit, sampling_interval=sampling_interval),)
        return parse_columns(name, data, units=unit, sampling_interval=sampling_interval)
