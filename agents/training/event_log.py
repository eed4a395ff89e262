"""The tensorboard log of a run, whose write errors are raised once and name the folder."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path

from stable_baselines3.common.logger import Logger, configure

from shake_env.files import file_errors


@contextmanager
def event_log(folder: str | PathLike[str]) -> Iterator[Logger]:
    """Give an SB3 logger that writes tensorboard events into a folder, and close it.

    tensorboard writes in a thread of its own. An error there ends the thread with a traceback on
    standard error, although the next call raises the same error. Here it is raised without that
    traceback, at the latest when the log is closed.

    Raises
    ------
    FileError
        If an event could not be written.
    """
    report = threading.excepthook
    failures: list[OSError] = []

    def keep(args: threading.ExceptHookArgs) -> None:
        if isinstance(args.exc_value, OSError) and type(args.thread).__module__.startswith(
            "tensorboard"
        ):
            failures.append(args.exc_value)
        else:
            report(args)

    threading.excepthook = keep
    try:
        with file_errors(Path(folder)):
            logger = configure(str(folder), ["tensorboard"])
            try:
                yield logger
            finally:
                logger.close()
            if failures:  # nothing was written since
                raise failures[0]
    finally:
        threading.excepthook = report
