"""The command ``shake show-scenario``: a scenario field by field, by the paths that ``--set`` takes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.markup import escape

from agents.cli.command_options import CommandOptions, Flag
from agents.reporting.terminal import print_table
from agents.scenario_options import ScenarioOptions
from shake_env import SCENARIO_NAMES, make_scenario
from shake_env.errors import ParameterError
from shake_env.scenario.scenario_file import flattened, scenario_fields
from shake_env.scenario.scenario_writer import write_scenario


@dataclass(frozen=True, kw_only=True)
class ShowScenario(CommandOptions):
    """Print every field of a scenario, by the path that --set takes, and what an observation holds.

    --write makes a scenario file, whose path every --scenario and `make_scenario` take. They also take
    the output of --json, as a file whose name ends in .json.

    Try:
      shake show-scenario
      shake show-scenario laboratory
      shake show-scenario laboratory --set sensing.preview=0.2 --write mine.toml
      shake show-scenario laboratory --write mine.toml --parts
      shake show-scenario mine.toml --delay 3 --write mine.toml
    """

    name: tyro.conf.Positional[str | None] = None
    """The scenario, in place of --scenario: its name, or its file."""
    write: Path | None = None
    """Scenario file to write (.toml): complete, with the meaning of every field as a comment. One that
    is there already keeps its comments, and the values that differ are changed in it."""
    parts: Flag = False
    """Write table, specimen, sensors and test to a file each, which the file of --write includes."""
    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(default_factory=ScenarioOptions)

    def run(self, console: Console) -> dict[str, Any]:
        """Print the fields of the scenario, and how they differ from the linear one's."""
        options = self.scenario
        if self.name is not None:
            if options.scenario not in ("linear", self.name):
                raise ParameterError("scenario", options.scenario, f"contradicts {self.name}")
            options = replace(options, scenario=self.name)
        if self.parts and self.write is None:
            raise ParameterError("parts", self.parts, "says how a file is written: give --write FILE")
        scenario = options.build()
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
        written = [] if self.write is None else write_scenario(scenario, self.write, parts=self.parts)
        for path in written:
            console.print(escape(f"wrote {path}"))
        if self.write is not None and not written:
            console.print(escape(f"{self.write} holds this scenario already"))
        return {
            "name": scenario.name,
            "fields": scenario_fields(scenario),
            "observation": list(names),
            "scenarios": list(SCENARIO_NAMES),
        }
