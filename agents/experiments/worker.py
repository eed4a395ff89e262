"""One run of a campaign or of a search, as a worker carries it out."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict
from os import PathLike
from pathlib import Path
from typing import Any

from agents.progress import Progress
from agents.run_directory import PROGRESS, InUseError
from agents.training.config import config_of
from agents.training.run import train_or_resume
from shake_env.files import write_json

PATIENCE = 120.0  # [s] between two lines that say who holds the run
LONGEST = 24 * 3600.0  # [s] that a run is waited for which a worker of an earlier campaign goes on with


def train_run(
    run: str | PathLike[str],
    values: dict[str, Any],
    command: str,
    first: str | None = None,
    on_progress: Callable[[Progress], None] = lambda progress: None,
) -> None:
    """Train a configuration, or go on with its run, and keep the run's progress file up to date.

    A new run begins with the policy of the run directory `first`, where one is given. What
    `on_progress` raises ends the run.

    Raises
    ------
    RunDirectoryError
        If the directory holds a run of another configuration.
    InUseError
        If another process still goes on with it after a day.
    """
    run, config = Path(run), config_of(values)

    def report(progress: Progress) -> None:
        write_json(run / PROGRESS, asdict(progress))
        on_progress(progress)

    end = time.monotonic() + LONGEST
    while True:
        try:
            return train_or_resume(
                config, run, report=report, command=command, wait=PATIENCE,
                first=None if first is None else Path(first),
            )  # fmt: skip
        except InUseError as error:
            if time.monotonic() > end:
                raise
            print(error, flush=True)
