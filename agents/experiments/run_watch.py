"""What a worker tells of a run: how far it is, and the lines of its log."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from agents.plain_values import typed
from agents.progress import Progress, display
from agents.run_directory import PROGRESS, read_json
from shake_env.files import file_errors

LARGEST = 2**20  # [byte] of a progress file


def log_of(run: str | PathLike[str]) -> Path:
    """Return the file of what a run's worker prints."""
    run = Path(run)
    return run.with_name(run.name + ".log")


class RunWatch:
    """Reads what the worker of a run writes.

    Parameters
    ----------
    name
        Of the run, before each line of its log.
    run
        Its directory.
    """

    def __init__(self, name: str, run: Path) -> None:
        self.name, self.run = name, run
        self._shown = 0  # [byte] of the log

    def begin(self) -> None:
        """Delete what the worker before has written, of an earlier attempt too."""
        self._shown = 0
        for file in (self.run / PROGRESS, log_of(self.run)):
            with file_errors(file):
                file.unlink(missing_ok=True)

    @property
    def begun(self) -> bool:
        """Whether a worker is at it."""
        return log_of(self.run).exists()

    def look(self) -> Progress | None:
        """Print the new lines of the log; return how far the run is, None if that is not known yet.

        Raises
        ------
        FileError
            If the log cannot be read.
        """
        if not self.begun:
            return None
        log = log_of(self.run)
        with file_errors(log), log.open("rb") as file:
            file.seek(self._shown)
            text = file.read().rpartition(b"\n")[0]
        self._shown += len(text) + bool(text)
        for line in text.decode(errors="replace").splitlines():
            display.note(f"{self.name}: {line}")
        try:
            return typed(Progress, read_json(self.run / PROGRESS, largest=LARGEST))
        except ValueError:  # there is none yet
            return None
