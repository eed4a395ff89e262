"""The one progress bar of the command line."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn


def progress_bar(*columns: Any) -> Progress:
    """Return a progress bar on standard error; where that is no terminal, its last state only."""
    return Progress(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"), *columns,
        console=Console(stderr=True),
    )  # fmt: skip
