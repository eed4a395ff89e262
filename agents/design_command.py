"""The command ``shake design``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from agents.command_options import CommandOptions
from agents.options import ScenarioOptions
from baselines.tuned_values import read_tuned


@dataclass(frozen=True, kw_only=True)
class Design(CommandOptions):
    """Print the fidelity to expect of a scenario's controller, and the LQR of its table and specimen.

    What theory gives exactly is calculated: the linear table with its full state. Else the scenario's
    reference (LQG where signals are measured) is simulated, and the full-state LQR is named as a bound.

    Try:
      shake design
      shake design --scenario laboratory
      shake design --stories 4 --mass-ratio 0.3 --control-rate 200 --json
      shake design --acceleration-weight 1 --force-weight 0
    """

    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(default_factory=ScenarioOptions)
    earthquakes: int = 16
    """Number of earthquakes where the fidelity has to be simulated."""
    tuned: Path | None = None
    """File of tuned values that shake tune --keep wrote, for a scenario that nothing was tuned on."""

    def run(self, console: Console) -> dict[str, Any]:
        """Design and print."""
        from agents.design import design, print_design

        scenario = self.scenario.build()
        tuned = None if self.tuned is None else read_tuned(self.tuned)
        found = design(scenario, self.earthquakes, tuned, Console(stderr=True).print)
        print_design(found, scenario, console)
        return found
