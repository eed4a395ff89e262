"""The embedded record format: a commented header, then one acceleration per line. Read and write."""

from __future__ import annotations

import re
from os import PathLike
from pathlib import Path

import numpy as np

from shake_env.errors import RecordError
from shake_env.files import write_text
from shake_env.model.parameters import GRAVITY, FloatArray
from shake_env.records.record import Record
from shake_env.records.text.source import SourceText, parse_number
from shake_env.records.units import Unit, settle_interval, unit_named

_NEEDED = (
    "event",
    "station",
    "component",
    "network",
    "licence",
    "sampling_interval_s",
    "points",
    "units",
)
_TITLE = "acceleration"
_INTERVAL = re.compile(rb"^#[ \t]*+sampling_interval_s[ \t]*+:", re.MULTILINE)
_COLUMN = re.compile(rb"^acceleration[ \t]*+\r?$", re.MULTILINE)


def is_embedded(data: bytes) -> bool:
    """Return whether a file's beginning is this format's."""
    beginning = data[:16_384]
    interval = _INTERVAL.search(beginning) if data.startswith(b"#") else None
    return interval is not None and _COLUMN.search(beginning, interval.end()) is not None


def parse_record(name: str, text: str | bytes) -> Record:
    """Read a record in g, as those of the package are, and check its header against its data.

    Parameters
    ----------
    name
        Name of the record, and of the file in messages.
    text
        The whole file.

    Raises
    ------
    RecordError
        If a header line is missing or not a number, the unit is not g, a sample is not a finite
        number, or the count differs from the header's. The message names line and value.
    """
    data = text.encode("utf-8", "replace") if isinstance(text, str) else text
    return parse_embedded(name, data, known_units=("g",))[0]


def parse_embedded(
    name: str,
    data: bytes,
    *,
    units: Unit | None = None,
    sampling_interval: float | None = None,
    known_units: tuple[str, ...] = ("g", "m/s^2"),
) -> tuple[Record, ...]:
    """Read a record in any of `known_units`; those a caller gives must be the file's own.

    Raises
    ------
    RecordError
        As :func:`parse_record` does.
    """
    source = SourceText(name, data)
    header, title = _header(source)
    if len(source) > title and source.line(title).strip() != _TITLE:
        raise source.error(title, f"expected the column '{_TITLE}'")
    values = source.numbers(title + 1, len(source), per_line=1)
    missing = [key for key in _NEEDED if key not in header]
    if missing:
        raise RecordError(f"{name}, header", missing, "these lines are missing")
    unit = unit_named(header["units"])
    if unit is None or unit.name not in known_units:
        raise RecordError(f"{name}, units", header["units"], f"must be {' or '.join(known_units)}")
    if units is not None and units != unit:
        raise RecordError(f"{name}, units", header["units"], f"differs from the given {units}")
    stated, points = _number(name, header, "sampling_interval_s"), _number(name, header, "points")
    step = settle_interval(f"{name}, sampling_interval_s", stated, sampling_interval)
    if points != len(values) or points < 2:
        raise RecordError(
            f"{name}, points", header["points"], f"the file holds {len(values)} samples (2 at least)"
        )
    with np.errstate(over="ignore"):
        acceleration = unit.to_si(values, out=values)
    if not np.isfinite(acceleration).all():
        raise source.error(
            title + 1 + int(np.argmin(np.isfinite(acceleration))), "is not a finite acceleration"
        )
    return (Record(name, acceleration, step, tuple(header.items())),)


def _header(source: SourceText) -> tuple[dict[str, str], int]:
    header: dict[str, str] = {}
    index = 0
    while source.line(index).startswith("#"):
        line = source.line(index)
        key, colon, entry = line[1:].partition(":")
        if not colon:
            raise source.error(index, "header lines read '# key: value'", line)
        if key.strip() in header:
            raise source.error(index, "says again what a line above says", line)
        header[key.strip()] = entry.strip()
        index += 1
    return header, index


def _number(name: str, header: dict[str, str], key: str) -> float:
    value = parse_number(header[key])
    if value is None:
        raise RecordError(f"{name}, {key}", header[key], "must be a finite number")
    return value


def write_record(record: Record, path: str | PathLike[str]) -> Path:
    """Write a record in the embedded format; reading it back gives the same bits.

    The unit is g where every sample is some number of g, rounded, and m/s^2 where it is not. Header
    lines that the format needs and the record lacks say "not stated".

    Parameters
    ----------
    record
        What to write.
    path
        File, overwritten if it exists.

    Returns
    -------
    The path.

    Raises
    ------
    RecordError
        If a line of the attribution would not read back as it is.
    FileError
        If the file cannot be written.
    """
    path = Path(path)
    values, unit = _in_g(record.acceleration)
    header = dict(record.attribution)
    if parse_number(header.get("sampling_interval_s", "")) != record.sampling_interval:
        header["sampling_interval_s"] = repr(float(record.sampling_interval))
    header["points"] = str(len(values))
    header["units"] = unit
    for key in _NEEDED:
        header.setdefault(key, "not stated")
    for key, entry in header.items():
        if (
            key != key.strip()
            or entry != entry.strip()
            or ":" in key
            or not f"{key}{entry}".isprintable()
        ):
            raise RecordError(
                f"{record.name}, attribution", (key, entry),
                "must be printable on one line, without blanks at its ends or a colon in its key",
            )  # fmt: skip
    lines = [f"# {key}: {entry}" for key, entry in header.items()]
    text = "\n".join([*lines, _TITLE, *map(repr, values.tolist())]) + "\n"
    write_text(path, text)
    return path


def _in_g(acceleration: FloatArray) -> tuple[FloatArray, str]:
    """Return numbers that read back as `acceleration` bit for bit, and their unit."""
    values = acceleration / GRAVITY
    for _ in range(2):
        back = values * GRAVITY
        below, above = back < acceleration, back > acceleration
        if not (below.any() or above.any()):
            return values, "g"
        values = np.where(below, np.nextafter(values, np.inf), values)
        values = np.where(above, np.nextafter(values, -np.inf), values)
    return acceleration, "m/s^2"
