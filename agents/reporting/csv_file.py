"""CSV files that a spreadsheet opens as data: no cell begins a formula."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from shake_env.files import write_text

FORMULA = ("=", "+", "-", "@", "\t", "\r")  # a text that begins so is run by a spreadsheet (OWASP, CSV)


def write_csv(
    path: str | PathLike[str], names: Sequence[str], rows: Sequence[Mapping[str, Any]]
) -> None:
    """Write rows under a line of column names; a text that would begin a formula gets a quote in front.

    Parameters
    ----------
    path
        The file.
    names
        Columns, in order.
    rows
        Values by column; None is an empty cell. Numbers are written as they are, negative ones too.
    """
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow([csv_cell(name) for name in names])
    writer.writerows([csv_cell(row[name]) for name in names] for row in rows)
    write_text(Path(path), text.getvalue())


def csv_cell(value: Any) -> Any:
    """Return a value as a CSV file has it: what begins with one of `FORMULA` is quoted by ``'``."""
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) else value
