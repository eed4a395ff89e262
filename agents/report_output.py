"""A report's files: its page, and each of its figures by itself."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from agents.report import Report
from agents.report_figures import stills
from agents.report_page import page


def write_report(report: Report, folder: str | PathLike[str]) -> list[Path]:
    """Write ``index.html`` and every figure as SVG and PNG into a folder; return the paths."""
    folder = Path(folder)
    names = stills(report, folder)
    path = folder / "index.html"
    path.write_text(page(report, names), encoding="utf-8")
    return [path, *(folder / f"{name}.{ending}" for name in names for ending in ("svg", "png"))]
