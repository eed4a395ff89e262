"""The command ``shake validate-transients``."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import tyro
from rich.console import Console

from agents.cli.command_options import FolderOptions
from agents.progress import display
from agents.scenario_options import ScenarioOptions
from shake_env.errors import ParameterError
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.scenario.observation import Sensing
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uncertainty


def linear_part(scenario: Scenario) -> Scenario:
    """Return what balanced truncation and Lyapunov solutions can be asked about."""
    return replace(
        scenario,
        nonlinearity=Nonlinearity(),
        uncertainty=Uncertainty(),
        sensing=Sensing(),
        delay=0.0,
    )


@dataclass(frozen=True, kw_only=True)
class ValidateTransients(FolderOptions):
    """Simulate the closed loop on records and noise, check every range, and reduce it.

    Try:
      shake validate-transients
      shake validate-transients --amplitude 0.4 --output out/mine
      shake validate-transients --stories 10 --num-noise-motions 0 --json > validation.json
    """

    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(default_factory=ScenarioOptions)
    num_noise_motions: int = 3
    """Filtered-noise motions of each kind (as in the paper, and high-passed with an envelope)."""

    def run(self, console: Console) -> dict[str, Any]:
        """Validate, and say what is being done."""
        from agents.studies.validation.run import validate
        from agents.studies.validation.tables import print_validation

        if self.num_noise_motions < 0:
            raise ParameterError("num_noise_motions", self.num_noise_motions, "must be at least 0")
        scenario = self.scenario.build()
        folder = self.results_folder("validation")
        linear = linear_part(scenario)
        if linear != scenario:
            display.note("validated: the linear part of the scenario, fully seen, without delay")
        validation: dict[str, Any] = validate(
            linear, folder, progress=display.note, noise=self.num_noise_motions
        )
        print_validation(validation, console)
        if folder is not None:
            console.print(f"wrote {folder}")
        return validation
