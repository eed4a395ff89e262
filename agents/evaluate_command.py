"""The command ``shake evaluate``."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from agents.options import ScenarioOptions, given_options
from agents.progress import progress_bar
from agents.run_directory import require_writable


@dataclass(frozen=True, kw_only=True)
class Evaluate:
    """Put policies and controllers through the protocol of docs/protocol.md, on test earthquakes.

    Try:
      shake evaluate runs/mine
      shake evaluate ppo=runs/ppo-0,runs/ppo-1,runs/ppo-2 lqr none --output out/linear.json
      shake evaluate runs/campaign/laboratory/analytic lqg-accommodating --scenario laboratory
      shake evaluate policy analytic --earthquakes 1000 --json
    """

    entries: tyro.conf.Positional[tuple[str, ...]]
    """Names of controllers, policy files, run directories, or folders of run directories (its seeds as
    one row); NAME=PATH,PATH names a row and puts several paths into it."""
    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(default_factory=ScenarioOptions)
    earthquakes: int = 200
    """Number of test earthquakes, each with its own specimen where the scenario draws one; `records` has
    its six."""
    fidelity: bool = True
    """Whether response spectrum, drift and energy are compared, too."""
    output: Path | None = None
    """JSON file of the result (default: out/evaluate/SCENARIO.json; with --json: none)."""
    json: bool = False
    """Print one JSON object on standard output and nothing else there."""

    def run(self, console: Console) -> dict[str, Any]:
        """Evaluate, print, write."""
        from agents.evaluate import contestant, evaluate
        from agents.result_tables import markdown, write_result

        scenario = self.scenario.build()
        file = self.output or (None if self.json else Path("out/evaluate") / f"{scenario.name}.json")
        if file is not None:
            require_writable(file.parent)
        with progress_bar() as progress:
            tasks: dict[str, Any] = {}

            def on_progress(name: str, share: float) -> None:
                if name not in tasks:
                    tasks[name] = progress.add_task(name, total=1.0)
                progress.update(tasks[name], completed=share)

            result = evaluate(
                scenario,
                [contestant(text, scenario) for text in self.entries],
                earthquakes=self.earthquakes,
                repeats=self.fidelity,
                on_progress=on_progress,
            )
        given: dict[str, Any] = json.loads(json.dumps(self.scenario.__dict__))
        result["scenario_options"] = given_options(given)
        console.print(markdown(result), highlight=False, soft_wrap=True)
        if file is not None:
            write_result(result, file)
            console.print(f"wrote {file}")
        return result
