"""The lines ahead of a table: what they state, and the titles and units of its columns."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass, field

from shake_env.records.text.layout import Layout
from shake_env.records.text.source import NUMBER, SourceText, parse_number
from shake_env.records.text.titles import Title, column_title
from shake_env.records.units import quantity_of, unit_in_words, unit_named

MOST_LINES = 200
_POINTS = ("points", "npts", "number of points", "number of samples", "samples")
_STEP = ("sampling interval s", "sampling interval", "dt", "time step", "timestep", "delta t")
_RATE = ("sampling rate", "sampling frequency", "sample rate", "sampling freq", "fs")
_UNITS = ("units", "unit")
_BRACKETED = re.compile(r"[\[(]([^\[\]()]++)[\])]")
_WIDE_BLANKS = re.compile(r"(?<!\s)\s\s++")
_ATTACHED = re.compile(r"\s++(?=[\[(])")


@dataclass
class Heading:
    """What the lines ahead of a table state; places are numbers of lines."""

    entries: dict[str, tuple[int, str]] = field(default_factory=dict)  # key: line, text
    points: tuple[int, int] | None = None
    step: tuple[int, float] | None = None  # [s]
    unit: tuple[int, str] | None = None
    titles: list[Title] = field(default_factory=list)
    title_line: int = 0


def read_heading(source: SourceText, first: int, layout: Layout) -> Heading:
    """Return what the lines before line `first` state of a table in `layout`.

    Raises
    ------
    RecordError
        If two lines contradict each other, a stated number is none, or a line is numbers.
    """
    heading = Heading(title_line=first)
    lines = [i for i in range(first) if source.line(i).strip(" \t#%")]
    if lines and (numbers := _count_and_step(source.line(lines[-1]))):
        at = lines.pop()
        heading.entries["points and step"] = at, source.line(at).strip()
        heading.points, heading.step = (at, numbers[0]), (at, numbers[1])
    rows = _title_rows(source, lines, layout)
    if rows:
        texts, units = rows[0][1], rows[1][1] if len(rows) > 1 else [""] * len(rows[0][1])
        heading.titles = [column_title(t, u) for t, u in zip(texts, units, strict=True)]
        heading.title_line = rows[0][0]
        heading.entries["titles"] = rows[0][0], source.line(rows[0][0]).strip()
    taken = [line for line, _ in rows]
    for index in lines:
        if index not in taken:
            _read_line(source, index, heading, layout)
    return heading


def _count_and_step(line: str) -> tuple[int, float] | None:
    """Return count and step [s] of a line such as '400 0.01', or None."""
    parts = line.strip().lstrip("#%").replace(",", " ").split()
    if len(parts) != 2 or not parts[0].isdecimal() or len(parts[0]) > 9:
        return None
    step = parse_number(parts[1])
    return (int(parts[0]), step) if step is not None and 0.0 < step <= 1.0 else None


def _read_line(source: SourceText, index: int, heading: Heading, layout: Layout) -> None:
    raw = source.line(index).strip()
    comment = raw[0] in "#%"
    text = raw.lstrip("#%").strip()
    mark = ":" if ":" in text else "="
    key, separator, rest = (part.strip() for part in text.partition(mark))
    if not comment and not (separator and key[:1].isalpha()) and _is_data(text, layout):
        raise source.error(index, "is not a row of numbers, and no title")
    plain = " ".join(key.lower().replace("_", " ").partition("(")[0].split())
    known = plain in (*_POINTS, *_STEP, *_RATE, *_UNITS)
    if not separator or (mark == "=" and not known):
        key, rest, known = f"{'comment' if comment else 'header'} line {index + 1}", text, False
    if key in heading.entries:
        raise source.error(index, "says again what a line above says")
    heading.entries[key] = index, rest
    if known:
        _read_entry(source, index, plain, key, rest, heading)
    elif plain_unit := _unit_of(text if not separator or mark == "=" else ""):
        _set_unit(source, index, plain_unit, heading)


def _is_data(text: str, layout: Layout) -> bool:
    """Return whether a line is, wholly or mostly, numbers: a damaged row and no title."""
    parts = [part for part in layout.parts(text) if part]
    digits = sum(char in "0123456789.,-+" for char in text)
    numbers = sum(bool(NUMBER.fullmatch(part)) for part in parts)
    return bool(parts) and (
        numbers == len(parts) or 2 * digits > len(text.replace(" ", ""))
        or (numbers > 0 and len(parts) == layout.per_line)
    )  # fmt: skip


def _unit_of(text: str) -> str | None:
    """Return the unit of acceleration that a line of prose names, or None."""
    for match in _BRACKETED.finditer(text):
        if unit_named(match[1]):
            return match[1]
    words = unit_in_words(text)
    return words if words and unit_named(words) else None


def _set_unit(source: SourceText, index: int, text: str, heading: Heading) -> None:
    if heading.unit is not None and unit_named(heading.unit[1]) != unit_named(text):
        raise source.error(
            index, f"line {heading.unit[0] + 1} states the unit {heading.unit[1]!r}", text
        )
    heading.unit = index, text


def _read_entry(
    source: SourceText, index: int, plain: str, key: str, text: str, heading: Heading
) -> None:
    if plain in _UNITS:
        _set_unit(source, index, text, heading)
        return
    inside = _BRACKETED.search(key)
    value, _, unit = text.strip().partition(" ")
    unit = unit.strip(" .,") or (inside[1].strip() if inside else "")
    amount = parse_number(value.rstrip(","))
    if plain in _POINTS:
        if amount is None or not amount.is_integer() or amount > 1e9:
            raise source.error(index, "must be a number of points", text)
        _agree(source, index, heading.points, int(amount))
        heading.points = index, int(amount)
        return
    rate = plain in _RATE
    scale = {"": 1.0, "hz": 1.0} if rate else {"": 1.0, "ms": 1e-3, "msec": 1e-3}
    seconds = quantity_of(unit) in [("time", word) for word in ("s", "sec", "secs", "second", "seconds")]
    factor = 1.0 if seconds and not rate else scale.get(unit.lower())
    if amount is None or factor is None or amount <= 0.0:
        raise source.error(index, f"must be a number of {'Hz' if rate else 'seconds'} above 0", text)
    step = 1.0 / amount if rate else amount * factor
    if heading.step is None or abs(heading.step[1] - step) > 1e-6 * step:
        _agree(source, index, heading.step, step)
    heading.step = index, step


def _agree(source: SourceText, index: int, before: tuple[int, float] | None, value: float) -> None:
    if before is not None and before[1] != value:
        raise source.error(index, f"line {before[0] + 1} states {before[1]:g}", f"{value:g}")


def _title_rows(source: SourceText, lines: list[int], layout: Layout) -> list[tuple[int, list[str]]]:
    """Return the row of titles and, where there is one, the row of units below it."""
    cells = {i: _cells(source.line(i), layout) for i in lines[-2:]}
    if not lines or not (last := cells[lines[-1]]):
        return []
    above = cells[lines[-2]] if len(lines) > 1 else []
    if _are_units(last) and above:
        return [(lines[-2], above), (lines[-1], last)]
    return [(lines[-1], last)]


def _are_units(cells: list[str]) -> bool:
    units = [cell.strip("[]() ") for cell in cells]
    return any(units) and all(not unit or unit == "-" or quantity_of(unit) for unit in units)


def _cells(line: str, layout: Layout) -> list[str]:
    """Return the titles in a line, one a column; none where the line is no row of titles."""
    text = line.strip().lstrip("#%").strip() if line.strip()[:1] in ("#", "%") else line.strip("\r\n")
    width = layout.per_line or 1
    readings: list[list[str]] = []
    marked = bool(layout.separator)
    if marked:
        try:
            readings.append(next(csv.reader([text], delimiter=layout.separator)))
        except csv.Error:  # quotes that do not close, or a carriage return: no row of titles
            return []
    elif "\t" in text.strip() and width > 1:
        readings.append([part for part in text.strip().split("\t") if part.strip()])
        marked = len(readings[0]) == width
    if not marked:
        text = text.strip()
        comma = [part.strip() for part in text.split(",")]
        readings += [_WIDE_BLANKS.split(text), _ATTACHED.sub("", text).split(), text.split(), comma]
        if width == 1:
            readings = [[text]]
    for cells in readings:
        cells = [cell.strip() for cell in cells]
        if len(cells) == width + 1 and not cells[-1]:
            cells = cells[:-1]  # a separator ends the line
        if len(cells) != width or not any(cells):
            continue
        if ":" in text and not any(column_title(cell).unit for cell in cells):
            continue  # 'Station: nowhere'
        if not cells[0] and [*cells[1:]] == [str(i) for i in range(width - 1)]:
            return [""] * width  # how pandas numbers columns without titles
        if any(NUMBER.fullmatch(cell) for cell in cells):
            continue
        titles = [column_title(cell) for cell in cells]
        known = any(t.kind or t.component or (t.unit and quantity_of(t.unit)) for t in titles)
        units = _are_units(cells)
        if known or units or (marked and width > 1) or (width == 1 and titles[0].unit):
            return cells
    return []
