"""The one progress bar of the command line, and where a training run stands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rich import progress
from rich.console import Console
from rich.progress import BarColumn, TextColumn


@dataclass(frozen=True)
class Progress:
    """Where a training run stands."""

    steps: int
    total_steps: int
    seconds: float  # wall time of training in this process
    cost_ratio: float | None  # last evaluation: relative to the reference's on the same earthquakes
    evaluations: tuple[float, ...] = ()  # all such so far, those before a resumption included
    errors: tuple[float, float] | None = None  # [-] acceleration, base shear: rms over the target's
    reference: str = "LQR"  # what the cost is relative to


def progress_bar(*columns: Any) -> progress.Progress:
    """Return a progress bar on standard error; where that is no terminal, its last state only."""
    return progress.Progress(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"), *columns,
        console=Console(stderr=True),
    )  # fmt: skip
