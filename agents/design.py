"""`shake design`: what fidelity a sampled-data LQR can be expected to give, before the test."""

from __future__ import annotations

from typing import Any

from rich.console import Console

from agents.terminal import print_table
from baselines.lqr import sampled_lqr
from shake_env.scenario import Scenario


def design(scenario: Scenario) -> dict[str, Any]:
    """Return the sampled-data LQR of a scenario and its analytic performance, as plain values.

    Returns
    -------
    ``analytic_cost`` J* [-], ``acceleration_rms_ratio`` and ``base_shear_rms_ratio`` (rms error over
    the target's rms), ``current_rms`` [A], ``natural_frequencies`` [Hz] (undamped, table and specimen
    coupled), ``gain`` (n,) [A per SI unit of each state], ``states`` (their names and units).
    """
    result = sampled_lqr(scenario.discrete, scenario.stage_cost)
    performance = result.performance
    return {
        "analytic_cost": result.analytic_cost,
        "acceleration_rms_ratio": performance.acceleration_rms_ratio,
        "base_shear_rms_ratio": performance.base_shear_rms_ratio,
        "current_rms": performance.current_rms,
        "natural_frequencies": scenario.plant.natural_frequencies.tolist(),
        "gain": result.gain.tolist(),
        "states": list(scenario.plant.layout.names),
    }


def print_design(found: dict[str, Any], scenario: Scenario, console: Console) -> None:
    """Print a design for a person."""
    frequencies = ", ".join(f"{f:.3f}" for f in found["natural_frequencies"])
    console.print(
        f"Sampled-data LQR at {scenario.control_rate:g} Hz, {scenario.specimen.stories} storeys"
    )
    console.print(f"  expected stage cost J*            {found['analytic_cost']:.6g}")
    console.print(f"  acceleration error, rms / target  {100 * found['acceleration_rms_ratio']:.2f} %")
    console.print(f"  base-shear error, rms / target    {100 * found['base_shear_rms_ratio']:.2f} %")
    console.print(f"  valve current, rms                {1e3 * found['current_rms']:.2f} mA")
    console.print(f"  natural frequencies [Hz]          {frequencies}")
    rows = [(name, f"{gain:.6g}") for name, gain in zip(found["states"], found["gain"], strict=True)]
    title = "gain: u = -sum of gain x state"
    print_table(console, ("state", "gain [A per unit]"), rows, title=title)
