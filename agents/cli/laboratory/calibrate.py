"""The command ``shake calibrate``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from agents.cli.command_options import CommandOptions
from agents.cli.output_path import require_writable_file
from agents.progress import progress_by_name
from agents.reporting.terminal import print_table
from agents.scenario_options import ScenarioOptions
from shake_env.errors import ParameterError

FORECAST_SAMPLES = 4  # of the forecast that tests are held against, for each of them


@dataclass(frozen=True, kw_only=True)
class Calibrate(CommandOptions):
    """Test the identification on plants drawn from its own prior: ranks must be uniform.

    Exits with 1 where the ranks of a parameter are not, at a level of 0.01.

    Try:
      shake calibrate --data-sets 10
      shake calibrate --scenario test.toml --data-sets 300 --output out/calibration.json
      shake calibrate --data-sets 300 --shakes 1000 --output out/calibration.json
    """

    scenario: str = "laboratory"
    """Scenario, or file, whose prior plants are drawn from and whose sensors take the logs."""
    data_sets: int = 300
    """Number of simulated logs."""
    seconds: float = 8.0
    """Length of each [s]."""
    samples: int = 200
    """Samples of each posterior."""
    sampler_moves: int | None = None
    """Moves of the sampler for each log (default: the normal posterior)."""
    amplitude: float = 0.1
    """Amplitude of the filtered noise that each log holds."""
    without: tuple[str, ...] = ()
    """Measured channels that are not used."""
    controller: str = "none"
    """Drives the tests; none plays a band-limited noise of current."""
    shakes: int = 0
    """Tests under lqg, drawn from the prior, that are compared with a forecast made from it."""
    output: Path | None = None
    """JSON file for ranks and figures; data sets that it holds already are not made anew."""
    seed: int = 0
    """Seed of everything drawn."""

    def run(self, console: Console) -> dict[str, Any]:
        """Draw, simulate, identify, test, print."""
        from agents.laboratory.identification.calibration import calibrate
        from agents.laboratory.result_files import ResultFile, calibration_cells

        if self.data_sets < 2:
            raise ParameterError("data_sets", self.data_sets, "must be at least 2")
        if self.shakes < 0:
            raise ParameterError("shakes", self.shakes, "must be at least 0; 0 compares none")
        scenario = ScenarioOptions(self.scenario).build()
        options: dict[str, Any] = {
            "seconds": self.seconds,
            "samples": self.samples,
            "amplitude": self.amplitude,
            "without": self.without,
            "controller": self.controller,
            "sampler_moves": self.sampler_moves,
            "seed": self.seed,
        }
        if self.output is not None:
            require_writable_file(self.output, "output")
        file = ResultFile(self.output, "shake calibrate", scenario, options)
        with progress_by_name() as on_progress:
            result = calibrate(
                scenario,
                data_sets=self.data_sets,
                done=file.rows,
                on_row=file.write_rows,
                on_progress=on_progress,
                **options,
            )
        headings = ("parameter", "p-value", "within 90 %", "median error", "width of\nprior's")
        print_table(console, headings, calibration_cells(result))
        for number, text in result["failures"]:
            console.print(escape(f"data set {number}: {text}"), soft_wrap=True)
        if self.shakes:
            from agents.laboratory.forecasting.coverage import forecast_coverage
            from agents.laboratory.sequence.steps import first_belief

            # The ends of an interval from n samples have a coverage that scatters by 0.3 / sqrt(n).
            samples = FORECAST_SAMPLES * self.shakes
            belief = first_belief(scenario, samples=samples, seed=self.seed).uncertain
            checked = forecast_coverage(
                belief, "lqg", shakes=self.shakes, samples=samples, seed=self.seed
            )
            result["forecast"] = checked
            text = f"of {self.shakes} shakes, share within the 90 % intervals: {checked['mean']:.3f}"
            console.print(text, highlight=False)
        if self.output is not None:
            file.write(result)
            console.print(escape(f"wrote {self.output}"))
        return result

    def exit_code(self, result: dict[str, Any]) -> int:
        """Return 0 where all ranks are uniform, and 1 otherwise."""
        return 0 if all(result["uniform"].values()) else 1
