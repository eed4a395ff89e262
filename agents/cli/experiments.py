"""The commands ``shake run-experiments`` and ``shake update-docs``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.progress import TextColumn

from agents.cli.command_options import CommandOptions
from agents.cli.output_path import require_writable
from agents.execution.executor import Executor
from agents.execution.options import ExecutionOptions
from agents.execution.units import UnitRunner
from agents.progress import progress_bar
from agents.reporting.terminal import print_table
from shake_env.errors import ParameterError, ShakeError
from shake_env.files import no_file


@dataclass(frozen=True, kw_only=True)
class RunExperiments(CommandOptions):
    """Train every experiment with every seed and evaluate the policies; resume an interrupted campaign.

    Try:
      shake run-experiments --dry-run
      shake run-experiments --experiments linear/ppo linear/sac --seeds 2
      shake run-experiments --experiments 'laboratory/*' --processes 4
      shake run-experiments --results docs/results
    """

    experiments: tuple[str, ...] = ()
    """Experiments as SCENARIO/ALGORITHM, or patterns such as linear/*; none: all."""
    seeds: int | None = None
    """Seeds of each experiment (unset: as many as it asks for)."""
    execution: Annotated[ExecutionOptions, tyro.conf.arg(name="")] = field(
        default_factory=ExecutionOptions
    )
    folder: Path = Path("runs/campaign")
    """Where runs lie, as SCENARIO/ALGORITHM/SEED; machines of a cluster must share it."""
    results: Path = Path("out/campaign")
    """Folder of the results, a JSON file for each scenario (the documentation's: docs/results)."""
    evaluate: bool = True
    """Whether the scenarios of these experiments are evaluated when their runs are done."""
    rerun: bool = False
    """Whether all rows are evaluated again, not only those of new policies."""
    any_code: bool = False
    """Whether runs count that other code, or other versions of the libraries, made or began; without it
    they are named as failures, and neither gone on with nor evaluated."""
    dry_run: bool = False
    """Print what would be run, with the minutes expected, and do nothing."""

    def run(self, console: Console) -> dict[str, Any]:
        """Run, evaluate, and say what failed."""
        from agents.experiments.catalogue import EXPERIMENTS
        from agents.experiments.runner import Campaign, plan_rows, plan_runs

        if self.seeds is not None and self.seeds < 1:
            raise ParameterError("seeds", self.seeds, "must be at least 1")
        tasks = plan_runs(EXPERIMENTS, self.folder, self.experiments, self.seeds, self.any_code)
        campaign = Campaign(tasks, self.execution.processes or 2)
        if self.dry_run:
            rows = plan_rows(tasks)
            minutes = campaign.seconds_left() / 60.0
            _print_plan(rows, minutes, campaign.workers, console)
            refused = campaign.failures()
            for name, reason in refused.items():
                console.print(f"would be refused: {name}: {reason}", highlight=False)
            return {"plan": rows, "minutes_left": minutes, "refused": refused}
        require_writable(self.folder, "folder")
        if self.evaluate:
            require_writable(self.results, "results")
        with self.execution.open_executor() as executor:
            _train(campaign, executor, console)
            failures = dict(campaign.failures())
            runner = UnitRunner(executor, self.execution.folder)
            written = self._evaluate(tasks, failures, runner, console) if self.evaluate else []
        runner.forget()
        for name, failure in failures.items():
            console.print(f"failed: {name}: {failure}", highlight=False)
        return {"runs": campaign.counts(), "failures": failures, "results": written}

    def exit_code(self, result: dict[str, Any]) -> int:
        """Return 1 if a run or an evaluation failed."""
        return 1 if result.get("failures") else 0

    def _evaluate(
        self, tasks: list[Any], failures: dict[str, str], runner: UnitRunner, console: Console
    ) -> list[str]:
        from agents.experiments.evaluation_tasks import EVALUATION_TASKS
        from agents.experiments.results import evaluate_task

        trained = {run.experiment.evaluation_task for run in tasks}
        foreign = {run.experiment.evaluation_task for run in tasks if run.state == "foreign"}
        written = []
        for task in EVALUATION_TASKS:
            runs = task.trained_on or task.name
            if runs not in trained:
                continue
            if runs in foreign:  # whose policies would be evaluated with this campaign's
                failures[f"evaluation of {task.name}"] = "waits for the runs that were refused"
                continue
            try:
                with progress_bar() as progress:
                    bar = progress.add_task(f"evaluating {task.name}", total=1.0)

                    def show_share(name: str, share: float, bar: Any = bar, task: Any = task) -> None:
                        text = f"evaluating {task.name}, {name}"
                        progress.update(bar, completed=share, description=text)

                    file, _, made = evaluate_task(
                        task,
                        self.folder,
                        self.results,
                        again=self.rerun,
                        runner=runner,
                        on_progress=show_share,
                    )
            except ShakeError as error:
                failures[f"evaluation of {task.name}"] = str(error)
                continue
            console.print(f"wrote {file}" if made else f"{task.name}: evaluated before, {file}")
            written.append(str(file))
        return written


def _train(campaign: Any, executor: Executor, console: Console) -> None:
    columns = (TextColumn("{task.fields[note]}"),)
    with progress_bar(*columns) as progress:
        total = progress.add_task("campaign", total=len(campaign.tasks), note="")
        bars: dict[str, Any] = {}

        def on_update(campaign: Any) -> None:
            counts = campaign.counts()
            minutes = campaign.seconds_left() / 60.0
            note = f"{counts.get('done', 0)} of {len(campaign.tasks)} runs, {minutes:.0f} min left"
            if failed := counts.get("failed", 0):
                note += f", {failed} failed"
            share = sum(1.0 if t.state in ("failed", "foreign") else t.share for t in campaign.tasks)
            progress.update(total, completed=share, note=note)
            for task in campaign.tasks:
                if task.state == "running":
                    if task.name not in bars:
                        bars[task.name] = progress.add_task(task.name, total=1.0, note="")
                    ratio = "" if task.cost_ratio is None else f"cost ratio {task.cost_ratio:.3f}"
                    progress.update(bars[task.name], completed=task.share, note=ratio)
                elif task.name in bars:
                    progress.remove_task(bars.pop(task.name))
                    console.print(f"{task.name}: {task.state}", highlight=False)

        on_update(campaign)
        campaign.run(executor, on_update)


def _print_plan(rows: list[dict[str, Any]], minutes: float, processes: int, console: Console) -> None:
    headings = ("experiment", "runs", "done", "steps", "minutes\nleft", "deviates by")
    cells = [
        (
            row["experiment"], str(row["runs"]), str(row["done"]), f"{row['steps']:,}",
            f"{row['minutes_left']:.0f}", row["why"],
        )
        for row in rows
    ]  # fmt: skip
    print_table(console, headings, cells, left=(5,), fold=5)
    console.print(f"{minutes:.0f} minutes left with {processes} at a time, then the evaluations")


@dataclass(frozen=True, kw_only=True)
class UpdateDocs(CommandOptions):
    """Print result files as Markdown tables, or renew the tables of a page.

    Try:
      shake update-docs
      shake update-docs --results out/evaluate --page out/results.md
      shake update-docs --results docs/results --page docs/results.md
    """

    results: Path = Path("out/campaign")
    """Folder of the results (those of the documentation: docs/results)."""
    page: Path | None = None
    """Markdown page to renew; a table stands between <!-- evaluation NAME --> and <!-- end NAME -->.
    Unset: the tables are printed, and no file is written."""

    def run(self, console: Console) -> dict[str, Any]:
        """Print the tables; or write the page, and say what has no place on it."""
        from agents.evaluation.result_files import read_results
        from agents.reporting.evaluation_tables import evaluation_markdown, put_tables
        from agents.reporting.terminal import print_markdown

        if self.page is not None and not self.page.is_file():
            raise ParameterError("page", str(self.page), no_file(self.page))
        results = read_results(self.results)
        if not results:
            raise ParameterError("results", str(self.results), "holds no evaluation_*.json")
        if self.page is None:
            for name, result in results.items():
                console.print(f"{name}\n", highlight=False)
                print_markdown(console, evaluation_markdown(result))
            return {"page": None, "tables": list(results), "without_place": []}
        missing = put_tables(self.page, results)
        console.print(
            f"wrote {self.page}: {', '.join(n for n in results if n not in missing) or 'no'} table"
        )
        for name in missing:
            console.print(f"no place for {name}: the page lacks <!-- evaluation {name} -->")
        return {"page": str(self.page), "tables": list(results), "without_place": missing}
