"""Logs as CSV: attributes in comments, a row of titles ``name [unit]``, then rows of numbers.

Numbers are written so that they read back to the last bit. Of a foreign file the first row that is no
comment must be the titles; a unit may stand in brackets behind each.
"""

from __future__ import annotations

import json
import re

import numpy as np

from agents.laboratory.logs.raw import RawTable, attributes_of, column_unit
from agents.laboratory.logs.test_log import MOST, TestLog
from shake_env.errors import LogError
from shake_env.model.parameters import FloatArray

_TITLE = re.compile(r"(.*?)\s*[\[(]([^\[\]()]*)[\])]")


def csv_bytes(log: TestLog) -> bytes:
    """Return the file of a log."""
    lines = [f"# {key}: {json.dumps(value)}" for key, value in attributes_of(log).items()]
    lines.append(",".join(f"{name} [{column_unit(log, name)}]" for name in log.channels))
    columns = [values.tolist() for values in log.channels.values()]
    lines += [",".join(map(repr, row)) for row in zip(*columns, strict=True)]
    return ("\n".join(lines) + "\n").encode()


def read_csv(source: str, content: bytes, delimiter: str | None = None) -> RawTable:
    """Return the columns of a file.

    Parameters
    ----------
    source, content
        The file.
    delimiter
        Between cells; None: the one of comma, semicolon and tab that the titles hold most of.

    Raises
    ------
    LogError
        If a row has another number of cells than the titles, or a cell is no number.
    """
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        lines = content.decode("latin-1").splitlines()
    attributes: dict[str, str | float] = {}
    first = 0
    while first < len(lines) and (not lines[first].strip() or lines[first].startswith("#")):
        key, _, text = lines[first].removeprefix("#").partition(":")
        try:
            value = json.loads(text)
        except (ValueError, RecursionError):
            value = text.strip()
        if isinstance(value, str | float | int):
            attributes[key.strip()] = value
        first += 1
    while lines and not lines[-1].strip():
        lines.pop()
    rows = lines[first + 1 :]
    if first >= len(lines) or not rows:
        raise LogError(source, len(lines), "holds no row of titles with rows of numbers below it")
    if len(rows) > MOST:
        raise LogError(source, len(rows), f"at most {MOST} samples are read")
    heading = lines[first]
    delimiter = delimiter or max(",;\t", key=heading.count)
    titles, units = _titles(_cells(heading, delimiter))
    if len(set(titles)) < len(titles):
        raise LogError(f"{source}, titles", titles, "each column needs a title of its own")
    table = np.empty((len(rows), len(titles)))
    for number, row in enumerate(rows):
        cells = _cells(row, delimiter)
        place = f"{source}, line {first + number + 2}"
        if len(cells) != len(titles):
            raise LogError(place, row[:60], f"has {len(cells)} cells, where {len(titles)} are titled")
        try:
            table[number] = [float(cell) for cell in cells]
        except ValueError:
            raise LogError(place, row[:60], "holds a cell that is no number") from None
    columns: dict[str, FloatArray] = {
        title: np.ascontiguousarray(table[:, i]) for i, title in enumerate(titles)
    }
    return RawTable(f"{source} (CSV)", columns, units, attributes)


def _cells(line: str, delimiter: str) -> list[str]:
    parts = line.split() if delimiter == " " else line.split(delimiter)
    return [part.strip().strip('"').strip() for part in parts]


def _titles(cells: list[str]) -> tuple[list[str], dict[str, str]]:
    titles, units = [], {}
    for cell in cells:
        match = _TITLE.fullmatch(cell)
        title = match[1] if match else cell
        titles.append(title)
        if match:
            units[title] = match[2]
    return titles, units
