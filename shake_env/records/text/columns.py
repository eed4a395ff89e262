"""CSV and text in columns, and series of one acceleration that are wrapped over lines.

Lines of a header may come first: comments (``#`` or ``%``), ``key: value``, prose, a line of count and
step (``400 0.01``, as DEEPSOIL and eqsig write it), a row of titles, a row of units. Columns are parted
by commas, semicolons, tabs or blanks; decimal commas are read where another character parts the columns.
What each column was taken for stands in the record's attribution.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from shake_env.errors import RecordError
from shake_env.model.parameters import FloatArray
from shake_env.records.record import Record
from shake_env.records.text.heading import MOST_LINES, Heading, read_heading
from shake_env.records.text.layout import Layout
from shake_env.records.text.source import NUMBER, SourceText
from shake_env.records.text.table import Table
from shake_env.records.text.titles import Title
from shake_env.records.text.wrapping import is_series
from shake_env.records.units import Unit, settle_interval

_DECIMAL_COMMA = re.compile(r"[+-]?+\d++,\d++(?:[eE][+-]?+\d++)?+|[+-]?+\d++", re.ASCII)
_SAMPLE = 200  # lines by which decimal commas are told from columns


def parse_columns(
    name: str,
    data: bytes,
    *,
    units: Unit | None = None,
    sampling_interval: float | None = None,
    column: str | int | None = None,
    formats: Sequence[str] = (),
) -> tuple[Record, ...]:
    """Read columns: one record for each column of acceleration, or the one that `column` names.

    An error at a file that holds no columns names the other `formats` that were tried.

    Raises
    ------
    RecordError
        If a line is not as many numbers as the first, times are not evenly spaced, a stated count
        differs, the accelerations cannot be told from other columns, or neither the file nor the caller
        states a unit (and, without times, a step).
    """
    source = SourceText(name, data)
    first, layout = _body(source, f"; known formats: {', '.join(formats)}" if formats else "")
    heading = read_heading(source, first, layout)
    if first + 1 >= len(source):
        raise source.error(first, "must be followed by another row: 2 samples at least")
    columns = _columns(source, first, layout, heading)
    width = len(columns)
    wrapped = width == 1 and layout.per_line != 1
    titles = heading.titles if len(heading.titles) == width else [Title("", None, None)] * width
    step = None
    if heading.step is not None:
        step = settle_interval(source.place(heading.step[0]), heading.step[1], None)
    table = Table(
        name=name,
        columns=columns,
        titles=titles,
        titled=bool(heading.titles),
        row_place=lambda row: source.place(first + row),
        title_place=source.place(heading.title_line),
        unit=heading.unit and (source.place(heading.unit[0]), heading.unit[1]),
        step=step,
        header=tuple((key, text) for key, (_, text) in heading.entries.items()),
        wrapped=layout.per_line if wrapped else None,
    )
    return table.records(units, sampling_interval, column)


def _columns(source: SourceText, first: int, layout: Layout, heading: Heading) -> list[FloatArray]:
    """Return the columns of the body, or its one series where that is wrapped over the lines."""
    width, last = layout.per_line or 1, len(source)
    final = len(layout.parts(source.line(last - 1)))
    rows, total = last - first, (last - first - 1) * width + final
    points = heading.points[1] if heading.points else None
    if width > 1 and not heading.titles and 0 < final <= width and points != rows:
        series = source.series(first, last, layout)
        if is_series(series[: (rows - 1) * width].reshape(-1, width), counted=points == total):
            if heading.points and points != total:
                place = heading.points[0]
                raise source.error(place, f"the file holds {total} values", f"points {points}")
            return [series]
    if heading.points and points != rows:
        raise source.error(heading.points[0], f"the file holds {rows} rows", f"points {points}")
    return source.columns(first, last, layout)


def _body(source: SourceText, known: str) -> tuple[int, Layout]:
    """Return the first line of the numbers, and their layout; `known` ends an error."""
    lines = range(min(MOST_LINES, len(source)))
    text = (
        [i for i in range(len(source)) if not _is_comment(source.line(i))]
        if len(source) < MOST_LINES
        else lines
    )
    if not text:
        raise RecordError(source.name, f"{len(source)} lines", f"holds no data{known}")
    decimal_comma = _has_decimal_commas(source)
    before: Layout | None = None
    for index in lines:
        layout = _layout(source.line(index), decimal_comma)
        if layout and layout == before and not _is_count_and_step(source, index - 1, layout):
            return index - 1, layout
        before = layout
    if before is not None and len(source) <= MOST_LINES:
        return len(source) - 1, before  # one row, which is refused as such
    shown = next((i for i in lines if not _is_comment(source.line(i))), 0)
    raise source.error(shown, f"is not a row of numbers{known}")


def _is_comment(line: str) -> bool:
    return line.strip()[:1] in ("", "#", "%")


def _is_count_and_step(source: SourceText, index: int, layout: Layout) -> bool:
    """Return whether a line of two numbers is the count and step of the lines below it."""
    parts = layout.parts(source.line(index))
    rows = len(source) - index - 1
    return (
        len(parts) == 2 and parts[0].isdecimal() and len(parts[0]) < 10
        and int(parts[0]) in (rows, 2 * rows, 2 * rows - 1)
    )  # fmt: skip


def _layout(line: str, decimal_comma: bool) -> Layout | None:
    """Return the layout of a line that is nothing but numbers, or None."""
    line = line.strip("\r\n")
    comma = "," if "," in line and not decimal_comma else ""
    separator = ";" if ";" in line else comma
    stripped = line.rstrip()
    trailing = bool(separator) and stripped.endswith(separator)
    layout = Layout(separator=separator, decimal_comma=decimal_comma, trailing=trailing)
    parts = layout.parts(line)
    if not parts or not all(NUMBER.fullmatch(part) for part in parts):
        return None
    return replace(layout, per_line=len(parts))


def _has_decimal_commas(source: SourceText) -> bool:
    """Return whether a comma stands for the decimal point.

    Raises
    ------
    RecordError
        If a comma may as well part two columns of whole numbers.
    """
    pairs: list[tuple[str, str]] = []
    at = 0
    for index in range(min(_SAMPLE, len(source))):
        line = source.line(index).strip()
        if "," not in line or _is_comment(line):
            continue
        parts = [part.strip() for part in (line.split(";") if ";" in line else line.split())]
        if all(not part or _DECIMAL_COMMA.fullmatch(part) for part in parts):
            if len(parts) > 1:
                return True
            whole, _, fraction = parts[0].partition(",")
            pairs.append((whole, fraction))
            at = at or index
        elif all(NUMBER.fullmatch(part.strip()) for part in line.rstrip(",").split(",")):
            return False
    counts = [whole for whole, _ in pairs]
    if len(pairs) < 2 or counts in ([str(k + b) for k in range(len(pairs))] for b in (0, 1)):
        return False
    if any(len(fraction) > 1 and fraction[0] == "0" for _, fraction in pairs):
        return True
    raise source.error(at, "may be one number with a decimal comma or two columns: write decimal points")
