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
from agents.cli.command_options import CommandOptions
from agents.motions.channels import Channel, MotionOptions, _beyond, channels, reading
from agents.reporting.terminal import print_table
from agents.scenario_options import ScenarioOptions
from shake_env.motion.processing import TableCapacity

OFFSET_WORTH_SAYING = 0.05  # of the peak


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
        from agents.motions.figure import draw

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
    band = f"above {motion.highpass_frequency or 0.0:g} Hz"
    if motion.lowpass_frequency:
        band = f"from {motion.highpass_frequency or 0.0:g} to {motion.lowpass_frequency:g} Hz"
    console.print(
        "Peak, Arias intensity and duration: of the samples in the file. Amplitude or time: either "
        f"factor brings it, {band}, within "
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
