"""AFAD's ASCII (Turkiye's strong-motion network, to 2019): keyed lines, three titles, three columns."""

from __future__ import annotations

from shake_env.records.record import Record
from shake_env.records.text.header import (
    LONGEST_LINE,
    check_peak_about_any_mean,
    count_in,
    keyed_lines,
    require_line,
    value_in,
)
from shake_env.records.text.source import SourceText, parse_number
from shake_env.records.units import Unit, settle_interval, settle_unit

_HEADER_LINES = 40  # at most
_TITLE = b"STRONG GROUND MOTION RECORDS OF TURK"
_COMPONENTS = ("N-S", "E-W", "U-D")


def is_afad(data: bytes) -> bool:
    """Return whether a file's beginning is this format's."""
    return _TITLE in data[:200].split(b"\n")[0]


def parse_afad(
    name: str, data: bytes, *, units: Unit | None = None, sampling_interval: float | None = None
) -> tuple[Record, ...]:
    """Read an AFAD file: one record for each of its three columns.

    Raises
    ------
    RecordError
        If the header lacks count, step, unit or titles, or count or peaks are not the data's.
    """
    source = SourceText(name, data)
    titles = 0
    while sorted(source.line(titles)[:LONGEST_LINE].split()) != sorted(_COMPONENTS):
        titles += 1
        if titles >= min(_HEADER_LINES, len(source)):
            raise source.error(0, "the header has no line of titles 'N-S  E-W  U-D'")
    components = source.line(titles).split()
    header = keyed_lines(source, 1, titles)
    at, text = require_line(source, header, "NUMBER OF DATA", titles)
    points = count_in(source, at, text)
    place, text = require_line(source, header, "SAMPLING INTERVAL (sec)", titles)
    step = settle_interval(
        source.place(place), value_in(source, place, text, "a number of seconds"), sampling_interval
    )
    peaks = next((key for key in header if key.startswith("RAW PGA VALUES")), None)
    peaks_at, peaks_text = (titles, "") if peaks is None else header[peaks]
    stated = None if peaks is None else peaks.partition("(")[2].partition(")")[0]
    unit = settle_unit(source.place(peaks_at), stated or None, units)
    values = source.numbers(titles + 1, len(source), per_line=3)
    if len(values) != 3 * points:
        raise source.error(at, f"the file holds {len(values) // 3} rows", f"NUMBER OF DATA {points}")
    records = []
    for component, column in zip(components, values.reshape(-1, 3).T, strict=True):
        acceleration = unit.to_si(column)
        peak = peaks_text.partition(f"({component})")[2].split()
        if peak and parse_number(peak[0]) is not None:
            check_peak_about_any_mean(source.place(peaks_at), peak[0], unit, acceleration)
        attribution = (
            ("format", "AFAD ASCII"),
            ("component", component),
            *((key, text) for key, (_, text) in header.items() if text),
            ("units in the file", str(unit)),
        )
        records.append(Record(f"{name} {component}", acceleration, step, attribution))
    return tuple(records)
