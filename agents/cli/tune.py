"""The command ``shake tune``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console

from agents.cli.command_options import CommandOptions
from agents.cli.output_path import require_storage, require_writable_file
from agents.execution.options import ExecutionOptions
from agents.progress import progress_bar, progress_by_name
from agents.scenario_options import ScenarioOptions
from shake_env.scenario.scenario import Scenario

if TYPE_CHECKING:
    from agents.experiments.controller_tuning import TuningResult

ALL = "all"


@dataclass(frozen=True, kw_only=True)
class Tune(CommandOptions):
    """Search a controller's free parameters on validation earthquakes; resumes an earlier search.

    Try:
      shake tune lqg --scenario laboratory
      shake tune pid --scenario laboratory --budget 1000000 --processes 2
      shake tune lqg --scenario laboratory --set actuator.table_mass=420 --output mytable.json
      shake compare --scenario laboratory --set actuator.table_mass=420 --tuned mytable.json
      shake tune controllers.py:MyController --output mine.json
    """

    controller: tyro.conf.Positional[str]
    """Name of the controller, module:Class or file.py:Class for one of one's own, or all: every one that
    has something to tune and suits the scenario."""
    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(default_factory=ScenarioOptions)
    budget: int = 4_000_000
    """Control periods to simulate in all; what a policy is trained with by default."""
    earthquakes: int = 16
    """Validation earthquakes of a trial."""
    seed: int = 0
    """Seed of the search."""
    storage: str = "runs/tune.db"
    """SQLite file with the trace of every search; a search in it is gone on with. Or a storage that
    several processes and machines work on: postgresql+pg8000://USER@HOST/NAME, grpc://HOST:PORT or
    journal:FILE."""
    execution: Annotated[ExecutionOptions, tyro.conf.arg(name="")] = field(
        default_factory=ExecutionOptions
    )
    output: Path | None = None
    """JSON file to put the result in, which compare, benchmark, evaluate and robustness take by --tuned.
    The result belongs to this very scenario, identified by a digest of it."""

    def run(self, console: Console) -> dict[str, Any]:
        """Search with a progress bar, and print what was found."""
        scenario = self.scenario.build()
        from agents.experiments.controller_tuning import kept_values

        if self.output is not None:
            require_writable_file(self.output, "output")
        require_storage(self.storage)
        kept_values(self.output)  # says before the search if it is another kind of file
        if self.controller != ALL:
            return self._tune(self.controller, scenario, console)

        return self._tune_all(scenario, console)

    @property
    def _search(self) -> dict[str, int]:
        return {"budget": self.budget, "earthquakes": self.earthquakes, "seed": self.seed}

    def _tune_all(self, scenario: Scenario, console: Console) -> dict[str, Any]:
        from agents.experiments.controller_tuning import keep_tuned_values, kept_values, tune_each
        from baselines.catalogue import BASELINES

        results: dict[str, Any] = {}
        with self.execution.open_runner() as runner, progress_by_name("tuning ") as on_progress:
            tunings = tune_each(
                [*BASELINES],
                scenario,
                self.storage,
                tuned=kept_values(self.output),
                runner=runner,
                on_progress=on_progress,
                **self._search,
            )
        for name, each in tunings.items():
            if isinstance(each, str):
                results[name] = {"left_out": each}
                console.print(f"[dim]{name} left out: {each}[/]")
                continue
            self._print(each, console)
            if self.output is not None:
                keep_tuned_values(each, self.output)
            results[name] = each.to_json()
        return results

    def _tune(self, name: str, scenario: Scenario, console: Console) -> dict[str, Any]:
        from agents.experiments.controller_tuning import keep_tuned_values, kept_values, tune

        with self.execution.open_workers() as executor, progress_bar() as progress:
            task = progress.add_task(f"tuning {name}", total=None)

            def on_trial(done: int, total: int, best: float) -> None:
                description = f"tuning {name}, best cost {best:.4g}"
                progress.update(task, completed=done, total=total, description=description)

            tuning = tune(
                name,
                scenario,
                self.storage,
                tuned=kept_values(self.output),
                on_trial=on_trial,
                executor=executor,
                **self._search,
            )
        self._print(tuning, console)
        if self.output is not None:
            keep_tuned_values(tuning, self.output)
            console.print(f"wrote {self.output}")
        return tuning.to_json()

    def _print(self, tuning: TuningResult, console: Console) -> None:
        console.print(
            f"{tuning.controller} on {tuning.scenario}: cost {tuning.cost:.4g} after {tuning.trials} "
            f"trials, {tuning.default_cost:.4g} by default"
        )
        for parameter, value in tuning.parameters.items():
            console.print(f"  {parameter} = {value:.6g}")
