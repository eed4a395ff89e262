"""The command ``shake motion``: what a file holds, and what a table needs to repeat it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.markup import escape

import shake_env
from agents.command_options import CommandOptions
from agents.motion_channels import Channel, MotionOptions, channels, reading
from agents.options import ScenarioOptions
from agents.terminal import print_table
from shake_env.motion import RecordedMotion
from shake_env.preparation import (
    TableCapacity,
    TableFit,
    fit_amplitude,
)
from shake_env.rollout import Earthquake, record_amplitude
from shake_env.scenario import Scenario

OFFSET_WORTH_SAYING = 0.05  # of the peak


def motion_earthquakes(
    paths: Sequence[Path], options: MotionOptions, scenario: Scenario, *, scale: bool, console: Console
) -> list[Earthquake]:
    """Return an earthquake for every channel of every file, scaled to the table unless told not to.

    The scale is printed, and multiplies the amplitude at which the scenario takes a record.
    """
    earthquakes: list[Earthquake] = []
    capacity, amplitude = options.capacity(scenario), record_amplitude(scenario)
    for path in paths:
        records = options.read(path)
        console.print(escape(f"{path.name}: {reading(records[0])}"))
        for record in records:
            plain = options.motion(record)
            fit = fit_amplitude(plain, capacity, physics_step=scenario.physics_step)
            factor = amplitude * (fit.factor if scale else 1.0)
            why = f"as recorded; the table needs {fit.factor:.4g}"
            if scale:
                fitting = fit.governed_by == "nothing"
                why = "within the table" if fitting else f"for its {_beyond(fit)} of {fit.governed_by}"
            console.print(escape(f"motion {record.name}: amplitude x {factor:.4g} ({why})"))
            motion = RecordedMotion(
                record=record,
                amplitude=factor,
                highpass_frequency=plain.highpass_frequency,
                lowpass_frequency=plain.lowpass_frequency,
            )
            earthquakes.append(Earthquake(record.name, motion))
    return earthquakes


def _beyond(fit: TableFit) -> str:
    """Return the peak that governs a scale, in the unit of its limit."""
    before = fit.before
    return {
        "displacement": f"{1e3 * before.displacement:.3g} mm",
        "velocity": f"{before.velocity:.3g} m/s",
        "acceleration": f"{before.acceleration:.3g} m/s²",
        "force": f"{1e-3 * before.force:.3g} kN",
        "nothing": "-",
    }[fit.governed_by]


@dataclass(frozen=True, kw_only=True)
class Motion(CommandOptions):
    """Describe every channel of a file of recorded motion, and what scale the table needs for it.

    Reads PEER .AT2, CSMIP/CESMD volume 1 and 2, K-NET and KiK-net, ESM, COSMOS, SMC, AFAD, GeoNet, CWA,
    CDMG, CSV or text in columns, .mat, .xlsx; MiniSEED and other binary files where ObsPy is installed.

    Try:
      shake motion CICLC.v1
      shake motion mine.csv --units g --highpass 0.1 --output out/mine
      shake motion mine.csv --scenario laboratory --stroke 0.05
      shake motion AOM0011801241951.NS --remove-offset --json
    """

    file: tyro.conf.Positional[Path]
    """The file."""
    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(default_factory=ScenarioOptions)
    options: Annotated[MotionOptions, tyro.conf.arg(name="")] = field(default_factory=MotionOptions)
    output: Path | None = None
    """Folder for the figure, which has the name of the file (default: out/motion; with --json: none)."""

    def run(self, console: Console) -> dict[str, Any]:
        """Describe, print, draw."""
        from agents.motion_figure import draw

        scenario = self.scenario.build()
        found = channels(self.file, self.options, scenario)
        described = [channel.to_json() for channel in found]
        capacity = self.options.capacity(scenario)
        print_channels(self.file, found, described, capacity, console)
        folder = self.output or (None if self.json else Path("out/motion"))
        if folder is not None:
            for path in draw(found, capacity, folder, self.file.name):
                console.print(escape(f"wrote {path}"))
        return {
            "version": shake_env.__version__,
            "file": str(self.file),
            "scenario": scenario.name,
            "options": asdict(self.options),
            "capacity": {
                name: value if math.isfinite(value) else None for name, value in vars(capacity).items()
            },
            "channels": described,
        }


def print_channels(
    file: Path,
    found: Sequence[Channel],
    described: Sequence[dict[str, Any]],
    capacity: TableCapacity,
    console: Console,
) -> None:
    """Print what a file holds for a person."""
    form = reading(found[0].record)
    number = f"{len(found)} channel{'s' if len(found) > 1 else ''}"
    console.print(escape(f"{file.name}: {form}, {number}"))
    figures = ("points", "step\ns", "peak\nm/s²", "Arias\nm/s", "5-95 %\ns")
    rows = []
    for channel, row in zip(found, described, strict=True):
        reasons = dict.fromkeys((_beyond(channel.by_amplitude), _beyond(channel.by_time)))
        cells = (
            row["name"].removeprefix(f"{file.stem} "),
            str(row["points"]),
            f"{row['sampling_interval']:.4g}",
            f"{row['peak_acceleration']:.4g}",
            f"{row['arias_intensity']:.4g}",
            f"{row['significant_duration']:.4g}",
            f"{row['amplitude_scale']:.4g}",
            f"{row['time_scale']:.4g}" + ("" if row["time_scale_suffices"] else "*"),
            "\n".join(reasons),
        )
        rows.append(cells)
    print_table(console, ("channel", *figures, "ampl.\nx", "time\nx", "for its"), rows)
    motion = found[0].by_amplitude.motion
    limited = math.isfinite(capacity.acceleration)
    acceleration = f", {capacity.acceleration:.3g} m/s²" if limited else ""
    upper = f"{motion.lowpass_frequency:g}" if motion.lowpass_frequency else "any"
    console.print(
        "Peak, Arias intensity and duration: of the samples in the file. Amplitude or time: either "
        f"factor brings it, in the band of {motion.highpass_frequency or 0.0:g} to {upper} Hz, within "
        f"{1e3 * capacity.displacement:.3g} mm, {capacity.velocity:.3g} m/s{acceleration} and "
        f"{1e-3 * capacity.force:.3g} kN on {capacity.moving_mass:.4g} kg; 1 where it fits as it is."
    )
    if not all(row["time_scale_suffices"] for row in described):
        console.print(
            "* No time scale brings the force or the acceleration within the table: scale the amplitude."
        )
    for row in described:
        if abs(row["offset"]) > OFFSET_WORTH_SAYING * row["peak_acceleration"]:
            console.print(
                f"{escape(row['name'])}: the mean is {row['offset']:.3g} m/s²; peak and Arias "
                "intensity contain it, and --remove-offset takes it off.",
                style="yellow",
            )
