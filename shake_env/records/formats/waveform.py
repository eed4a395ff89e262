"""MiniSEED, SAC and other binary files, through ObsPy where it is installed."""

from __future__ import annotations

import importlib
import io
import warnings
from typing import Any

import numpy as np

from shake_env.errors import RecordError, install_hint
from shake_env.records.record import Record
from shake_env.records.text.header import sensor_entries
from shake_env.records.units import Unit, settle_interval, settle_unit


def is_waveform(data: bytes) -> bool:
    """Return whether a file is binary, or text that only ObsPy knows."""
    return b"\0" in data[:65_536] or data.startswith((b"WID1", b"WID2"))


def parse_waveform(
    name: str, data: bytes, *, units: Unit | None = None, sampling_interval: float | None = None
) -> tuple[Record, ...]:
    """Read a file that ObsPy knows: one record a trace.

    Such files hold counts and do not say what a count is, so that `units` must be given: ``"m/s^2"`` for
    samples that are in it, ``"4.2e-7 m/s^2"`` for counts of that sensitivity.

    Raises
    ------
    RecordError
        If ObsPy is not installed or cannot read the file, units are not given, or a trace has gaps.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what ObsPy itself imports
            obspy = importlib.import_module("obspy")
    except ImportError:
        raise RecordError(
            name, "binary file", f"reading it needs ObsPy; {install_hint('obspy')}"
        ) from None
    unit = settle_unit(name, None, units)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # How its MiniSEED reader reports records that it leaves out.
            warnings.simplefilter("error", UserWarning)
            stream = obspy.read(io.BytesIO(data))
    except Exception as error:  # what its many readers raise on a damaged file is not written down
        raise RecordError(
            name, f"{type(error).__name__}: {error}"[:200], "ObsPy cannot read it"
        ) from None
    _check_whole(name, stream, len(data))
    names = [str(trace.id) for trace in stream]
    if unreadable := [trace_name for trace_name in names if not trace_name.isprintable()]:
        raise RecordError(name, unreadable[0], "is no name of a channel: the file is damaged")
    if not names:
        raise RecordError(name, "0 traces", "the file must hold one at least")
    for trace_name in names:
        if names.count(trace_name) > 1:
            raise RecordError(name, trace_name, "the channel has gaps or overlaps: merge it first")
    return tuple(_record(name, trace, unit, sampling_interval) for trace in stream)


def _check_whole(name: str, stream: Any, size: int) -> None:
    """Refuse a MiniSEED file of which some bytes belong to no record."""
    parts = [trace.stats.mseed for trace in stream if "mseed" in trace.stats]
    if parts and len(parts) == len(stream):
        used = sum(int(part.record_length) * int(part.number_of_records) for part in parts)
        if used != size:
            raise RecordError(name, f"{size} bytes", f"its whole records make up {used}: it is cut off")


def _record(name: str, trace: Any, unit: Unit, sampling_interval: float | None) -> Record:
    stats = trace.stats
    place = f"{name}, {trace.id}"
    samples = np.asarray(trace.data)
    if np.ma.isMaskedArray(trace.data) or samples.dtype.kind not in "iuf":
        raise RecordError(place, str(samples.dtype), "must be numbers without gaps")
    if len(samples) != int(stats.npts):
        raise RecordError(place, int(stats.npts), f"the trace holds {len(samples)} samples")
    interval = settle_interval(place, float(stats.delta), sampling_interval)
    attribution = (
        ("format", str(stats.get("_format", "unknown"))),
        ("network", str(stats.network) or "not stated"),
        ("station", str(stats.station) or "not stated"),
        ("component", str(stats.channel) or "not stated"),
        ("start time", str(stats.starttime)),
        *sensor_entries(str(stats.channel)),
        ("units in the file", f"counts of {unit}" if unit.factor != 1.0 else str(unit)),
    )
    return Record(f"{name} {trace.id}", unit.to_si(samples.astype(np.float64)), interval, attribution)
