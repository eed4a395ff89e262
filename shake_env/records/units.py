"""Units of acceleration, as files and callers write them; SI from here on."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from shake_env.errors import ParameterError, RecordError
from shake_env.parameters import GRAVITY, FloatArray

KNOWN = "g, m/s^2, cm/s^2, gal, mm/s^2"
_SPELLINGS = {
    "g": ("g",),
    "m/s^2": ("m/s2", "m/s/s", "m/sec2", "m/sec/sec"),
    "cm/s^2": ("cm/s2", "cm/s/s", "cm/sec2", "cm/sec/sec", "gal", "gals"),
    "mm/s^2": ("mm/s2", "mm/s/s", "mm/sec2", "mm/sec/sec"),
}
_CANONICAL = {spelling: unit for unit, spellings in _SPELLINGS.items() for spelling in spellings}
_FACTOR = re.compile(r"\s*(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)\s+(\S.*?)\s*")


@dataclass(frozen=True)
class Unit:
    """A unit of acceleration, or a multiple of one (a count, by its sensitivity)."""

    name: str  # canonical: g, m/s^2, cm/s^2 or mm/s^2
    factor: float = 1.0

    def to_si(self, values: FloatArray) -> FloatArray:
        """Return `values` (...) in m/s^2."""
        scaled: FloatArray = values if self.factor == 1.0 else values * self.factor
        # Division by a power of ten rounds once; a factor of 0.01 would round twice.
        if self.name == "g":
            return scaled * GRAVITY
        return scaled / {"m/s^2": 1.0, "cm/s^2": 100.0, "mm/s^2": 1000.0}[self.name]

    def __str__(self) -> str:
        return self.name if self.factor == 1.0 else f"{self.factor!r} {self.name}"


def unit_named(text: str) -> Unit | None:
    """Return the unit that `text` spells, or None."""
    plain = text.strip().strip(".,").lower().replace(" ", "").replace("**", "").replace("^", "")
    name = _CANONICAL.get(plain.replace("\xb2", "2"))
    return None if name is None else Unit(name)


def unit_asked(text: str | None) -> Unit | None:
    """Return the unit that a caller gives, such as ``"g"`` or, for counts, ``"4.2e-7 m/s^2"``.

    Raises
    ------
    ParameterError
        If it is no unit of acceleration.
    """
    if text is None:
        return None
    remedy = f"known: {KNOWN}; for counts, a number before it, as in '4.2e-7 m/s^2'"
    if not isinstance(text, str):
        raise ParameterError("units", text, remedy)
    multiple = _FACTOR.fullmatch(text)
    unit = unit_named(multiple[2] if multiple else text)
    if unit is None:
        raise ParameterError("units", text, remedy)
    factor = float(multiple[1]) if multiple else 1.0
    if not (math.isfinite(factor) and factor > 0.0):
        raise ParameterError("units", text, "the number before the unit must be finite and above 0")
    return Unit(unit.name, factor)


def settle_unit(place: str, stated: str | None, asked: Unit | None) -> Unit:
    """Return the unit of a file that states one, or leaves it to the caller.

    Parameters
    ----------
    place
        File and line, for the message.
    stated
        What the file says; None where it says nothing.
    asked
        What the caller says.

    Raises
    ------
    RecordError
        If the file's unit is unknown, the two differ, or there is none at all.
    """
    if stated is None:
        if asked is None:
            raise RecordError(place, "no unit", f"the file states none: give units, one of {KNOWN}")
        return asked
    unit = unit_named(stated)
    if unit is None:
        raise RecordError(place, stated, f"is no unit of acceleration; known: {KNOWN}")
    if asked is not None and asked != unit:
        raise RecordError(place, stated, f"the file's own unit differs from the given {asked}")
    return unit


def settle_interval(place: str, stated: float | None, asked: float | None) -> float:
    """Return the step [s] of a file that states one, or leaves it to the caller.

    Raises
    ------
    RecordError
        If the step is not above 0 s, the two differ by more than a millionth, or there is none.
    """
    if stated is None:
        if asked is None:
            raise RecordError(place, "no step", "the file states none: give sampling_interval in s")
        return asked
    if not (math.isfinite(stated) and stated > 0.0):
        raise RecordError(place, stated, "the step must be a finite number above 0 s")
    if asked is not None and not math.isclose(stated, asked, rel_tol=1e-6):
        raise RecordError(place, stated, f"the file's own step differs from the given {asked} s")
    return stated


def check_peak(place: str, stated: str, unit: Unit, acceleration: FloatArray) -> None:
    """Refuse data whose peak is not the one that the header prints: a wrong unit, or damage.

    Parameters
    ----------
    place
        File and line of the header's peak.
    stated
        The peak as printed.
    unit
        Its unit.
    acceleration
        (points,) [m/s^2].

    Raises
    ------
    RecordError
        If they differ by more than 2 % and the last printed digit.
    """
    expected = abs(float(unit.to_si(np.asarray(float(stated)))))
    digit = float(unit.to_si(np.asarray(10.0 ** -len(stated.partition(".")[2]))))
    found = float(np.max(np.abs(acceleration)))
    if not (math.isfinite(expected) and abs(found - expected) <= 0.02 * expected + digit):
        remedy = f"the data's own peak is {found / float(unit.to_si(np.asarray(1.0))):.6g} {unit}"
        raise RecordError(place, f"peak {stated}", f"{remedy}: the file is damaged or its unit wrong")
