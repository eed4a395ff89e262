"""The command ``shake show-scenario``: a scenario field by field, by the paths that ``--set`` takes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.markup import escape

from agents.cli.command_options import CommandOptions
from agents.reporting.terminal import print_table
from agents.scenario_options import ScenarioOptions
from shake_env import SCENARIO_NAMES, make_scenario
from shake_env.scenario.scenario_file import flattened, scenario_fields


@dataclass(frozen=True, kw_only=True)
class ShowScenario(CommandOptions):
    """Print every field of a scenario, by the path that --set takes, and what an observation holds.

    What --json prints is a scenario file: every --scenario and `make_scenario` take its path.

    Try:
      shake show-scenario
      shake show-scenario --scenario laboratory
      shake show-scenario --scenario laboratory --set sensing.preview=0.2 --json > mine.json
      shake compare --scenario mine.json
    """

    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(default_factory=ScenarioOptions)

    def run(self, console: Console) -> dict[str, Any]:
        """Print the fields of the scenario, and how they differ from the linear one's."""
        scenario = self.scenario.build()
        values, usual = dict(flattened(scenario)), dict(flattened(make_scenario("linear")))
        rows = [
            (path, f"{value:.6g}" if isinstance(value, float) else str(value))
            for path, value in values.items()
        ]
        other = [path not in usual or usual[path] != value for path, value in values.items()]
        title = f"{scenario.name} (bold: other than in linear)"
        print_table(console, ("field", "value"), rows, title=title, left=(1,), fold=1, bold=other)
        names = scenario.observation.names
        console.print(f"Observation, {len(names)} entries:")
        for index, name in enumerate(names):
            console.print(escape(f"  {index:3d} {name}"), highlight=False)
        console.print(f"Scenarios: {', '.join(SCENARIO_NAMES)}.")
        return {
            "name": scenario.name,
            "fields": scenario_fields(scenario),
            "observation": list(names),
            "scenarios": list(SCENARIO_NAMES),
        }
