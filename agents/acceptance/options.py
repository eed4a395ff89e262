"""The options that name a required response spectrum and the numbers of its clauses."""

from __future__ import annotations

from dataclasses import dataclass, field

from agents.acceptance.required import RequiredSpectrum, ac156, ieee_693, read_required_spectrum
from agents.acceptance.rules import AcceptanceRules


@dataclass(frozen=True, kw_only=True)
class AcceptanceOptions:
    """What a table's measured acceleration is held against."""

    spectrum: str | None = None
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
    rules: AcceptanceRules = field(default_factory=AcceptanceRules)

    def required(self) -> RequiredSpectrum | None:
        """Return the required spectrum that the options name; None where they name none."""
        if self.spectrum is None:
            return None
        if self.spectrum == "ac156":
            return ac156(self.s_ds, self.z_over_h)
        if self.spectrum == "ieee693":
            return ieee_693(self.level, self.damping)
        return read_required_spectrum(self.spectrum, self.spectrum_units, self.damping)
