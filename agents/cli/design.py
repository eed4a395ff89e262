"""The command ``shake design``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from agents.cli.command_options import CommandOptions, tuned_values
from agents.reporting.terminal import print_table
from agents.scenario_options import ScenarioOptions
from shake_env.scenario.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class Design(CommandOptions):
    """Print the expected errors of a scenario's controller, and the LQR of its table and specimen.

    On a linear table with full state the errors are computed analytically. Otherwise the scenario's
    reference (LQG where signals are measured) is simulated, and the full-state LQR is given as a bound.

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
    """File of tuned values that shake tune --output wrote, for a scenario that nothing was tuned on."""

    def run(self, console: Console) -> dict[str, Any]:
        """Design and print."""
        from agents.evaluation.design import design

        scenario = self.scenario.build()
        tuned = tuned_values(self.tuned)
        result = design(scenario, self.earthquakes, tuned, Console(stderr=True).print)
        print_design(result, scenario, console)
        return result


def print_design(result: dict[str, Any], scenario: Scenario, console: Console) -> None:
    """Print a design for a person."""
    from agents.evaluation.controller_set import describe_values
    from agents.evaluation.design import PROBLEM
    from agents.evaluation.results import drive_column

    frequencies = ", ".join(f"{f:.3f}" for f in result["natural_frequencies"])
    console.print(
        f"{scenario.name}: {scenario.specimen.stories} storeys, controlled at "
        f"{scenario.control_rate:g} Hz; natural frequencies [Hz] {frequencies}",
        highlight=False,
    )
    number = result["earthquakes"]
    how = "by analysis" if number is None else f"simulated, mean of {number} earthquakes"
    drive = drive_column(scenario.input_unit)
    _print_figures(f"Expected of {result['controller']}, {how}:", result, drive, console)
    if result["broken_limits"]:
        console.print(f"  ended by a broken limit           {result['broken_limits']} of {number}")
    if number is not None:
        heading = f"Bound: full-state {result['bound']['controller']} ({PROBLEM}), by analysis:"
        _print_figures(heading, result["bound"], drive, console)
        console.print(describe_values(result["values"]), highlight=False)
    rows = [(name, f"{gain:.6g}") for name, gain in zip(result["states"], result["gain"], strict=True)]
    title = "gain of the full-state LQR: u = -sum of gain x state"
    print_table(console, ("state", f"gain [{scenario.input_unit} per unit]"), rows, title=title)


def _print_figures(
    heading: str, figures: dict[str, Any], drive: tuple[str, str, float], console: Console
) -> None:
    console.print(heading, highlight=False)
    if "cost" in figures:
        console.print(f"  expected stage cost               {figures['cost']:.6g}")
    console.print(f"  acceleration error, rms / target  {100 * figures['acceleration_rms_ratio']:.2f} %")
    console.print(f"  base-shear error, rms / target    {100 * figures['base_shear_rms_ratio']:.2f} %")
    if figures["current_rms"] is not None:
        name, unit, factor = drive
        name = "valve current" if name == "current" else name
        console.print(f"  {f'{name}, rms':<34}{factor * figures['current_rms']:.2f} {unit}")
