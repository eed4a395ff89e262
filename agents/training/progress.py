"""Progress of a training run: in the terminal, and an example figure for tensorboard."""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import Self

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from agents.figure_style import tracking_figure
from agents.progress import Progress, display
from shake_env.simulation.trajectory import Trajectory

BARS = "▁▂▃▄▅▆▇█"
WIDTH = 40  # characters of the bar and, at most, of the evaluations
ENOUGH = 30.0  # [s] of training before a guess of the time left is worth anything


class TrainingView:
    """Shows a run's progress on standard error; call it with each `Progress`.

    Where standard error is no terminal it writes a line every few seconds, and the last state in full.
    A command with ``--quiet`` shows nothing.

    Parameters
    ----------
    title
        What is learned, in a few words.
    console
        Where it is shown; None: standard error.
    """

    def __init__(self, title: str, console: Console | None = None) -> None:
        self.title = title
        self._first: Progress | None = None
        self._pause = display.suspended()
        self._log = console is None and not display.console.is_terminal
        self._quiet = console is None and display.quiet
        self._live = Live(console=console or display.console, refresh_per_second=2)

    def __enter__(self) -> Self:
        self._pause.__enter__()
        if not self._quiet:
            self._live.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if not self._quiet:
            self._live.__exit__(kind, problem, trace)
        self._pause.__exit__(kind, problem, trace)

    def __call__(self, progress: Progress) -> None:
        """Show where the run stands."""
        if self._first is None:
            self._first = progress
        if self._log and display.due():
            ratio = (
                f", cost / {progress.reference} {progress.evaluations[-1]:.3f}"
                if progress.evaluations
                else ""
            )
            display.note(f"{self.title}: step {progress.steps} of {progress.total_steps}{ratio}")
        self._live.update(self.render(progress))

    def render(self, progress: Progress) -> Group:
        """Return what is shown for a `Progress`."""
        rows = Table.grid(padding=(0, 2))
        rows.add_column(style="bold")
        rows.add_column()
        bar = ProgressBar(progress.total_steps, progress.steps, width=WIDTH)
        share = min(1.0, progress.steps / progress.total_steps)
        rows.add_row(self.title, bar)
        rows.add_row("done", f"{100 * share:.0f} %, {self._time_left(progress)}")
        if progress.evaluations:
            last, best = progress.evaluations[-1], min(progress.evaluations)
            rows.add_row(
                f"cost / {progress.reference}",
                f"{last:.3f} now, {best:.3f} at best (1: as good; less: better)",
            )
            shown = progress.evaluations[-WIDTH:]
            rows.add_row("evaluations", f"{sparkline(shown)}  from {progress.evaluations[0]:.3g}")
        if progress.errors is not None:
            acceleration, shear = progress.errors
            rows.add_row(
                "errors",
                f"acceleration {100 * acceleration:.1f} %, base shear {100 * shear:.1f} % of target",
            )
        rows.add_row("that is", Text(curve_meaning(progress)))
        return Group(rows)

    def _time_left(self, progress: Progress) -> str:
        first = self._first or progress
        done, seconds = progress.steps - first.steps, progress.seconds - first.seconds
        if progress.steps >= progress.total_steps:
            return f"took {_duration(progress.seconds)}"
        if done <= 0 or (seconds < ENOUGH and done < 0.05 * progress.total_steps):
            return "time left: not known yet"
        return f"about {_duration((progress.total_steps - progress.steps) * seconds / done)} left"


def sparkline(values: Sequence[float]) -> str:
    """Return values as bars, tallest for the largest, on a logarithmic scale."""
    logs = np.log(np.maximum(np.asarray(values, dtype=float), 1e-12))
    low, high = float(np.min(logs)), float(np.max(logs))
    share = (logs - low) / (high - low) if high > low else np.zeros(len(logs))
    return "".join(BARS[round(float(each) * (len(BARS) - 1))] for each in share)


def curve_meaning(progress: Progress) -> str:
    """Return in words what a training run's evaluations say."""
    if not progress.evaluations:
        return "the untrained policy, about to be evaluated for the first time"
    last, best = progress.evaluations[-1], min(progress.evaluations)
    if last > 2.0 * best and len(progress.evaluations) > 2:
        return "worse than it was: it may recover; if it does not, lower the learning rate"
    if last > 3.0:
        return "hardly controlled yet, as is usual early on; wait for the evaluations to fall"
    if last > 1.1:
        return f"it works, and costs {100 * (last - 1.0):.0f} % more than the reference"
    if last >= 0.99:
        return "about as good as the reference: what is left to gain is small"
    return f"better than the reference by {100 * (1.0 - last):.1f} % of its cost"


def _duration(seconds: float) -> str:
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    if seconds < 5400.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"


def example_figure(trajectory: Trajectory, title: str) -> Figure:
    """Return `tracking_figure` of a policy, laid out once: tensorboard draws it in its own time."""
    figure = tracking_figure({"policy": trajectory}, title)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    return figure
