"""The commands ``shake motion`` and ``shake accept``: a file for a table, and a table's own motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console
from rich.markup import escape

import shake_env
from agents.acceptance.options import AcceptanceOptions
from agents.cli.command_options import CommandOptions
from agents.cli.output_path import require_writable, require_writable_file
from agents.motions.channels import Channel, MotionOptions, _beyond, channels, how_a_file_was_read
from agents.reporting.terminal import print_table
from agents.scenario_options import ScenarioOptions
from shake_env.errors import ParameterError
from shake_env.files import write_text
from shake_env.motion.processing import TableCapacity
from shake_env.records import Record

if TYPE_CHECKING:
    from agents.acceptance.clauses import Acceptance

OFFSET_WORTH_SAYING = 0.05  # of the peak


@dataclass(frozen=True, kw_only=True)
class Motion(CommandOptions):
    """Describe every channel of a file of recorded motion, and the scale that the table needs.

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
        from agents.motions.figure import draw_channels

        scenario = self.scenario.build()
        folder = self.output or (None if self.json else Path("out/motion"))
        if folder is not None:
            require_writable(folder, "output")
        entries = channels(self.file, self.options, scenario)
        described = [channel.to_json() for channel in entries]
        capacity = self.options.capacity(scenario)
        print_channels(self.file, entries, described, capacity, console)
        if folder is not None:
            for path in draw_channels(entries, capacity, folder, self.file.name):
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
    entries: Sequence[Channel],
    described: Sequence[dict[str, Any]],
    capacity: TableCapacity,
    console: Console,
) -> None:
    """Print what a file holds for a person."""
    form = how_a_file_was_read(entries[0].record)
    number = f"{len(entries)} channel{'s' if len(entries) > 1 else ''}"
    console.print(escape(f"{file.name}: {form}, {number}"))
    figures = ("points", "step\ns", "peak\nm/s²", "Arias\nm/s", "5-95 %\ns")
    rows = []
    for channel, row in zip(entries, described, strict=True):
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
    motion = entries[0].by_amplitude.motion
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


@dataclass(frozen=True, kw_only=True)
class Accept(CommandOptions):
    """Check measured accelerations of a table against a required response spectrum, clause by clause.

    Exits with 1 where a clause is not met.

    Try:
      shake accept platen.csv --s-ds 1.2 --z-over-h 0.5
      shake accept x.csv y.csv --spectrum ieee693 --level high --output out/accept
      shake accept platen.csv --spectrum client.csv --rules.upper 1.3
      shake accept --make input.csv --s-ds 1.2
    """

    files: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Files of the table's measured acceleration; each channel is a direction."""
    acceptance: Annotated[AcceptanceOptions, tyro.conf.arg(name="")] = field(
        default_factory=lambda: AcceptanceOptions(spectrum="ac156")
    )
    make: Path | None = None
    """CSV file for an input motion compatible with the spectrum; nothing is then read."""
    seed: int = 0
    """Seed of that motion's phases."""
    motion: Annotated[MotionOptions, tyro.conf.arg(name="motion")] = field(default_factory=MotionOptions)
    output: Path | None = None
    """Folder for the figure of required and test response spectra."""

    def run(self, console: Console) -> dict[str, Any]:
        """Read or make, hold against the spectrum, print, draw."""
        from agents.acceptance.clauses import accept
        from agents.acceptance.matching import compatible_motion

        if self.output is not None:
            require_writable(self.output, "output")
        required, rules = self.acceptance.required(), self.acceptance.rules
        if required is None:
            raise ParameterError("spectrum", None, "name ac156, ieee693 or a file")
        if self.make is not None:
            if self.files:
                raise ParameterError("make", str(self.make), "reads no files: leave them out")
            require_writable_file(self.make, "make")
            records = [compatible_motion(required, rules, seed=self.seed)]
            _write(records[0], self.make)
            console.print(escape(f"wrote {self.make}"))
        else:
            if not self.files:
                raise ParameterError("files", None, "name a file of measured accelerations, or --make")
            records = [record for file in self.files for record in self.motion.read(file)]
        steps = {record.sampling_interval for record in records}
        if len(steps) > 1:
            raise ParameterError("files", sorted(steps), "must be sampled at one step [s]")
        result = accept(
            [record.acceleration for record in records],
            steps.pop(),
            required,
            rules,
            [record.name for record in records],
        )
        print_acceptance(result, console)
        if self.output is not None:
            from agents.reporting.figures.acceptance import draw_acceptance

            for path in draw_acceptance(result, self.output):
                console.print(escape(f"wrote {path}"))
        return {
            "passed": result.passed,
            "required": {"name": required.name, "source": required.source, "damping": required.damping},
            "frequency": result.frequency.tolist(),
            "rrs": result.rrs.tolist(),
            "trs": {name: row.tolist() for name, row in zip(result.names, result.trs, strict=True)},
            "clauses": [asdict(clause) for clause in result.clauses],
        }

    def exit_code(self, result: dict[str, Any]) -> int:
        """Return 0 where every clause is met, and 1 otherwise."""
        return 0 if result["passed"] else 1


def print_acceptance(result: Acceptance, console: Console) -> None:
    """Print the clauses, the verdict and where the numbers come from."""
    console.print(escape(f"{result.required.name}: {result.required.source}"))
    rows = [
        (clause.name, clause.measured, clause.required, "pass" if clause.passed else "FAIL")
        for clause in result.clauses
    ]
    print_table(console, ("clause", "measured", "required", ""), rows, left=(1, 2), fold=0)
    for source in dict.fromkeys(clause.source for clause in result.clauses):
        named = sorted({c.name.partition(": ")[2] for c in result.clauses if c.source == source})
        console.print(escape(f"{'; '.join(named)}: {source}"))
    console.print("pass" if result.passed else "FAIL")


def _write(record: Record, path: Path) -> None:
    lines = [f"# {key}: {text}" for key, text in record.attribution]
    lines.append("time [s],acceleration [m/s^2]")
    step = record.sampling_interval
    lines += [f"{i * step:.6f},{value:.9g}" for i, value in enumerate(record.acceleration)]
    write_text(path, "\n".join(lines) + "\n")
