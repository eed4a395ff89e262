"""Volumes 1 and 2 as Caltech, CDMG and USC wrote them before data blocks had lines of their own.

Lines of text, integers (16 a line, 5 wide) and reals (8 a line, 10 wide) stand in front of the data.
Volume 1 holds pairs of time and acceleration, mostly in G/10, at the uneven times of digitized film.
Volume 2 holds accelerations, velocities and displacements at even times, eight a line. Files with a line
``points of accel data`` are read by `csmip`.
"""

from __future__ import annotations

import numpy as np

from shake_env.errors import RecordError
from shake_env.model.parameters import FloatArray
from shake_env.records.record import Record
from shake_env.records.text.header import (
    LONGEST_LINE,
    behind_blank_lines,
    check_length,
    check_peak,
    check_peak_about_any_mean,
    count_in,
    lower_line,
    value_in,
    words_after,
)
from shake_env.records.text.source import SourceText, parse_number
from shake_env.records.units import Unit, settle_interval, settle_unit

_TEXTS_AT_MOST = 40
_INTEGERS, _INTEGER_COLUMNS, _INTEGER_WIDTH = 100, 16, 5
_REALS = {1: 50, 2: 100}
_REAL_COLUMNS, _REAL_WIDTH = 8, 10
_PAIRS = 5  # a line
_COARSEST = 1.1  # of the mean spacing of the digitized points: what interpolation may ask
_ROUNDING = 0.6e-3  # s: what a time of three decimals may be off
_SCALE = 2.0  # factor within which the root mean square of the header must be the data's
_PEAK = 0.02  # by which a block's peak may differ
_TENTH = ("g/10", "g/10.", "g/10,")
_BLOCKS = (b"points of accel", b"accelerogram points")


def is_cdmg(data: bytes) -> bool:
    """Return whether a file's beginning is this format's, and not the later one's."""
    head = data[:16_000].lower()
    return (
        b"corrected accelerogram" in head.split(b"\n")[0]
        and not any(block in head for block in _BLOCKS)
        and (
            b"units are sec and g" in head or b"accel are sec and g" in head or b"corrected data" in head
        )
    )


def parse_cdmg(
    name: str, data: bytes, *, units: Unit | None = None, sampling_interval: float | None = None
) -> tuple[Record, ...]:
    """Read a file of volume 1 or 2: one record a channel.

    Volume 1 at uneven times needs `sampling_interval`: straight lines between the digitized points are
    then sampled at it, as the makers of volume 2 did.

    Raises
    ------
    RecordError
        If counts, steps, length, unit or peaks contradict each other or the data, or the times are
        uneven and no step is given.
    """
    source = SourceText(name, data)
    records: list[Record] = []
    index = 0
    while index < len(source):
        record, index = _channel(source, index, units, sampling_interval)
        if record.name in {other.name for other in records}:
            raise source.error(index - 1, "the channel that ends here is there twice", record.name)
        records.append(record)
    return tuple(records)


