"""The command ``shake benchmark``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from agents.cli.command_options import CommandOptions, print_notes, tuned_values
from agents.cli.output_path import require_writable
from agents.progress import progress_bar
from agents.reporting.terminal import print_markdown
from shake_env.errors import ParameterError
from shake_env.files import write_json
from shake_env.scenario.overrides import make_scenario
from shake_env.scenario.presets import NAMED


@dataclass(frozen=True, kw_only=True)
class Benchmark(CommandOptions):
    """Run every classical controller on every named scenario. Existing results are kept.

    A result is kept if it is of the same controllers and the same number of earthquakes. The results
    that docs/controllers.md shows are in docs/results.

    Try:
      shake benchmark --scenarios laboratory --earthquakes 20
      shake benchmark --controllers all controllers.py:MyController --results out/mine
      shake benchmark --results docs/results --page docs/controllers.md
    """

    scenarios: tuple[str, ...] = ("linear", "laboratory", "unknown-specimen", "yielding", "records")
    """Names of scenarios, or their files; the result of mine.toml is bench_mine.json. The page shows
    named ones alone."""
    controllers: tuple[str, ...] = ("oracle", "all")
    """Names as shake compare takes them; all: every classical controller that suits the scenario."""
    earthquakes: int = 200
    """Test earthquakes of each; `records` has its six."""
    tuned: Path | None = None
    """File of tuned values, made by shake tune --output, for controllers that nothing was tuned for."""
    results: Path = Path("out/bench")
    """Folder of the results, a JSON file each."""
    page: Path | None = None
    """Markdown page whose tables are renewed from all results."""
    rerun: bool = False
    """Whether existing results are replaced, those of other settings included."""

    def run(self, console: Console) -> dict[str, Any]:
        """Run what is not done, and say where it lies."""
        from agents.evaluation.benchmark import read_benchmarks, result_file, scenario_label
        from agents.evaluation.controller_set import require_names
        from agents.reporting.benchmark_tables import benchmark_markdown, put_tables

        require_names(self.controllers)
        if not self.scenarios:
            raise ParameterError("scenarios", self.scenarios, f"name at least one of {', '.join(NAMED)}")
        require_writable(self.results, "results")
        labels = [scenario_label(name) for name in self.scenarios]
        if len({*labels}) < len(labels):
            remedy = "two results would have one name: rename a file, or name each scenario once"
            raise ParameterError("scenarios", self.scenarios, remedy)
        known = {name: self._known(name) for name in self.scenarios}  # before hours are spent
        results = {}
        for name in self.scenarios:
            file = result_file(self.results, name)
            result = known[name]
            if result is not None:
                number = result["rows"][0]["earthquakes"]
                console.print(
                    f"{name}: read from {file}, made before with {number} earthquakes by version "
                    f"{result['version']} (--rerun runs it anew)",
                )
            else:
                result = self._run(name)
                write_json(file, result, indent=1)
                console.print(f"wrote {file}")
            results[name] = result
            print_markdown(console, benchmark_markdown(result))
            print_notes(result, console)
        if self.page is not None:
            put_tables(self.page, read_benchmarks(self.results))
            console.print(f"wrote {self.page}")
        return results

    def _known(self, name: str) -> dict[str, Any] | None:
        """Return the result that answers for a scenario; None where it has to be run.

        Raises
        ------
        ScenarioError
            If there is no such scenario, or a scenario file is none.
        FileError
            If its file is no complete result.
        ParameterError
            If it holds a result of other settings.
        """
        from agents.evaluation.benchmark import difference_of_result, read_benchmark, result_file

        make_scenario(name)  # before anything is run
        file = result_file(self.results, name)
        if self.rerun or not file.exists():
            return None
        known = read_benchmark(file)
        other = difference_of_result(known, name, self.earthquakes, self.controllers, self.tuned)
        if other:
            remedy = f"{other}: give --rerun to replace it, or another folder by --results"
            raise ParameterError("results", str(file), remedy)
        return known

    def _run(self, name: str) -> dict[str, Any]:
        from agents.evaluation.benchmark import run_benchmark

        with progress_bar() as progress:
            task = progress.add_task(name, total=1.0)

            def on_progress(controller: str, share: float) -> None:
                progress.update(task, completed=share, description=f"{name}, {controller}")

            tuned = tuned_values(self.tuned)
            return run_benchmark(
                name, self.earthquakes, self.controllers, tuned, on_progress=on_progress
            )
