"""COSMOS strong-motion data format, version 1: channels of acceleration, velocity and displacement.

A channel is lines of text (the first says how many), integers, reals and comments, each under a line
that states their number and Fortran format; a line with count, unit and format; the data; and a line
``End-of-data``. Format: COSMOS Strong Motion Data Format, version 1.20 (2001).
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shake_env.errors import RecordError
from shake_env.model.parameters import FloatArray
from shake_env.records.record import Record
from shake_env.records.text.header import (
    LONGEST_LINE,
    behind_blank_lines,
    check_length,
    check_peak,
    check_peak_about_any_mean,
    fortran_form,
    lower_line,
    naming,
    sensor_entries,
    words_after,
)
from shake_env.records.text.source import SourceText, parse_number
from shake_env.records.units import Unit, settle_interval, settle_unit

_TEXTS_AT_MOST = 40
_TITLE = re.compile(r"\(format v ?\d\d?\.\d\d? with (\d{1,3}) text lines\)", re.ASCII)
_UNIT = re.compile(r"units ?= ?([^ (),]+) ?(?:\( ?(\d\d?) ?\))?", re.ASCII)
_WORDS = {"veloc": "velocity", "displ": "displacement"}
_KINDS = ("accel", "veloc", "displ")  # by the physical parameter 1, 2, 3
_UNITS = {2: "g", 4: "cm/s^2", 7: "in/s^2", 10: "gal", 11: "mg", 50: "counts"}  # by their code
_STAGES = {0: "volume 0, raw", 1: "volume 1, uncorrected", 2: "volume 2, corrected"}
_RAW = ("count", "volt", "mvolt", "microvolt")


def is_cosmos(data: bytes) -> bool:
    """Return whether a file's beginning is this format's."""
    first = " ".join(data[:400].split(b"\n")[0].decode("latin-1").lower().split())
    return _TITLE.search(first) is not None


@dataclass(frozen=True)
class _Header:
    """One channel's header; lines are counted from 0."""

    start: int
    texts: int  # lines of text
    integers: NDArray[np.int64]  # (100,) or more
    reals: FloatArray  # (100,) or more
    unknown: tuple[float, float]  # what stands for an unknown integer, real
    reals_at: int
    comments: range
    data_at: int  # line of count, unit and format


def parse_cosmos(
    name: str, data: bytes, *, units: Unit | None = None, sampling_interval: float | None = None
) -> tuple[Record, ...]:
    """Read a COSMOS file: one record a channel of acceleration; velocity and displacement are skipped.

    Raises
    ------
    RecordError
        If the file holds no acceleration, or counts, steps, length, unit, peak or number of channels
        contradict each other or the data.
    """
    source = SourceText(name, data)
    records: list[Record] = []
    skipped: list[str] = []
    stated: list[tuple[int, tuple[int, ...]]] = []  # numbers of channels, and where they are stated
    index = 0
    while index < len(source):
        header = _header(source, index)
        kind, record, index = _channel(source, header, units, sampling_interval)
        if record is None:
            skipped.append(_WORDS[kind])
            continue
        if record.name in {other.name for other in records}:
            raise source.error(header.start, "the channel is there twice", record.name)
        records.append(record)
        stated.append((header.start + 6, _channels(source, header.start + 6)))
    if not records:
        raise RecordError(name, ", ".join(skipped), "the file holds no acceleration: give its file")
    at, numbers = stated[0]
    if len(records) > 1 and numbers and len(records) not in numbers:
        raise source.error(at, f"the file holds {len(records)} channels", f"{numbers[0]} Chns")
    return naming(records, skipped)


