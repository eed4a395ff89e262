"""GeoNet (New Zealand) volumes 1 and 2, ``.V1A`` and ``.V2A``: three components one after another.

Each is 16 lines of text, 4 of ten integers, 6 of ten reals, then accelerations in mm/s^2, ``10F8.1``; in
volume 2 velocities and displacements follow, which are counted over.
"""

from __future__ import annotations

import numpy as np

from shake_env.records.record import Record
from shake_env.records.text.header import (
    LONGEST_LINE,
    check_length,
    check_peak,
    check_step,
    count_in,
    lower_line,
    value_in,
    words_after,
)
from shake_env.records.text.source import SourceText, parse_number
from shake_env.records.units import Unit, settle_interval, settle_unit

_TEXTS, _INTEGERS, _REALS = 16, 40, 60
_HEADER = _TEXTS + (_INTEGERS + _REALS) // 10
_COUNT, _SCALE, _COMPONENT, _PEAK = 9, 10, 12, 13  # lines of the text, from 0
_COMPONENTS = 3


def is_geonet(data: bytes) -> bool:
    """Return whether a file's beginning is this format's."""
    first = data[:200].split(b"\n")[0].lower()
    return b"corrected accelerogram" in first and b"gns science" in first


def parse_geonet(
    name: str, data: bytes, *, units: Unit | None = None, sampling_interval: float | None = None
) -> tuple[Record, ...]:
    """Read a GeoNet file: one record of acceleration a component.

    Raises
    ------
    RecordError
        If counts, steps, length, unit, peak or number of components contradict each other or the data.
    """
    source = SourceText(name, data)
    records: list[Record] = []
    index = 0
    while index < len(source):
        record, index = _component(source, index, units, sampling_interval)
        if record.name in {other.name for other in records}:
            raise source.error(index - 1, "the component that ends here is there twice", record.name)
        records.append(record)
    if len(records) != _COMPONENTS:
        raise source.error(0, f"holds {len(records)} components; a file of this format holds 3")
    return tuple(records)


def _component(
    source: SourceText, start: int, units: Unit | None, sampling_interval: float | None
) -> tuple[Record, int]:
    """Return the component that begins at a line, and the line behind it."""
    if not is_geonet(source.line(start)[:LONGEST_LINE].encode()):
        raise source.error(start, "is more than the header above says, and no next component")
    volume = 1 if lower_line(source, start).startswith("uncorrected") else 2
    points, length = _count(source, start + _COUNT)
    step, unit = _step_and_unit(source, start, units)
    step = settle_interval(source.place(start + _SCALE), step, sampling_interval)
    check_length(source, start + _COUNT, points, step, length)
    integers = source.fields(start + _TEXTS, _INTEGERS, 10, 8, "I").astype(np.int64)
    counts = [int(n) for n in (integers[30:31] if volume == 1 else integers[33:36])]
    if counts[0] != points or min(counts) < 0:
        raise source.error(start + _TEXTS + 3, f"line {start + _COUNT + 1} states {points}", counts[0])
    reals = source.fields(start + _TEXTS + _INTEGERS // 10, _REALS, 10, 8)
    if reals[25] > 0.0:
        check_step(source, start + _TEXTS + _INTEGERS // 10 + 2, step, float(reals[25]))
    index = start + _HEADER
    acceleration = unit.to_si(source.fields(index, points, 10, 8))
    index += -(-points // 10)
    for count in counts[1:]:  # velocities, displacements
        if count:
            source.fields(index, count, 10, 8)
        index += -(-count // 10)
    words = words_after(source.line(start + _PEAK)[:LONGEST_LINE], "peak")
    if not words or parse_number(words[0]) is None or len(words) < 2:
        raise source.error(start + _PEAK, "expected the peak of the acceleration and its unit")
    place = source.place(start + _PEAK)
    check_peak(place, words[0], settle_unit(place, words[1], None), acceleration)
    component = (words_after(source.line(start + _COMPONENT)[:LONGEST_LINE], "component") or [""])[0]
    if not component:
        raise source.error(start + _COMPONENT, "expected 'Component' and its direction")
    attribution = (
        ("format", f"GeoNet volume {volume}"),
        ("component", component),
        *((f"header line {i + 1}", source.line(start + i).strip()) for i in range(_TEXTS)),
        *((("not read", "velocity, displacement"),) if any(counts[1:]) else ()),
        ("units in the file", str(unit)),
    )
    return Record(f"{source.name} {component}", acceleration, step, attribution), index


def _count(source: SourceText, index: int) -> tuple[int, float]:
    """Return count and length [s] of ``Number of points  8192    Duration 163.82 sec``."""
    line = source.line(index)[:LONGEST_LINE]
    count, length = words_after(line, "of", "points"), words_after(line, "duration")
    if not (count and length):
        raise source.error(index, "expected 'Number of points', the number, 'Duration', seconds")
    return (
        count_in(source, index, count[0]),
        value_in(source, index, length[0], "a number of seconds"),
    )


def _step_and_unit(source: SourceText, start: int, units: Unit | None) -> tuple[float, Unit]:
    """Return step [s] and unit, of the scale's line (volume 1 states the unit) and the peak's."""
    index = start + _SCALE
    line = source.line(index)[:LONGEST_LINE]
    scale, step = words_after(line, "in", "units", "of"), words_after(line, "at", "intervals", "of")
    step = step or words_after(line, "data", "at")
    if not step:
        raise source.error(index, "expected 'at intervals of 0.005 s'")
    if scale and (len(scale) < 2 or parse_number(scale[0]) != 1.0):
        raise source.error(index, "readings in units of 1.00 mm/s/s only are understood")
    peak = words_after(source.line(start + _PEAK)[:LONGEST_LINE], "peak")
    stated = scale[1] if scale else (peak[1] if len(peak) > 1 else None)
    unit = settle_unit(source.place(index), stated, units)
    return value_in(source, index, step[0], "a number of seconds"), unit
