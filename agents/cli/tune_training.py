"""The command ``shake tune-training``."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console
from rich.progress import TextColumn

from agents.cli.command_options import CommandOptions
from agents.cli.output_path import require_storage, require_writable, require_writable_file
from agents.execution.options import ExecutionOptions
from agents.progress import display, progress_bar
from shake_env.errors import ParameterError

if TYPE_CHECKING:  # the rest of the command line starts without torch
    from agents.experiments.search import SearchProgress
    from agents.experiments.search_space import Search
    from agents.experiments.search_trace import Trace


@dataclass(frozen=True, kw_only=True)
class TuneTraining(CommandOptions):
    """Search an experiment's training configuration by short runs; resumes an earlier search.

    Try:
      shake tune-training linear/ppo --minutes 60
      shake tune-training laboratory/apg --step-fraction 0.5 --trials 30 --processes 2
      shake tune-training linear/ppo --trials 0 --output docs/results/training_search_linear_ppo.json
      shake tune-training linear/ppo --trials 0 --page docs/training.md
    """

    experiment: tyro.conf.Positional[str]
    """SCENARIO/ALGORITHM, as shake run-experiments --dry-run lists them: the first trial."""
    step_fraction: float = 0.3
    """Share of the experiment's steps that a trial trains for."""
    trials: int = 40
    """Trials in all, those of before counted; 0: only --output and --page."""
    minutes: float | None = None
    """Wall time to search for (unset: no bound); the trial it ends in goes on another time."""
    seed: int = 0
    """Seed of the search; every trial trains with the same seed."""
    earthquakes: int = 64
    """Validation earthquakes that a trial is judged on."""
    storage: str = "runs/tune-training.db"
    """SQLite file with the trace of every search; a search in it is gone on with. Or a storage that
    several processes and machines work on: postgresql+pg8000://USER@HOST/NAME, grpc://HOST:PORT or
    journal:FILE."""
    folder: Path = Path("runs/tune-training")
    """Where the trials' runs lie; machines of a cluster must share it."""
    execution: Annotated[ExecutionOptions, tyro.conf.arg(name="")] = field(
        default_factory=ExecutionOptions
    )
    output: Path | None = None
    """JSON file for the trace, such as docs/results/training_search_linear_ppo.json."""
    page: Path | None = None
    """Markdown page whose searches, tables and figures, are renewed from all kept traces."""
    results: Path = Path("docs/results")
    """Folder of the kept traces that the page is made of."""

    def run(self, console: Console) -> dict[str, Any]:
        """Search with a progress bar, print what was found, keep it."""
        from agents.experiments.search import find_experiment
        from agents.experiments.search_space import Search
        from agents.experiments.search_trace import write_trace

        if self.output is not None and self.output.suffix != ".json":
            remedy = "must be a JSON file, such as docs/results/training_search_linear_ppo.json"
            raise ParameterError("output", str(self.output), remedy)
        if self.output is not None:
            require_writable_file(self.output, "output")
        require_storage(self.storage)
        require_writable(self.folder, "folder")
        search = Search(
            experiment=find_experiment(self.experiment),
            share=self.step_fraction,
            seed=self.seed,
            earthquakes=self.earthquakes,
        )
        try:
            trace = self._search(search)
        except KeyboardInterrupt:
            display.note("the same command goes on with the trials that were at work")
            raise
        _print(trace, console)
        if self.output is not None:
            write_trace(trace, self.output)
            console.print(f"wrote {self.output}")
        if self.page is not None:
            self._renew(self.page, console)
        return trace.to_json()

    def _search(self, search: Search) -> Trace:
        from agents.experiments.search import search_training

        with progress_bar(TextColumn("{task.fields[note]}")) as progress:
            whole = progress.add_task(search.experiment.name, total=max(1, self.trials), note="")
            bars: dict[int, Any] = {}  # of the trials at work
            shares: dict[int, float] = {}

            def on_update(now: SearchProgress) -> None:
                number, at = now.trial, now.progress
                note = f"{now.done} of {now.total} trials"
                if now.best is not None:
                    note += f", best {now.best:.4f}"
                if now.seconds_left is not None:
                    note += f", {math.ceil(now.seconds_left / 60.0)} min left"
                if at is None:
                    shares.pop(number, None)
                    if number in bars:
                        progress.remove_task(bars.pop(number))
                else:
                    shares[number] = at.steps / at.total_steps
                    if number not in bars:
                        bars[number] = progress.add_task(f"trial {number}", total=1.0, note="")
                    ratio = "" if at.cost_ratio is None else f"{at.cost_ratio:.4f}"
                    progress.update(bars[number], completed=shares[number], note=ratio)
                progress.update(whole, completed=now.done + sum(shares.values()), note=note)

            return search_training(
                search,
                self.storage,
                self.folder,
                trials=self.trials,
                minutes=self.minutes,
                on_update=on_update,
                open_workers=self.execution.open_workers,
            )

    def _renew(self, page: Path, console: Console) -> None:
        from agents.experiments.search_figure import search_figure
        from agents.experiments.search_trace import put_searches, read_traces

        traces = read_traces(self.results)
        put_searches(page, traces)
        for trace in traces:
            if trace.judged:
                console.print(f"wrote {search_figure(trace, page.parent / 'figures')}")
        console.print(f"wrote {page}: {', '.join(t.experiment for t in traces) or 'no search'}")


def _print(trace: Trace, console: Console) -> None:
    states = [row.state for row in trace.trials]
    counts = ", ".join(f"{states.count(state)} {state}" for state in sorted(set(states)))
    console.print(
        f"{trace.experiment}: {len(states)} trials ({counts or 'none'}) of {trace.steps:,} steps"
    )
    for name, row in (("the experiment", trace.start), ("best", trace.best)):
        if row is not None:
            console.print(
                f"{name}, trial {row.number}: {row.cost:.4f} [{row.low:.4f}, {row.high:.4f}] of "
                f"{trace.reference}'s cost, {row.lost} of {trace.earthquakes} tables lost"
            )
    if trace.best is not None:
        for name, value in trace.best.values.items():
            console.print(f"  {name} = {value} (experiment: {trace.own[name]})", highlight=False)