def _header(source: SourceText, start: int) -> _Header:
    """Return the header that begins at a line."""
    title = _TITLE.search(" ".join(lower_line(source, start).split()))
    if title is None or not 8 <= int(title[1]) <= _TEXTS_AT_MOST:
        raise source.error(
            start, "expected a channel's first line, as '(Format v01.20 with 13 text lines)'"
        )
    texts = int(title[1])
    index = start + texts
    integers, index = _numbers(source, index, "integer-header", "I")
    reals_at = index
    reals, index = _numbers(source, index, "real-header", "E")
    words = lower_line(source, index).split()
    if len(words) < 2 or not words[0].isdigit() or words[1] != "comment":
        raise source.error(index, "expected the number of comment lines")
    comments = range(index + 1, index + 1 + int(words[0][:9]))
    for line in comments:
        if not source.line(line).startswith("|"):
            raise source.error(
                line, f"is no comment, which begins with '|'; line {index + 1} states more"
            )
    last = lower_line(source, start + texts - 1).replace(",", " ").replace(":", " ").split()[-2:]
    values = [parse_number(word) for word in last]
    unknown = (-999.0, -999.0)
    if len(values) == 2 and values[0] is not None and values[1] is not None:
        unknown = values[0], values[1]
    return _Header(
        start, texts, integers.astype(np.int64), reals, unknown, reals_at, comments, comments.stop
    )


