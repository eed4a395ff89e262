"""Units of acceleration, as files and callers write them; SI from here on.

All spellings stand in this module. A spelling is compared in lower case, without blanks, brackets,
carets and points, and with plain digits for superscripts.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from shake_env.errors import ParameterError, RecordError
from shake_env.model.parameters import GRAVITY, FloatArray

KNOWN = "g, %g, mg, m/s^2, cm/s^2 (gal), mm/s^2, in/s^2, ft/s^2"
# Multiplier and divisor to m/s^2: division by a power of ten rounds once, a factor of 0.01 twice.
_TO_SI = {
    "g": (GRAVITY, 1.0),
    "%g": (GRAVITY, 100.0),
    "mg": (GRAVITY, 1000.0),
    "m/s^2": (1.0, 1.0),
    "cm/s^2": (1.0, 100.0),
    "mm/s^2": (1.0, 1000.0),
    "in/s^2": (0.0254, 1.0),
    "ft/s^2": (0.3048, 1.0),
}
_LENGTHS = {
    "m": ("m", "meter", "metre", "meters", "metres"),
    "cm": ("cm", "centimeter", "centimetre", "centimeters", "centimetres"),
    "mm": ("mm", "millimeter", "millimetre", "millimeters", "millimetres"),
    "in": ("in", "inch", "inches"),
    "ft": ("ft", "foot", "feet"),
}
_TIMES = ("s", "sec", "second", "seconds")
_SQUARED = (
    "{0}/{1}2", "{0}/{1}/{1}", "{0}{1}-2", "{0}*{1}-2", "{0}/{1}*{1}", "{0}{1}2", "{0}/{1}squared",
    "{0}per{1}2", "{0}per{1}squared", "{0}/sq{1}", "{0}per{1}per{1}",
)  # fmt: skip
_ONCE = ("{0}/{1}", "{0}{1}-1", "{0}*{1}-1", "{0}per{1}")
_NAMED = {
    "g": ("g", "g's", "gs"),
    "%g": ("%g", "%ofg", "g%", "percentg", "percentofg", "pctg"),
    "mg": ("mg", "milli-g", "millig"),
    "cm/s^2": ("gal", "gals"),
}
_OTHER = {
    "time": (*_TIMES, "secs", "ms", "msec", "millisecond", "milliseconds", "min", "minutes", "h"),
    "counts": ("count", "counts", "cts", "digit", "digits", "lsb"),
    "another quantity": (
        "v", "mv", "volt", "volts", "a", "ma", "n", "kn", "mn", "lbf", "kip", "pa", "kpa", "mpa", "bar",
        "psi", "deg", "degree", "degrees", "rad", "rad/s", "rad/s2", "hz", "c", "degc", "%", "-", "km",
        "microstrain", "strain", "nm", "knm", "w", "kw", "l/min", "um",
    ),
}  # fmt: skip


def _table() -> dict[str, tuple[str, str]]:
    """Return the kind of quantity and the unit's canonical name by spelling."""
    table: dict[str, tuple[str, str]] = {}
    for kind, spellings in _OTHER.items():
        table.update({spelling: (kind, spelling) for spelling in spellings})
    for length, words in _LENGTHS.items():
        for word in words:
            table[word] = "displacement", length
            for time in _TIMES:
                table.update({f.format(word, time): ("velocity", f"{length}/s") for f in _ONCE})
                table.update({f.format(word, time): ("acceleration", f"{length}/s^2") for f in _SQUARED})
    for name, spellings in _NAMED.items():
        table.update({spelling: ("acceleration", name) for spelling in spellings})
    return table


_UNITS = _table()
_PLAIN = str.maketrans(
    {"\xb2": "2", "\xb9": "1", "\u207b": "-", "\u2212": "-", "\u2013": "-", "\xb7": "*", "\u22c5": "*",
     "\u2044": "/", "\u2215": "/", "\xb0": "deg", "\xb5": "u", "\u03bc": "u",
     **dict.fromkeys(" \t^(){}[].,\"'_", None)}
)  # fmt: skip
_FACTOR = re.compile(
    r"\s*+(\d++(?:\.\d*+)?+(?:[eE][+-]?+\d++)?+|\.\d++(?:[eE][+-]?+\d++)?+)\s++(\S.*+)", re.ASCII
)
_LONGEST = 40  # characters of a unit
_OF_UNITS = {"of", "are", "is", "in", ":", "="}


@dataclass(frozen=True)
class Unit:
    """A unit of acceleration, or a multiple of one (a count, by its sensitivity)."""

    name: str  # canonical, as in `KNOWN`
    factor: float = 1.0

    def to_si(self, values: FloatArray, *, out: FloatArray | None = None) -> FloatArray:
        """Return `values` (...) in m/s^2, in the array `out` where one is given."""
        multiplier, divisor = _TO_SI[self.name]
        scaled: FloatArray = values if self.factor == 1.0 else np.multiply(values, self.factor, out=out)
        if multiplier != 1.0:
            scaled = np.multiply(scaled, multiplier, out=out)
        if divisor != 1.0 or scaled is values:
            scaled = np.divide(scaled, divisor, out=out)
        return scaled

    def __str__(self) -> str:
        return self.name if self.factor == 1.0 else f"{self.factor!r} {self.name}"


def quantity_of(text: str) -> tuple[str, str] | None:
    """Return the kind of quantity that a unit measures and the unit's name, or None.

    Kinds are acceleration, velocity, displacement, time, counts and another quantity.
    """
    if len(text) > _LONGEST:
        return None
    plain = text.lower().replace("**", "").translate(_PLAIN)
    return _UNITS.get(plain) or _UNITS.get(plain.replace("*", ""))


def unit_named(text: str) -> Unit | None:
    """Return the unit of acceleration that `text` spells, or None."""
    quantity = quantity_of(text)
    return Unit(quantity[1]) if quantity and quantity[0] == "acceleration" else None


def unit_in_words(line: str) -> str | None:
    """Return what a line such as 'The units are (g)' or 'IN UNITS OF G' names as unit, or None."""
    words = line.replace(":", " : ").replace("=", " = ").split()
    for place, word in enumerate(words):
        if word.lower() in ("unit", "units"):
            rest = words[place + 1 :]
            while rest and rest[0].lower() in _OF_UNITS:
                rest = rest[1:]
            if len(rest) == len(words) - place - 1:
                continue  # the word alone says nothing
            for count in range(min(len(rest), 6), 0, -1):  # 'm / s ^ 2' before 'm'
                if quantity_of(" ".join(rest[:count])):
                    return " ".join(rest[:count]).strip("()[].,")
            return rest[0].strip("()[].,") if rest else None
    return None


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
        raise RecordError(place, stated[:80], f"is no unit of acceleration; known: {KNOWN}")
    if asked is not None and asked != unit:
        raise RecordError(place, stated[:80], f"the file's own unit differs from the given {asked}")
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
