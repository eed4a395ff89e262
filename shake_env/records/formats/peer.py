"""PEER's ``.AT2`` files: four lines of header, then accelerations in g.

The fourth line reads ``NPTS=  4000, DT= .01000 SEC`` or ``4000   0.0100   NPTS, DT``, by age; text may
follow, such as the filter's poles.
"""

from __future__ import annotations

import re

from shake_env.errors import RecordError
from shake_env.model.parameters import FloatArray
from shake_env.records.record import Record
from shake_env.records.text.layout import Layout
from shake_env.records.text.source import SourceText, parse_number
from shake_env.records.units import Unit, settle_interval, settle_unit, unit_in_words

_HEADER_LINES = 16  # at most
_FLAGS = re.IGNORECASE | re.ASCII
_COUNTS = (
    # Behind the step: nothing, its unit, or its unit and other text.
    re.compile(
        r"\s*+NPTS\s*+=\s*+(\d++)\s*+(?:,\s*+)?+DT\s*+=\s*+([^\s,A-DF-Z]++)\s*+"
        r"(?:(?:SECONDS|SECS?)\b.*+|,\s*+|)",
        _FLAGS,
    ),
    re.compile(r"\s*+(\d++)\s*+(?:,\s*+)?+([^\s,]++)\s*+(?:,\s*+)?+NPTS\s*+(?:,\s*+)?+DT\b.*+", _FLAGS),
)
_OTHER = re.compile(r"\b(?:VELOCITY|DISPLACEMENT)\b", re.IGNORECASE)


def is_peer(data: bytes) -> bool:
    """Return whether a file's beginning is this format's."""
    lines = data[:4096].split(b"\n")[:_HEADER_LINES]
    return any(b"NPTS" in line.upper() for line in lines if line[:1] not in b"#%")


def parse_peer(
    name: str, data: bytes, *, units: Unit | None = None, sampling_interval: float | None = None
) -> tuple[Record, ...]:
    """Read a PEER file: one record.

    Raises
    ------
    RecordError
        If the header lacks count, step or unit, holds velocities or displacements, or the number of
        values is not its count.
    """
    source = SourceText(name, data)
    row = next((i for i in range(_HEADER_LINES) if _is_counted(source.line(i))), 0)
    matches = [match for pattern in _COUNTS if (match := pattern.fullmatch(source.line(row)))]
    step_text = matches[0][2] if matches else ""
    if not matches or parse_number(step_text) is None:
        raise source.error(row, "expected 'NPTS=  4000, DT=  .0100 SEC' or '4000  0.0100  NPTS, DT'")
    points = int(matches[0][1][:18])  # a longer count is absurd, and is refused as such
    step = settle_interval(source.place(row), parse_number(step_text), sampling_interval)
    stated = None
    for index in range(row):
        line = source.line(index)
        if (named := unit_in_words(line)) is not None:
            stated, at = named, index
            if _OTHER.search(line):
                raise source.error(index, "the file holds no acceleration: give the .AT2 file")
    unit = settle_unit(source.place(row if stated is None else at), stated, units)
    values = _values(source, row + 1, points)
    acceleration = unit.to_si(values, out=values)
    if len(acceleration) != points or points < 2:
        raise source.error(
            row, f"the file holds {len(acceleration)} values (2 at least)", f"NPTS {points}"
        )
    header = [(f"header line {i + 1}", source.line(i).strip()) for i in range(row + 1)]
    attribution = (("format", "PEER AT2"), *header, ("units in the file", str(unit)))
    return (Record(name, acceleration, step, attribution),)


def _values(source: SourceText, first: int, points: int) -> FloatArray:
    try:
        return source.numbers(first, len(source))
    except RecordError:
        # Fixed columns may touch; then a sign that follows a digit begins the next number.
        last = len(source) - 1
        per_line = len(_touching(source, first))
        if per_line * (last - first) + len(_touching(source, last)) != points:
            raise
        try:
            source.numbers(first, last, per_line=per_line, touching=True)
        except RecordError:
            pass
        else:
            return source.numbers(first, len(source), touching=True)
        raise


def _touching(source: SourceText, index: int) -> list[bytes]:
    return Layout(touching=True).text(source.line(index).encode()).split()


def _is_counted(line: str) -> bool:
    return "NPTS" in line.upper() and line[:1] not in ("#", "%")
