"""Required response spectra: of ICC-ES AC156, of IEEE 693, of a file.

None of the standards' own texts was at hand. Each constructor says what was read in its place; check it
against the edition that your client names.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shake_env.errors import FileError, ParameterError, RecordError, unknown
from shake_env.model.parameters import GRAVITY
from shake_env.records import file_content

FloatArray = NDArray[np.float64]

AC156_SOURCE = (
    "corner frequencies, A_FLX and A_RIG as commonly quoted; the branch below 1.3 Hz from a public "
    "script that computes AC156's spectrum; the text of ICC-ES AC156 was not read"
)
IEEE_693_SOURCE = (
    "formula of IEEE 693-2005 as the public library qtools has it, and public notes on IEEE 693; "
    "the standard's text was not read"
)
LEVELS = {"moderate": 1.0, "high": 2.0, "high-performance": 4.0}  # of IEEE 693, over the moderate level


@dataclass(frozen=True)
class RequiredSpectrum:
    """An acceleration response spectrum, straight on two logarithmic axes between its points.

    Raises
    ------
    ParameterError
        If there are fewer than two points, a value is not above zero, or frequencies do not rise.
    """

    name: str
    frequency: FloatArray  # (points,) [Hz]
    acceleration: FloatArray  # (points,) [m/s^2]
    damping: float  # [-]
    source: str

    def __post_init__(self) -> None:
        f, a = np.asarray(self.frequency, float), np.asarray(self.acceleration, float)
        sizes = f.ndim == a.ndim == 1 and len(f) == len(a) >= 2
        if not (sizes and np.all(np.isfinite(f)) and np.all(np.isfinite(a)) and f[0] > 0.0):
            raise ParameterError("required spectrum", self.name, "needs two points or more, above 0 Hz")
        if not (np.all(np.diff(f) > 0.0) and np.all(a > 0.0)):
            raise ParameterError(
                "required spectrum", self.name, "frequencies must rise, values be above 0"
            )
        object.__setattr__(self, "frequency", f)
        object.__setattr__(self, "acceleration", a)

    def at(self, frequency: FloatArray) -> FloatArray:
        """Return the spectrum (...) [m/s^2] at frequencies (...) [Hz]; beyond its ends it is level."""
        f, a = np.log(self.frequency), np.log(self.acceleration)
        return np.exp(np.interp(np.log(frequency), f, a))

    @property
    def rigid(self) -> float:
        """The acceleration at the highest frequency, that of a rigid structure [m/s^2]."""
        return float(self.acceleration[-1])


def ac156(s_ds: float, z_over_h: float = 1.0) -> RequiredSpectrum:
    """Return the horizontal spectrum of ICC-ES AC156 at 5 % damping.

    ``A_FLX = S_DS (1 + 2 z/h)``, at most ``1.6 S_DS``, from 1.3 to 8.3 Hz;
    ``A_RIG = 0.4 S_DS (1 + 2 z/h)`` from 33.3 Hz; a tenth of A_FLX at 0.1 Hz. Source: `AC156_SOURCE`.

    Parameters
    ----------
    s_ds
        Design spectral acceleration at short periods [g].
    z_over_h
        Height of the attachment over the roof's [-], 0 to 1.

    Raises
    ------
    ParameterError
        If a value is out of range.
    """
    if not (math.isfinite(s_ds) and 0.0 < s_ds <= 10.0):
        raise ParameterError("s_ds", s_ds, "must be above 0 and at most 10 g")
    if not 0.0 <= z_over_h <= 1.0:
        raise ParameterError("z_over_h", z_over_h, "must be 0 (grade) to 1 (roof)")
    height = 1.0 + 2.0 * z_over_h
    flexible = min(s_ds * height, 1.6 * s_ds) * GRAVITY
    rigid = 0.4 * s_ds * height * GRAVITY
    points = np.array([[0.1, 0.1 * flexible], [1.3, flexible], [8.3, flexible], [33.3, rigid]])
    name = f"AC156, S_DS {s_ds:g} g, z/h {z_over_h:g}"
    return RequiredSpectrum(name, points[:, 0], points[:, 1], 0.05, AC156_SOURCE)


def ieee_693(level: str = "high", damping: float = 0.05) -> RequiredSpectrum:
    """Return a required spectrum of IEEE 693, 0.3 to 33 Hz.

    Source: `IEEE_693_SOURCE`.

    Parameters
    ----------
    level
        ``"moderate"`` (0.25 g at high frequencies), ``"high"`` (0.5 g), or ``"high-performance"`` (1 g).
    damping
        [-] 0.02 to 0.2.

    Raises
    ------
    ParameterError
        If the level is unknown, or the damping out of range.
    """
    if level not in LEVELS:
        raise unknown(ParameterError, "level", level, LEVELS)
    if not 0.02 <= damping <= 0.2:
        raise ParameterError("damping", damping, "must be 0.02 to 0.2")
    beta = (3.21 - 0.68 * math.log(100.0 * damping)) / 2.1156
    f = np.unique(np.concatenate([[0.3, 1.1, 8.0, 33.0], np.geomspace(8.0, 33.0, 25)]))
    low, flat = 0.572 * beta * f, np.full(len(f), 0.625 * beta)
    falling = (6.6 * beta - 2.64) / f - 0.2 * beta + 0.33
    values = np.where(f < 1.1, low, np.where(f <= 8.0, flat, falling))
    acceleration = LEVELS[level] * values * GRAVITY
    return RequiredSpectrum(f"IEEE 693 {level}", f, acceleration, damping, IEEE_693_SOURCE)


def read_required_spectrum(
    file: str | os.PathLike[str], units: str = "g", damping: float = 0.05
) -> RequiredSpectrum:
    """Return a spectrum from a CSV file of two columns, frequency [Hz] and acceleration.

    Parameters
    ----------
    file
        Path; lines that do not begin with a number are headings, ``#`` begins a remark.
    units
        ``"g"`` or ``"m/s^2"``.
    damping
        [-]

    Raises
    ------
    FileError
        If it cannot be read, or a line has not two numbers.
    ParameterError
        If it is no spectrum, or the unit is unknown.
    """
    factors = {"g": GRAVITY, "m/s^2": 1.0}
    if units not in factors:
        raise unknown(ParameterError, "units", units, factors)
    try:
        lines = file_content(Path(file)).decode("utf-8-sig").splitlines()
    except (RecordError, UnicodeDecodeError) as error:
        raise FileError("required spectrum", str(file), f"cannot be read: {error}") from None
    rows = []
    for number, line in enumerate(lines, start=1):
        text = line.partition("#")[0].replace(";", ",").replace(",", " ").split()
        if not text or not text[0].lstrip("+-.").replace(".", "", 1)[:1].isdigit():
            continue
        try:
            frequency, value = (float(word) for word in text)
        except ValueError:
            raise FileError(f"{file}, line {number}", line, "must hold two numbers") from None
        rows.append((frequency, factors[units] * value))
    points = np.array(rows).reshape(-1, 2)
    return RequiredSpectrum(Path(file).stem, points[:, 0], points[:, 1], damping, str(file))
