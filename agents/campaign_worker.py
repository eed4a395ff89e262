"""One run of a campaign in a process of its own: a configuration on standard input, then training.

``python -m agents.campaign_worker RUN COMMAND``. A run that was begun is gone on with.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

try:
    import fcntl
except ImportError:  # no such locks on Windows
    fcntl = None  # type: ignore[assignment]

from agents.config import config_of
from agents.train import Progress, go_on

PROGRESS = "progress.json"


@contextmanager
def _alone(run: Path) -> Iterator[None]:
    """Hold the run's lock: workers of a campaign that was killed end only at their next report."""
    run.parent.mkdir(parents=True, exist_ok=True)
    with run.with_name(run.name + ".lock").open("w") as lock:
        if fcntl is not None:
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def work(run: Path, values: str, command: str) -> None:
    """Train or go on, and keep the run's progress file up to date.

    Raises
    ------
    RunDirectoryError
        If the directory holds a run of another configuration.
    """
    config, parent = config_of(json.loads(values)), os.getppid()

    def report(told: Progress) -> None:
        if os.getppid() != parent:
            raise KeyboardInterrupt  # the campaign is gone; the checkpoint stays
        partial = run / (PROGRESS + ".partial")
        partial.write_text(json.dumps(asdict(told)), encoding="utf-8")
        partial.replace(run / PROGRESS)

    with _alone(run):
        go_on(config, run, report=report, command=command)


if __name__ == "__main__":
    work(Path(sys.argv[1]), sys.stdin.read(), sys.argv[2])
