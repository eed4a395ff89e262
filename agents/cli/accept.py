"""The command ``shake accept``: a measured table motion against a required response spectrum."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.markup import escape

from agents.acceptance.clauses import Acceptance, AcceptanceRules, accept
from agents.acceptance.matching import compatible_motion
from agents.acceptance.required import (
    RequiredSpectrum,
    ac156,
    ieee_693,
    read_required_spectrum,
)
from agents.cli.command_options import CommandOptions
from agents.motions.channels import MotionOptions
from agents.reporting.terminal import print_table
from shake_env.errors import ParameterError
from shake_env.records import Record


@dataclass(frozen=True, kw_only=True)
class Accept(CommandOptions):
    """Hold measured accelerations of a table against a required response spectrum, clause by clause.

    Exits with 1 where a clause is not met.

    Try:
      shake accept platen.csv --s-ds 1.2 --z-over-h 0.5
      shake accept x.csv y.csv --spectrum ieee693 --level high --output out/accept
      shake accept platen.csv --spectrum client.csv --rules.upper 1.3
      shake accept --make input.csv --s-ds 1.2
    """

    files: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Files of the table's measured acceleration; each channel is a direction."""
    spectrum: str = "ac156"
    """Required spectrum: ac156, ieee693, or a CSV file of frequency [Hz] and acceleration."""
    s_ds: float = 1.0
    """S_DS of AC156 [g]."""
    z_over_h: float = 1.0
    """z/h of AC156, 0 at grade to 1 at the roof."""
    level: str = "high"
    """Level of IEEE 693: moderate, high, high-performance."""
    spectrum_units: str = "g"
    """Unit of the accelerations of a spectrum's file: g or m/s^2."""
    damping: float = 0.05
    """Damping ratio of IEEE 693's spectrum, or of a file's."""
    make: Path | None = None
    """CSV file for an input motion compatible with the spectrum; nothing is then read."""
    seed: int = 0
    """Seed of that motion's phases."""
    rules: AcceptanceRules = field(default_factory=AcceptanceRules)
    motion: Annotated[MotionOptions, tyro.conf.arg(name="motion")] = field(default_factory=MotionOptions)
    output: Path | None = None
    """Folder for the figure of required and test response spectra."""

    def run(self, console: Console) -> dict[str, Any]:
        """Read or make, hold against the spectrum, print, draw."""
        required = self.required()
        if self.make is not None:
            if self.files:
                raise ParameterError("make", str(self.make), "reads no files: leave them out")
            records = [compatible_motion(required, self.rules, seed=self.seed)]
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
            self.rules,
            [record.name for record in records],
        )
        print_acceptance(result, console)
        if self.output is not None:
            from agents.reporting.acceptance_figure import draw_acceptance

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

    def required(self) -> RequiredSpectrum:
        """Return the required spectrum that the options name."""
        if self.spectrum == "ac156":
            return ac156(self.s_ds, self.z_over_h)
        if self.spectrum == "ieee693":
            return ieee_693(self.level, self.damping)
        return read_required_spectrum(self.spectrum, self.spectrum_units, self.damping)

    def exit_code(self, result: dict[str, Any]) -> int:
        """Return 0 where every clause is met, and 1 otherwise."""
        return 0 if result["passed"] else 1


def print_acceptance(result: Acceptance, console: Console) -> None:
    """Print the clauses, the verdict and where the numbers come from."""
    console.print(escape(f"{result.required.name}: {result.required.source}"))
    rows = [
        (clause.name, clause.found, clause.required, "pass" if clause.passed else "FAIL")
        for clause in result.clauses
    ]
    print_table(console, ("clause", "found", "required", ""), rows, left=(1, 2), fold=0)
    for source in dict.fromkeys(clause.source for clause in result.clauses):
        named = sorted({c.name.partition(": ")[2] for c in result.clauses if c.source == source})
        console.print(escape(f"{'; '.join(named)}: {source}"))
    console.print("pass" if result.passed else "FAIL")


def _write(record: Record, path: Path) -> None:
    lines = [f"# {key}: {text}" for key, text in record.attribution]
    lines.append("time [s],acceleration [m/s^2]")
    step = record.sampling_interval
    lines += [f"{i * step:.6f},{value:.9g}" for i, value in enumerate(record.acceleration)]
    try:
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise ParameterError("make", str(path), f"cannot be written: {error.strerror}") from None
