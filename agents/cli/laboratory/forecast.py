"""The command ``shake forecast``."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.markup import escape

from agents.cli.command_options import FolderOptions
from agents.execution.options import ExecutionOptions
from agents.motions.channels import MotionOptions, motion_earthquakes
from agents.progress import progress_by_name
from agents.reporting.terminal import print_table
from agents.scenario_options import ScenarioOptions
from agents.seeds import FORECAST_SEED
from shake_env.errors import ParameterError


@dataclass(frozen=True, kw_only=True)
class ForecastCommand(FolderOptions):
    """Forecast a test before it: errors, peaks and limits of each controller and amplitude.

    The scenario's uncertainty is the belief: `[uncertainty.posterior]` names what shake identify wrote,
    and without it the ranges of its parameters hold. Writes forecast.html, its figure and forecast.json.

    Try:
      shake forecast test.toml --controllers lqg ilc
      shake forecast test.toml --motion record.at2 --controllers lqg tvc mine.safetensors
      shake forecast test.toml --amplitudes 0.25 0.5 0.75 1 --required-probability 0.99
    """

    scenario: tyro.conf.Positional[str]
    """File of the test, or name of a scenario with an uncertainty."""
    posterior: Path | None = None
    """posterior.json of shake identify, in place of the scenario's own uncertainty."""
    motion: Path | None = None
    """File of recorded motion (default: the scenario's own motion)."""
    scale: bool = True
    """Whether the amplitude of a file is brought within the table first."""
    motion_options: Annotated[MotionOptions, tyro.conf.arg(name="motion")] = field(
        default_factory=MotionOptions
    )
    controllers: tuple[str, ...] = ("lqg",)
    """Names of controllers, and paths of policy files."""
    amplitudes: tuple[float, ...] = (1.0,)
    """Factors on the motion."""
    samples: int = 500
    """Samples of the belief, each a table that is simulated."""
    probability: float = 0.9
    """Of the intervals."""
    required_probability: float = 0.95
    """Probability with which every limit must be kept."""
    execution: Annotated[ExecutionOptions, tyro.conf.arg(name="")] = field(
        default_factory=ExecutionOptions
    )
    seed: int = FORECAST_SEED
    """Seed of the first sample."""

    def run(self, console: Console) -> dict[str, Any]:
        """Forecast, print, write."""
        from agents.laboratory.forecasting.forecast import advice, forecast
        from agents.laboratory.forecasting.page import (
            forecast_cells,
            forecast_headings,
            forecast_to_json,
            write_page,
        )
        from agents.laboratory.identification.posterior import read_posterior
        from shake_env.files import write_json

        if not 0.0 < self.required_probability < 1.0:
            raise ParameterError(
                "required_probability", self.required_probability, "must lie between 0 and 1"
            )
        scenario = ScenarioOptions(self.scenario).build()
        if self.posterior is not None:
            scenario = replace(
                scenario, uncertainty=read_posterior(self.posterior).uncertain.uncertainty
            )
        if self.motion is not None:
            quakes = motion_earthquakes(
                [self.motion], self.motion_options, scenario, scale=self.scale, console=console
            )
            if len(quakes) != 1:
                names = [quake.name for quake in quakes]
                raise ParameterError(
                    "motion", names, "holds several channels: choose one by --motion.column"
                )
            scenario = replace(scenario, motion=quakes[0].motion)
        folder = self.results_folder("forecast")
        with self.execution.open_runner(usual=2) as runner, progress_by_name() as on_progress:
            forecasts = forecast(
                scenario,
                self.controllers,
                amplitudes=self.amplitudes,
                samples=self.samples,
                probability=self.probability,
                seed=self.seed,
                runner=runner,
                on_progress=on_progress,
            )
        chosen = advice(forecasts, self.required_probability)
        print_table(console, forecast_headings(), [forecast_cells(each) for each in forecasts], names=2)
        for each in forecasts:
            console.print(
                f"{each.controller}, amplitude {each.amplitude:g}: {each.coupling}", soft_wrap=True
            )
        console.print(escape(f"Use {chosen.controller}: {chosen.reason}"), soft_wrap=True)
        result = {
            "scenario": scenario.name,
            "forecasts": [forecast_to_json(each) for each in forecasts],
            "advice": asdict(chosen),
        }
        if folder is not None:
            title = f"Forecast of {scenario.name}"
            for path in write_page(forecasts, chosen, title, folder):
                console.print(escape(f"wrote {path}"))
            write_json(folder / "forecast.json", result)
            console.print(escape(f"wrote {folder / 'forecast.json'}"))
        return result
