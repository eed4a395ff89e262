"""The command ``shake evaluate``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from agents.cli.command_options import CommandOptions, print_notes, tuned_values
from agents.cli.output_path import output_file
from agents.execution.options import ExecutionOptions
from agents.motions.channels import MotionOptions
from agents.motions.motion_set import read_motion_set
from agents.plain_values import plain
from agents.progress import progress_by_name
from agents.reporting.terminal import print_markdown
from agents.scenario_options import ScenarioOptions, given_options


@dataclass(frozen=True, kw_only=True)
class Evaluate(CommandOptions):
    """Evaluate policies and controllers on test earthquakes, by the protocol of docs/protocol.md.

    Try:
      shake evaluate runs/mine
      shake evaluate ppo=runs/ppo-0,runs/ppo-1,runs/ppo-2 lqr none --output out/linear.json
      shake evaluate runs/campaign/laboratory/apg lqg-dac --scenario laboratory
      shake evaluate ppo apg --earthquakes 1000 --json
    """

    entries: tyro.conf.Positional[tuple[str, ...]]
    """Names of controllers, policy files, run directories, or folders of run directories (its seeds as
    one row); NAME=PATH,PATH names a row and puts several paths into it; module:Class or file.py:Class
    is a controller of one's own."""
    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(default_factory=ScenarioOptions)
    earthquakes: int = 200
    """Number of test earthquakes, each with its own specimen where the scenario draws one; `records` has
    its six."""
    tuned: Path | None = None
    """File of tuned values that shake tune --output wrote, for a scenario that nothing was tuned on."""
    motion_set: Path | None = None
    """Folder of a named test set of one's own records, described in its motions.toml, in place of the
    test earthquakes; costs are given by event as well."""
    motion_options: Annotated[MotionOptions, tyro.conf.arg(name="motion")] = field(
        default_factory=MotionOptions
    )
    execution: Annotated[ExecutionOptions, tyro.conf.arg(name="")] = field(
        default_factory=ExecutionOptions
    )
    fidelity: bool = True
    """Whether response spectrum, drift and energy are compared, too."""
    output: Path | None = None
    """JSON file of the result, replaced if it is there (default: the next free one of
    out/evaluate/SCENARIO.json, SCENARIO-2.json, ...; with --json: none)."""

    def run(self, console: Console) -> dict[str, Any]:
        """Evaluate, print, write."""
        from agents.evaluation.controller_set import require_names
        from agents.evaluation.entries import find_entry
        from agents.evaluation.protocol import evaluate
        from agents.evaluation.result_files import write_result
        from agents.reporting.evaluation_tables import evaluation_markdown

        require_names(self.entries)
        scenario = self.scenario.build()
        chosen = None if self.motion_set is None else read_motion_set(self.motion_set)
        motions, events = (
            ([], [])
            if chosen is None
            else chosen.earthquakes(self.motion_options, scenario, scale=True, console=console)
        )
        tuned = tuned_values(self.tuned)
        file = None
        if self.output is not None or not self.json:
            file = output_file(self.output, Path("out/evaluate") / f"{scenario.name}.json")
        with self.execution.open_runner() as runner, progress_by_name() as on_progress:
            result = evaluate(
                scenario,
                [find_entry(text, scenario) for text in self.entries],
                earthquakes=self.earthquakes,
                repeats=self.fidelity,
                tuned=tuned,
                motions=motions,
                events=events,
                runner=runner,
                on_progress=on_progress,
            )
        if chosen is not None:
            result["motion_set"] = chosen.to_json()
        result["scenario_options"] = given_options(plain(self.scenario.__dict__))
        print_markdown(console, evaluation_markdown(result))
        print_notes(result, console)
        if file is not None:
            write_result(result, file)
            console.print(f"wrote {file}")
        return result
