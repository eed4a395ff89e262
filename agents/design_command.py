"""The command ``shake design``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import tyro
from rich.console import Console

from agents.command_options import CommandOptions
from agents.options import ScenarioOptions


@dataclass(frozen=True, kw_only=True)
class Design(CommandOptions):
    """Design the sampled-data LQR of a specimen and print the fidelity to expect of it.

    Try:
      shake design
      shake design --stories 4 --mass-ratio 0.3 --control-rate 200 --json
      shake design --acceleration-weight 1 --force-weight 0
    """

    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(default_factory=ScenarioOptions)

    def run(self, console: Console) -> dict[str, Any]:
        """Design and print."""
        from agents.design import design, print_design

        scenario = self.scenario.build()
        found = design(scenario)
        print_design(found, scenario, console)
        return found