def _channel(
    source: SourceText, start: int, units: Unit | None, sampling_interval: float | None
) -> tuple[Record, int]:
    """Return the channel that begins at a line, and the line behind it."""
    title = lower_line(source, start)
    if "corrected accelerogram" not in title:
        raise source.error(start, "is more than the header above says, and no next channel")
    volume = 1 if "uncorrected accelerogram" in title else 2
    end = start
    while not _is_integers(source, end):
        end += 1
        if end >= min(start + _TEXTS_AT_MOST, len(source)):
            raise source.error(start, f"no lines of integers within {_TEXTS_AT_MOST} lines of this one")
    index = end - (-_INTEGERS // _INTEGER_COLUMNS)
    source.fields(end, _INTEGERS, _INTEGER_COLUMNS, _INTEGER_WIDTH, "I")
    source.fields(index, _REALS[volume], _REAL_COLUMNS, _REAL_WIDTH)
    index -= -_REALS[volume] // _REAL_COLUMNS
    texts = range(start, end)
    read = _uncorrected if volume == 1 else _corrected
    acceleration, step, unit, index, extra = read(source, texts, index, units, sampling_interval)
    component = next(filter(None, (_component(source.line(i)) for i in texts)), "")
    if not component:
        raise source.error(start, "the text has no line 'COMP N90E' or 'CHAN 1: 90 DEG'")
    index = behind_blank_lines(source, index, "/")
    attribution = (
        ("format", f"CDMG, Caltech volume {volume}"),
        ("component", component),
        *((f"header line {i + 1}", source.line(i).strip()) for i in texts if source.line(i).strip()),
        *extra,
        ("units in the file", str(unit)),
    )
    return Record(f"{source.name} {component}", acceleration, step, attribution), index


_Data = tuple[FloatArray, float, Unit, int, tuple[tuple[str, str], ...]]


def _uncorrected(
    source: SourceText, texts: range, index: int, units: Unit | None, sampling_interval: float | None
) -> _Data:
    """Return acceleration, step, unit, the line behind, and remarks of volume 1's pairs."""
    at, words = _find(source, texts, "no.", "of", "points")
    points = count_in(source, at, words[0].rstrip("."))
    lengths = [_find(source, texts, *key, must=False) for key in (("record", "length"), ("duration",))]
    unit_at, words = _find(source, texts, "sec", "and")
    stated = words[0].lower()
    scale = 10.0 if stated in _TENTH else 1.0
    unit = settle_unit(source.place(unit_at), "g" if scale == 10.0 else stated, None)
    unit = Unit(unit.name, unit.factor / scale)
    if units is not None and units != unit:
        raise source.error(unit_at, f"the file's own unit differs from the given {units}")
    rows = -(-points // _PAIRS)
    wide = len(source.line(index)[:LONGEST_LINE].rstrip()) % 7 == 1  # the first column is 8 wide
    shifted = _without_first_column(source, index, rows) if wide else source
    pairs = shifted.fields(0 if wide else index, 2 * points, 2 * _PAIRS, 7).reshape(-1, 2)
    time, values = pairs[:, 0], unit.to_si(pairs[:, 1])
    for line, values_of_line in lengths:
        if values_of_line:
            length = value_in(source, line, values_of_line[0], "a number of seconds")
            check_length(source, line, points, (time[-1] - time[0]) / (points - 1), length)
    for phrase in (("max",), ("max.",)):
        line, values_of_line = _find(source, texts, *phrase, must=False)
        if len(values_of_line) > 1 and parse_number(values_of_line[0]) is not None:
            place = source.place(line)
            check_peak_about_any_mean(
                place, values_of_line[0], settle_unit(place, values_of_line[1], None), values
            )
    _check_scale(source, texts, values)
    acceleration, step, remark = _evenly(source, index, time, values, sampling_interval)
    return acceleration, step, unit, index + rows, remark


def _without_first_column(source: SourceText, first: int, rows: int) -> SourceText:
    """Return lines whose first number is 8 wide as lines of numbers 7 wide."""
    lines = []
    for index in range(first, min(first + rows, len(source))):
        line = source.line(index)[:LONGEST_LINE]
        if line[:1].strip():
            raise source.error(index, "the first column must be a blank")
        lines.append(line[1:])
    return SourceText(source.name, "\n".join(lines).encode("latin-1", "replace") + b"\n")


def _check_scale(source: SourceText, texts: range, values: FloatArray) -> None:
    """Refuse a root mean square (``RMS ACCLN OF COMPLETE RECORD = .400 G/10``) of another scale."""
    line, words = _find(source, texts, "complete", "record", must=False)
    if len(words) < 2 or parse_number(words[0]) is None:
        return
    tenth = words[1].lower() in _TENTH
    unit = settle_unit(source.place(line), "g" if tenth else words[1], None)
    digit = 10.0 ** -len(words[0].partition(".")[2])
    stated, digit = (float(unit.to_si(np.asarray(v))) / (10.0 if tenth else 1.0)
                     for v in (float(words[0]), digit))  # fmt: skip
    rms = float(np.sqrt(np.mean(values**2)))
    if not (stated - digit) / _SCALE <= rms <= (stated + digit) * _SCALE:
        raise source.error(line, f"the data's own root mean square is {rms:.4g} m/s^2")


def _evenly(
    source: SourceText, index: int, time: FloatArray, values: FloatArray, sampling_interval: float | None
) -> tuple[FloatArray, float, tuple[tuple[str, str], ...]]:
    """Return acceleration and step at even times, which the digitized ones are or are brought to."""
    if not np.all(np.diff(time) > 0.0):
        row = int(np.argmin(np.diff(time) > 0.0))
        raise source.error(index + row // _PAIRS, "times must rise", float(time[row + 1]))
    mean = float(time[-1] - time[0]) / (len(time) - 1)
    even = float(f"{mean:.3g}")
    if np.all(np.abs(time - time[0] - even * np.arange(len(time))) <= _ROUNDING):
        return values, settle_interval(source.place(index), even, sampling_interval), ()
    if sampling_interval is None:
        raise source.error(
            index, "the points are digitized at uneven times: give sampling_interval to interpolate",
            f"{mean:.4g} s on average",
        )  # fmt: skip
    if sampling_interval > _COARSEST * mean:
        raise RecordError(
            source.place(index), sampling_interval, f"must not be above the points' own {mean:.4g} s"
        )
    grid = np.arange(int((time[-1] - time[0]) / sampling_interval) + 1) * sampling_interval
    remark = (("interpolated", f"linearly, from {len(time)} points at uneven times"),)
    return np.interp(grid, time - time[0], values), sampling_interval, remark


def _corrected(
    source: SourceText, texts: range, index: int, units: Unit | None, sampling_interval: float | None
) -> _Data:
    """Return acceleration, step, unit, the line behind, and remarks of volume 2's three blocks."""
    step_at, words = _find(source, texts, "intervals", "of")
    step = value_in(source, step_at, words[0], "a number of seconds")
    step = settle_interval(source.place(step_at), step, sampling_interval)
    at, words = next(
        ((i, lower_line(source, i).split()) for i in texts if "corrected data" in lower_line(source, i)),
        (step_at, [""]),
    )
    points = count_in(source, at, words[0])
    rows = -(-points // 8)
    blocks: list[FloatArray] = []
    for kind in ("acceleration", "velocity", "displacement"):
        line, values_of_line = _find(source, texts, "peak", kind)
        if len(values_of_line) < 2 or parse_number(values_of_line[0]) is None:
            raise source.error(line, "expected a peak and its unit")
        width = len(source.line(index)[:LONGEST_LINE].rstrip()) // 8
        values = source.fields(index, points, 8, width)
        place = source.place(line)
        if kind == "acceleration":
            unit = settle_unit(place, values_of_line[1].lower().replace("cms", "cm"), units)
            check_peak(place, values_of_line[0], unit, unit.to_si(values))
        else:
            _check_block(source, line, values_of_line[0], values)
        blocks.append(values)
        index += rows
    return unit.to_si(blocks[0]), step, unit, index, (("not read", "velocity, displacement"),)


def _check_block(source: SourceText, index: int, stated: str, values: FloatArray) -> None:
    """Refuse a block of another peak: it does not lie where it was taken to lie."""
    peak, expected = float(np.max(np.abs(values))), abs(float(stated))
    if abs(peak - expected) > _PEAK * expected + 10.0 ** -len(stated.partition(".")[2]):
        raise source.error(index, f"the data's own peak is {peak:.6g}", f"peak {stated}")


def _find(source: SourceText, texts: range, *phrase: str, must: bool = True) -> tuple[int, list[str]]:
    """Return the line and the words that follow a phrase of the text."""
    for index in texts:
        if words := words_after(source.line(index)[:LONGEST_LINE], *phrase):
            return index, words
    if must:
        raise source.error(texts.start, f"the text below has no '{' '.join(phrase).upper()}'")
    return texts.start, []


def _is_integers(source: SourceText, index: int) -> bool:
    line = source.line(index)[:LONGEST_LINE].rstrip()
    digits = line.replace(" ", "").replace("-", "")
    return len(line) == _INTEGER_COLUMNS * _INTEGER_WIDTH and digits.isdigit()


def _component(line: str) -> str:
    """Return ``COMP N90E`` or ``CHAN 1: 90 DEG`` of a line that has it."""
    words = line[:LONGEST_LINE].upper().split()
    if "COMP" in words:
        return " ".join(words[words.index("COMP") :])
    return " ".join(words) if words[:1] == ["CHAN"] and ":" in line else ""
