"""Workbooks, ``.xlsx``: a sheet as columns of text, through openpyxl.

Lines in messages are the sheet's rows.
"""

from __future__ import annotations

import importlib
import io
import warnings
import zipfile
from typing import Any

from shake_env.errors import RecordError, install_hint
from shake_env.records.record import Record
from shake_env.records.text.columns import parse_columns
from shake_env.records.text.header import labelled, naming
from shake_env.records.units import Unit

_ZIP, _OLD = b"PK\x03\x04", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
_COLUMNS = 16_384  # of a sheet at most
_LARGEST = 200_000_000  # bytes of a workbook, unpacked


def is_spreadsheet(data: bytes) -> bool:
    """Return whether a file is a workbook, ``.xlsx`` or the older ``.xls``."""
    return (data.startswith(_ZIP) and b"xl/workbook.xml" in data) or data.startswith(_OLD)


def parse_spreadsheet(
    name: str,
    data: bytes,
    *,
    units: Unit | None = None,
    sampling_interval: float | None = None,
    column: str | int | None = None,
    table: str | None = None,
) -> tuple[Record, ...]:
    """Read a workbook: one record a column of acceleration.

    Parameters
    ----------
    name, data, units, sampling_interval, column
        As for :func:`shake_env.records.text.columns.parse_columns`.
    table
        Sheet to read; None where only one holds anything.

    Raises
    ------
    RecordError
        If openpyxl is not installed or cannot read the file, or the choice of sheet is not one.
    """
    if data.startswith(_OLD):
        raise RecordError(name, "a workbook of before 2007", "save it as .xlsx or .csv")
    try:
        openpyxl = importlib.import_module("openpyxl")
    except ImportError:
        raise RecordError(
            name, "a workbook", f"reading it needs openpyxl: {install_hint('xlsx')}"
        ) from None
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(part.file_size for part in archive.infolist())
        if size > _LARGEST:
            raise RecordError(name, f"{size} bytes unpacked", f"at most {_LARGEST} are read")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of styles that it leaves out
            book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
            texts = {sheet.title: _text(sheet) for sheet in book.worksheets}
    except RecordError:
        raise
    except Exception as error:  # what openpyxl raises on a damaged file is not written down
        raise RecordError(
            name, f"{type(error).__name__}: {error}"[:200], "openpyxl cannot read it"
        ) from None
    filled = [title for title, text in texts.items() if text.strip()]
    if table is None and len(filled) != 1:
        sheets = ", ".join(filled) or "none"
        raise RecordError(name, f"sheets: {sheets}", "choose one with table='NAME' (--sheet NAME)")
    if table is not None and table not in filled:
        raise RecordError(name, table, f"is no filled sheet; there are: {', '.join(filled)}")
    title = filled[0] if table is None else table
    place = f"{name}, sheet {title}"
    records = parse_columns(
        place, texts[title], units=units, sampling_interval=sampling_interval, column=column
    )
    others = [f"sheet {other}" for other in filled if other != title]
    return naming(labelled(records, f"workbook, sheet {title}"), others)


def _text(sheet: Any) -> bytes:
    """Return a sheet as lines of cells with tabs between them, without the empty ones about them."""
    lines: list[str] = []
    margins: list[int] = []  # empty cells before the first, of rows that hold more than a title
    for row in sheet.iter_rows(values_only=True):
        line = "\t".join(map(_cell, row)).rstrip("\t")
        lines.append(line)
        inner = line.lstrip("\t")
        if "\t" in inner:
            margins.append(len(line) - len(inner))
    margin = min(margins, default=_COLUMNS)
    texts = [line[min(margin, len(line) - len(line.lstrip("\t"))) :] for line in lines]
    return ("\n".join(texts).rstrip("\n") + "\n").encode()


def _cell(value: object) -> str:
    return "" if value is None else " ".join(str(value).split())
