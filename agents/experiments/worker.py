"""One run of a campaign in a process of its own: a configuration on standard input, then training.

``python -m agents.experiments.worker RUN COMMAND``. A run that was begun is gone on with.
"""

from __future__ import annotations

import os
import sys
from dataclasses import asdict
from os import PathLike
from pathlib import Path

from agents.progress import Progress
from agents.run_directory import PROGRESS, parse_json
from agents.training.config import config_of
from agents.training.run import train_or_resume
from shake_env.errors import ShakeError
from shake_env.files import write_json

PATIENCE = 120.0  # [s] in which a worker whose campaign was killed comes to its next report and ends


def work(run: str | PathLike[str], values: str, command: str) -> None:
    """Train or go on, and keep the run's progress file up to date.

    Raises
    ------
    RunDirectoryError
        If the directory holds a run of another configuration, or another process goes on with it.
    """
    run = Path(run)
    config, parent = config_of(parse_json(values)), os.getppid()

    def report(progress: Progress) -> None:
        if os.getppid() != parent:
            raise KeyboardInterrupt  # the campaign is gone; the checkpoint stays
        write_json(run / PROGRESS, asdict(progress))

    train_or_resume(config, run, report=report, command=command, wait=PATIENCE)


if __name__ == "__main__":
    try:
        work(Path(sys.argv[1]), sys.stdin.read(), sys.argv[2])
    except ShakeError as error:
        sys.exit(str(error))  # the last line of the log, which the campaign shows
