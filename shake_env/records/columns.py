"""CSV and text in columns: time and one or more accelerations, or one acceleration at a known step.

Comment lines (``#`` or ``%``) may come first, then one line of titles. ``# points: 4000``,
``# units: g`` and ``# sampling_interval_s: 0.01`` among the comments are believed and checked; a title
may carry a unit in brackets. Columns are parted by commas, semicolons, tabs or blanks.
"""

from __future__ import annotations

import re

import numpy as np

from shake_env.errors import RecordError
from shake_env.parameters import FloatArray
from shake_env.records.record import Record
from shake_env.records.text import NUMBER, SourceText, number
from shake_env.records.units import Unit, settle_interval, settle_unit

_BRACKETED = re.compile(r"[\[(]\s*([^\[\]()]*?)\s*[\])]")
_SECONDS = {"s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3}
_UNEVEN = 0.02  # of a step: more than printed digits take off, less than a line lost
_FORMATS = "PEER .AT2, CSMIP volume 1 and 2, K-NET, CSV or columns of time and acceleration"


def parse_columns(
    name: str, data: bytes, *, units: Unit | None = None, sampling_interval: float | None = None
) -> tuple[Record, ...]:
    """Read columns: one record for each column of acceleration.

    Raises
    ------
    RecordError
        If a line is not as many numbers as the first, times are not evenly spaced, a stated count
        differs, or neither the file nor the caller states a unit (and, without times, a step).
    """
    source = SourceText(name, data.removeprefix(b"\xef\xbb\xbf"))
    header, index = _comments(source)
    first_line = source.line(index)
    separator = next((mark for mark in ";,\t" if mark in first_line), "")
    separator = "" if separator == "\t" else separator
    titles: list[str] = []
    title_line = index
    if not _is_numbers(first_line, separator) and _is_numbers(source.line(index + 1), separator):
        titles = [
            title.strip() for title in (first_line.split(separator) if separator else [first_line])
        ]
        index += 1
    if not _is_numbers(source.line(index), separator):
        raise source.error(index, f"is not a row of numbers; known formats: {_FORMATS}")
    width = len(_parts(source.line(index), separator))
    if not separator and titles:
        titles = re.split(r"\t+|\s{2,}", first_line.strip())
        titles = titles if len(titles) == width else first_line.split()
    if len(titles) != width and titles:
        titles = []  # blanks inside titles that blanks part: they cannot be told apart
    table = source.numbers(index, len(source), per_line=width, separator=separator).reshape(-1, width)
    if "points" in header:
        at, text = header["points"]
        if number(text) != len(table):
            raise source.error(at, f"the file holds {len(table)} rows", f"points {text}")
    if len(table) < 2:
        raise source.error(index, "must be followed by another row: 2 samples at least")
    stated = _stated_step(source, header)
    if width > 1:
        step = settle_interval(source.place(index), _step(source, table[:, 0], index, titles), stated)
        step = settle_interval(source.place(index), step, sampling_interval)
    else:
        step = settle_interval(source.place(index), stated, sampling_interval)
    records = []
    for column in range(min(1, width - 1), width):
        title = titles[column] if titles else ""
        place, stated_unit = _stated_unit(source, header, title, title_line)
        unit = settle_unit(place, stated_unit, units)
        own = f" {title or f'column {column + 1}'}" if width > 2 else ""
        attribution = (
            ("format", "columns"),
            *((key, text) for key, (_, text) in header.items()),
            *((("title", title),) if title else ()),
            ("units in the file", str(unit)),
        )
        records.append(Record(f"{name}{own}", unit.to_si(table[:, column]), step, attribution))
    return tuple(records)


def _comments(source: SourceText) -> tuple[dict[str, tuple[int, str]], int]:
    """Return the comments as key: (line, text), and the first line behind them."""
    header: dict[str, tuple[int, str]] = {}
    index = 0
    while index < len(source):
        line = source.line(index).strip()
        if line and line[0] not in "#%":
            break
        key, colon, text = line[1:].partition(":")
        key = key.strip() if colon else f"comment line {index + 1}"
        if line:
            if key in header:
                raise source.error(index, "says again what a line above says")
            header[key] = index, (text if colon else line[1:]).strip()
        index += 1
    if index >= len(source):
        raise RecordError(source.name, f"{index} lines", f"holds no data; known formats: {_FORMATS}")
    return header, index


def _parts(line: str, separator: str) -> list[str]:
    return line.split(separator) if separator else line.split()


def _is_numbers(line: str, separator: str) -> bool:
    return bool(line.strip()) and all(NUMBER.fullmatch(part.strip()) for part in _parts(line, separator))


def _stated_step(source: SourceText, header: dict[str, tuple[int, str]]) -> float | None:
    if "sampling_interval_s" not in header:
        return None
    at, text = header["sampling_interval_s"]
    value = number(text)
    if value is None:
        raise source.error(at, "must be a number of seconds")
    return settle_interval(source.place(at), value, None)


def _stated_unit(
    source: SourceText, header: dict[str, tuple[int, str]], title: str, title_line: int
) -> tuple[str, str | None]:
    if match := _BRACKETED.search(title):
        return source.place(title_line), match[1]
    if "units" in header:
        return source.place(header["units"][0]), header["units"][1]
    return source.place(title_line), None


def _step(source: SourceText, time: FloatArray, first: int, titles: list[str]) -> float:
    """Return the step of evenly spaced times [s]."""
    scale = 1.0
    if titles and (match := _BRACKETED.search(titles[0])):
        if match[1].lower() not in _SECONDS:
            raise source.error(first - 1, "the first column must be time in s", match[1])
        scale = _SECONDS[match[1].lower()]
    steps = np.diff(time)
    with np.errstate(over="ignore", invalid="ignore"):
        mean = float(time[-1] - time[0]) / (len(time) - 1)
        if not (np.isfinite(mean) and mean > 0.0):
            raise source.error(first, "the first column must be time, rising from line to line")
        uneven = np.abs(time - (time[0] + mean * np.arange(len(time)))) > _UNEVEN * mean
        uneven[1:] |= np.abs(steps - mean) > 2.0 * _UNEVEN * mean
    if uneven.any():
        # Past a lost line every time is off a little; the step that is off the most is the lost line.
        worst = int(np.argmax(np.abs(steps - np.median(steps)))) + 1
        raise source.error(
            first + worst, f"the times are not evenly spaced by {float(np.median(steps)):g} s"
        )
    short = float(f"{mean:.9g}")  # 0.005, where the times' own rounding makes 0.00499999999999
    return scale * (short if abs(short - mean) <= 1e-9 * mean else mean)
