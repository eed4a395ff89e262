"""The command ``shake scenario``: a scenario field by field, by the paths that ``--set`` takes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Annotated, Any

import tyro
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from agents.options import ScenarioOptions
from shake_env import SCENARIO_NAMES
from shake_env.records import Record
from shake_env.sensing import Sensor


@dataclass(frozen=True, kw_only=True)
class ShowScenario:
    """Print every field of a scenario, by the path that --set takes, and what an observation holds.

    Try:
      shake scenario
      shake scenario --scenario laboratory
      shake scenario --scenario laboratory --set sensing.preview=0.2 --json
    """

    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(default_factory=ScenarioOptions)
    json: bool = False
    """Print one JSON object on standard output and nothing else there."""

    def run(self, console: Console) -> dict[str, Any]:
        """Print the fields of the scenario, and how they differ from the linear one's."""
        scenario = self.scenario.build()
        values, usual = dict(flattened(scenario)), dict(flattened(ScenarioOptions().build()))
        table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), title_justify="left")
        table.title = f"{scenario.name} (bold: other than in linear)"
        for heading in ("field", "value"):
            table.add_column(heading, overflow="fold")
        for path, value in values.items():
            style = "" if path in usual and usual[path] == value else "bold"
            shown = f"{value:.6g}" if isinstance(value, float) else str(value)
            table.add_row(escape(path), escape(shown), style=style)
        console.print(table)
        names = scenario.observation.names
        console.print(f"Observation, {len(names)} entries:")
        for index, name in enumerate(names):
            console.print(escape(f"  {index:3d} {name}"), highlight=False)
        console.print(f"Scenarios: {', '.join(SCENARIO_NAMES)}.")
        return {
            "name": scenario.name,
            "fields": values,
            "observation": list(names),
            "scenarios": list(SCENARIO_NAMES),
        }


def flattened(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield path and plain value of every field of a frozen value; infinite numbers as words."""
    if isinstance(value, Record):
        yield path, value.name
    elif is_dataclass(value) and not isinstance(value, type):
        for item in fields(value):
            yield from flattened(getattr(value, item.name), f"{path}.{item.name}".lstrip("."))
    elif isinstance(value, tuple) and value and all(isinstance(item, Sensor) for item in value):
        for sensor in value:
            yield from flattened(sensor, f"{path}.{sensor.signal}")
    elif isinstance(value, tuple) and value and is_dataclass(value[0]):
        for number, item in enumerate(value):
            yield from flattened(item, f"{path}[{number}]")
    elif isinstance(value, float) and not math.isfinite(value):
        yield path, str(value)
    else:
        yield path, list(value) if isinstance(value, tuple) else value
