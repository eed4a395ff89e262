"""PEER's ``.AT2`` files: four lines of header, then accelerations in g.

The fourth line reads ``NPTS=  4000, DT= .01000 SEC`` or ``4000   0.0100   NPTS, DT``, by age.
"""

from __future__ import annotations

import re

from shake_env.errors import RecordError
from shake_env.parameters import FloatArray
from shake_env.records.record import Record
from shake_env.records.text import SourceText, number
from shake_env.records.units import Unit, settle_interval, settle_unit

_HEADER_LINES = 16  # at most
_END = r"\s*(?:SECS?|SECONDS)?[.,]?\s*"
_COUNTS = (
    re.compile(rf"\s*NPTS\s*=\s*(\d+)\s*,?\s*DT\s*=\s*(\S+?),?{_END}", re.IGNORECASE | re.ASCII),
    re.compile(r"\s*(\d+)\s*,?\s+(\S+?),?\s+NPTS\s*,?\s*DT\b.*", re.IGNORECASE | re.ASCII),
)
_COUNTED = re.compile(r"[^#%].*NPTS|NPTS")
_UNITS = re.compile(r"\bUNITS?\s+OF\s+(\S+)", re.IGNORECASE)
_OTHER = re.compile(r"\b(VELOCITY|DISPLACEMENT)\b", re.IGNORECASE)
_TOUCHING = re.compile(rb"(?<=[0-9.])(?=[+-])")


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
    row = next((i for i in range(_HEADER_LINES) if _COUNTED.match(source.line(i).upper())), 0)
    matches = [match for pattern in _COUNTS if (match := pattern.fullmatch(source.line(row)))]
    step_text = matches[0][2] if matches else ""
    if not matches or number(step_text) is None:
        raise source.error(row, "expected 'NPTS=  4000, DT=  .0100 SEC' or '4000  0.0100  NPTS, DT'")
    points = int(matches[0][1][:18])  # a longer count is absurd, and is refused as such
    step = settle_interval(source.place(row), number(step_text), sampling_interval)
    stated = None
    for index in range(row):
        line = source.line(index)
        if match := _UNITS.search(line):
            stated, at = match[1], index
            if _OTHER.search(line):
                raise source.error(index, "the file holds no acceleration: give the .AT2 file")
    unit = settle_unit(source.place(row if stated is None else at), stated, units)
    acceleration = unit.to_si(_values(source, row + 1, points))
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
        parted = SourceText(source.name, _TOUCHING.sub(b" ", source.data))
        counts = [len(parted.line(i).split()) for i in range(first, len(parted))]
        if sum(counts) != points or any(c != counts[0] for c in counts[:-1]):
            raise
        return parted.numbers(first, len(parted))
