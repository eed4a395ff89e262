"""ESM and ITACA ASCII (DYNA 1.0 to 1.2): lines ``KEY: text``, then one value a line.

AFAD's newer files are in it too. Format: Luzi et al., Engineering Strong-Motion database, and
`obspy-dyna`; 55 header lines in DYNA 1.1, 64 in DYNA 1.2.
"""

from __future__ import annotations

from shake_env.records.record import Record
from shake_env.records.text.header import (
    LONGEST_LINE,
    check_length,
    check_peak,
    count_in,
    keyed_lines,
    require_line,
    sensor_entries,
    value_in,
)
from shake_env.records.text.source import SourceText, parse_number
from shake_env.records.units import Unit, settle_interval, settle_unit

_HEADER_LINES = 120  # at most


def is_esm(data: bytes) -> bool:
    """Return whether a file's beginning is this format's."""
    return data.startswith(b"EVENT_NAME:") and b"\nNDATA:" in data[:20_000]


def parse_esm(
    name: str, data: bytes, *, units: Unit | None = None, sampling_interval: float | None = None
) -> tuple[Record, ...]:
    """Read an ESM or ITACA file: one record.

    Raises
    ------
    RecordError
        If the header lacks count or step, holds no acceleration, or count, length or peak are not the
        data's.
    """
    source = SourceText(name, data)
    first = 0
    while ":" in source.line(first)[:LONGEST_LINE] and first < _HEADER_LINES:
        first += 1
    header = keyed_lines(source, 0, first)
    at, kind = header.get("DATA_TYPE", (0, "ACCELERATION"))
    if kind.upper() != "ACCELERATION":
        raise source.error(at, "the file holds no acceleration: give the file ACC")
    at, text = require_line(source, header, "NDATA", first)
    points = count_in(source, at, text)
    place, text = require_line(source, header, "SAMPLING_INTERVAL_S", first)
    step = settle_interval(
        source.place(place), value_in(source, place, text, "a number of seconds"), sampling_interval
    )
    place, text = header.get("UNITS", (at, ""))
    unit = settle_unit(source.place(place), text or None, units)
    values = source.numbers(first, len(source), per_line=1)
    if len(values) != points:
        raise source.error(at, f"the file holds {len(values)} values", f"NDATA {points}")
    acceleration = unit.to_si(values)
    length_at, text = header.get("DURATION_S", (0, ""))
    if (length := parse_number(text)) is not None:
        check_length(source, length_at, points, step, length)
    for key, (peak_at, text) in header.items():
        if key.startswith("PGA_") and parse_number(text) is not None:
            stated = settle_unit(source.place(peak_at), key.removeprefix("PGA_"), None)
            check_peak(source.place(peak_at), text, stated, acceleration)
    stream = header.get("STREAM", (0, ""))[1]
    attribution = (
        ("format", "ESM, ITACA ASCII"),
        *((key, text) for key, (_, text) in header.items() if text),
        *sensor_entries(stream),
        ("units in the file", str(unit)),
    )
    return (Record(name, acceleration, step, attribution),)
