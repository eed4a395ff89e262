"""What a command shows on standard error while it works, and where a training run stands."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from rich import progress
from rich.console import Console
from rich.progress import BarColumn, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

FIRST_LINE = 0.5  # [s] after which a log is told that a command works; a quick one leaves no line
NEXT_LINE = 5.0  # [s] between two lines of progress in a log, at least
STILL = 15.0  # [s] without a line after which a log is told that a command still works
LOGGERS = ("shake_env", "baselines", "agents")


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


class Display:
    """Standard error of a command.

    On a terminal a spinner with the time turns from the start, and progress bars take its place. In a
    log or a pipe a line says after half a second that the command works, and further lines how far it
    is. With ``quiet`` there is neither.
    """

    def __init__(self) -> None:
        self.console = Console(stderr=True)
        self.quiet = False
        self._title = ""
        self._spinner: progress.Progress | None = None
        self._suspensions = 0
        self._silent = False
        self._over = threading.Event()
        self._beat: threading.Thread | None = None
        self._began = self._last_line = 0.0

    def begin(self, title: str, *, quiet: bool = False, verbose: bool = False) -> None:
        """Show that a command works, and pass on what the packages log."""
        self.console = Console(stderr=True)
        self.quiet, self._title, self._suspensions = quiet, title, 0
        self._began = self._last_line = time.monotonic()
        level = logging.ERROR if quiet else logging.DEBUG if verbose else logging.INFO
        for name in LOGGERS:
            logger = logging.getLogger(name)
            logger.handlers = [_Notes(self)]
            logger.setLevel(level)
        if quiet:
            return
        if self.console.is_terminal:
            self._spinner = progress.Progress(
                SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn(),
                console=self.console, transient=True, redirect_stdout=False,
            )  # fmt: skip
            self._spinner.add_task(f"{title}: working", total=None)
            self._spinner.start()
        else:
            self._over = threading.Event()
            self._beat = threading.Thread(target=self._tell, name="shake-progress", daemon=True)
            self._beat.start()

    def end(self) -> None:
        """Take the spinner away, and say no more."""
        if self._spinner is not None:
            self._spinner.stop()
        self._over.set()
        if self._beat is not None:
            self._beat.join()
        for name in LOGGERS:
            logging.getLogger(name).handlers = []
        self._spinner = self._beat = None
        self.quiet = False

    @contextmanager
    def suspended(self) -> Iterator[None]:
        """Take the spinner away while something else writes to the terminal."""
        self._suspensions += 1
        if self._spinner is not None and self._suspensions == 1:
            self._spinner.stop()
        try:
            yield
        finally:
            self._suspensions -= 1
            if self._spinner is not None and self._suspensions == 0:
                self._spinner.start()

    @contextmanager
    def silenced(self, text: str) -> Iterator[None]:
        """Print a line and then nothing, for work that must keep to the clock."""
        self.note(text)
        self._silent = True
        try:
            with self.suspended():
                yield
        finally:
            self._silent = False

    def note(self, text: str) -> None:
        """Print a line that stays."""
        if not self.quiet:
            self.console.print(text, markup=False, highlight=False, soft_wrap=True)
            self._last_line = time.monotonic()

    def due(self) -> bool:
        """Return whether progress may be logged again."""
        return time.monotonic() - self._last_line >= NEXT_LINE or self._last_line == self._began

    def _tell(self) -> None:
        wait = FIRST_LINE
        while not self._over.wait(wait):
            wait, now = 1.0, time.monotonic()
            if self._silent:
                continue
            if self._last_line == self._began:
                self.note(f"{self._title}: working")
            elif now - self._last_line >= STILL:
                self.note(f"{self._title}: still working after {now - self._began:.0f} s")


display = Display()


class _Notes(logging.Handler):
    """What the packages log, as lines on standard error."""

    def __init__(self, shown: Display) -> None:
        super().__init__()
        self._display = shown

    def emit(self, record: logging.LogRecord) -> None:
        self._display.note(record.getMessage())


class _Bars(progress.Progress):
    """Bars on a terminal; the first says that a command prepares, until there is another."""

    _preparing: TaskID | None = None

    def __enter__(self) -> _Bars:
        super().__enter__()
        self._preparing = super().add_task("preparing", total=None, note="")
        return self

    def add_task(self, description: str, *arguments: Any, **options: Any) -> TaskID:
        if self._preparing is not None:
            self.remove_task(self._preparing)
            self._preparing = None
        return super().add_task(description, *arguments, **options)


class _Lines(progress.Progress):
    """The same for a log: a line every few seconds."""

    def update(self, task_id: TaskID, *arguments: Any, **options: Any) -> None:
        super().update(task_id, *arguments, **options)
        task = self._tasks[task_id]
        if display.due():
            share = "" if task.total is None else f" {task.percentage:.0f} %"
            display.note(f"{task.description}{share} {task.fields.get('note', '')}".rstrip())


@contextmanager
def progress_bar(*columns: Any) -> Iterator[progress.Progress]:
    """Show progress bars on standard error: on a terminal as such, in a log as lines now and then.

    Parameters
    ----------
    columns
        Further columns of the bars, after name, bar, share and time; ``task.fields["note"]`` is shown
        in a log, too.
    """
    shown = (
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(), *columns,
    )  # fmt: skip
    with display.suspended():
        if display.quiet or not display.console.is_terminal:
            yield (progress.Progress if display.quiet else _Lines)(disable=True)
            return
        # What is printed meanwhile goes above the bars, unless it goes elsewhere.
        with _Bars(*shown, console=display.console, redirect_stdout=Console().is_terminal) as bars:
            yield bars


@contextmanager
def progress_by_name(prefix: str = "") -> Iterator[Callable[[str, float], None]]:
    """Show a bar for each name that is reported; yield what takes a name and the share done of it."""
    with progress_bar() as bars:
        tasks: dict[str, TaskID] = {}

        def report(name: str, share: float) -> None:
            if name not in tasks:
                tasks[name] = bars.add_task(prefix + name, total=1.0)
            bars.update(tasks[name], completed=share)

        yield report