def _numbers(source: SourceText, index: int, what: str, form: str) -> tuple[FloatArray, int]:
    """Return the numbers under ``100 Integer-header values follow on 10 lines, Format= (10I8)``."""
    line = lower_line(source, index)
    words, layout = line.split(), fortran_form(line)
    if len(words) < 2 or words[1] != what or layout is None or layout[1] != form:
        raise source.error(index, f"expected the number of {what} values and their format")
    count = int(words[0]) if words[0].isdigit() and len(words[0]) < 6 else 0
    if count < 66:
        raise source.error(index, f"a header holds 100 {what} values", f"{count} values")
    values = source.fields(index + 1, count, layout[0], layout[2], form)
    return values, index + 1 - (-count // layout[0])


def _channel(
    source: SourceText,
    header: _Header,
    units: Unit | None,
    sampling_interval: float | None,
) -> tuple[str, Record | None, int]:
    """Return kind, record (none of a velocity) and the line behind a channel."""
    at = header.data_at
    line = lower_line(source, at)
    words, layout, unit = line.split(), fortran_form(line), _UNIT.search(line)
    kind = next((kind for kind in _KINDS if kind in line.partition("pts")[0]), None)
    count = int(words[0]) if words and words[0].isdigit() and len(words[0]) < 12 else 0
    if layout is None or unit is None or kind is None or count < 2:
        example = "400 acceleration pts, units=cm/sec2, Format=(8F10.5)"
        raise source.error(at, f"expected count, kind, unit and format: '{example}'")
    parameter = int(header.integers[1])
    if parameter in (1, 2, 3) and _KINDS[parameter - 1] != kind:
        raise source.error(at, f"the second integer, {parameter}, says {_KINDS[parameter - 1]}")
    values = source.fields(at + 1, count, layout[0], layout[2], layout[1])
    after = _after(source, at + 1 - (-count // layout[0]), kind)
    if kind != "accel":
        return kind, None, after
    return kind, _record(source, header, values, unit, units, sampling_interval), after


def _after(source: SourceText, index: int, kind: str) -> int:
    """Return the line where the next channel begins."""
    line = lower_line(source, index)
    if line.startswith("end-of-data"):
        if any(other in line for other in _KINDS) and kind not in line:
            raise source.error(index, f"ends other data than the {kind} above")
        index += 1
    index = behind_blank_lines(source, index)
    if index < len(source) and _TITLE.search(" ".join(lower_line(source, index).split())) is None:
        raise source.error(index, "is more data than the channel above states, and no next channel")
    return index


def _record(
    source: SourceText,
    header: _Header,
    values: FloatArray,
    stated: re.Match[str],
    units: Unit | None,
    sampling_interval: float | None,
) -> Record:
    place, reals_at = source.place(header.data_at), header.reals_at
    raw = stated[1].rstrip("s").startswith(_RAW)
    code = int(header.integers[2])
    expected = _UNITS.get(code)
    if expected is not None and (expected == "counts") != raw:
        raise RecordError(place, stated[1], f"the third integer, {code}, says {expected}")
    unit = settle_unit(place, None if raw else stated[1], units)
    if expected is not None and not raw:
        settle_unit(source.place(header.start + header.texts), expected, unit)
    acceleration = unit.to_si(values)

    def real(position: int) -> float | None:
        """Return the real at a position of the format's own count, from 1; None where unknown."""
        value = float(header.reals[position - 1])
        return None if value in header.unknown else value

    line = source.place(reals_at + 1)
    milliseconds, seconds = real(62), real(34)
    step = milliseconds / 1000.0 if milliseconds is not None else seconds
    step = settle_interval(line, step, sampling_interval)
    if (length := real(63)) is not None:
        check_length(source, reals_at + 1, len(values), step, length)
    if (peak := real(64)) is not None:
        check = check_peak if header.integers[0] == 2 else check_peak_about_any_mean
        check(line, f"{peak:.6f}", unit, acceleration)
    _check_text_peak(source, header, raw, acceleration)
    label = " ".join(source.line(header.start + 8)[:LONGEST_LINE].split())
    stage = _STAGES.get(int(header.integers[0]), f"stage {header.integers[0]}")
    attribution = (
        ("format", f"COSMOS {stage}"),
        ("component", label or "not stated"),
        *_texts(source, header),
        *sensor_entries(_seed_code(source, header.comments)),
        ("units in the file", f"counts of {unit}" if raw else str(unit)),
    )
    return Record(_name(source, header, label), acceleration, step, attribution)


def _name(source: SourceText, header: _Header, label: str) -> str:
    """Return a channel's name: its number and direction, or its code."""
    code = _seed_code(source, header.comments)
    words = label.replace(":", " ").split()
    if words[:2] == ["Sta", "Chan"] and len(words) > 3:
        direction = " ".join(words[3:]).partition("(")[0].strip()
        return f"{source.name} channel {words[2]} ({direction})" + (f" {code}" if code else "")
    return f"{source.name} {code}".strip()


def _check_text_peak(source: SourceText, header: _Header, raw: bool, acceleration: FloatArray) -> None:
    """Compare the data with ``Processed: 2020/01/02, Max = 95.039 cm/sec2 at 2.000 sec``."""
    index = header.start + 10
    words = words_after(source.line(index)[:LONGEST_LINE], "max")
    if raw or len(words) < 2 or parse_number(words[0]) is None or float(words[0]) == 0.0:
        return
    unit = settle_unit(source.place(index), words[1], None)
    check_peak_about_any_mean(source.place(index), words[0], unit, acceleration)


def _seed_code(source: SourceText, comments: range) -> str:
    """Return the channel's code from a comment ``|<SCNL>1795.HNE.NP.--``, or nothing."""
    for index in comments:
        text = source.line(index)[:LONGEST_LINE].partition("<SCNL>")[2].split()
        parts = text[0].split(".") if text else []
        if len(parts) == 4:
            return parts[1]
    return ""


def _channels(source: SourceText, index: int) -> tuple[int, ...]:
    """Return the numbers of ``( 1 Chns of 3 at Sta)``: in the recorder, at the station."""
    piece = next((piece for piece in lower_line(source, index).split("(") if "chns" in piece), "")
    words = piece.partition(")")[0].split()
    return tuple(int(word) for word in words if word.isdigit() and len(word) < 6)


def _texts(source: SourceText, header: _Header) -> list[tuple[str, str]]:
    lines = [*range(header.start, header.start + header.texts), *header.comments]
    texts = [(i, source.line(i).strip(" |\t")) for i in lines]
    return [(f"header line {i + 1}", text) for i, text in texts if text]
