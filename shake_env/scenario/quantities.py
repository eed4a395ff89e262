"""Quantities in words, such as ``"5.78 kN s/m"``: a number and a unit, converted to SI exactly.

The conversion is done in fractions and rounded once, so that ``"70 mm"`` is the double 0.07.
"""

from __future__ import annotations

import math
import re
from difflib import get_close_matches
from fractions import Fraction
from functools import lru_cache

from shake_env.model.parameters import GRAVITY

Dimension = tuple[int, int, int, int]  # exponents of kg, m, s, A

_PREFIXES = {"n": -9, "u": -6, "m": -3, "c": -2, "d": -1, "k": 3, "M": 6, "G": 9}
_POUND, _INCH = Fraction("0.45359237"), Fraction("0.0254")
_POUND_FORCE = _POUND * Fraction("9.80665")
# Units that take a prefix, and units that do not: factor to SI, and exponents of kg, m, s, A.
_PREFIXED: dict[str, tuple[Fraction, Dimension]] = {
    "g": (Fraction("0.001"), (1, 0, 0, 0)),
    "m": (Fraction(1), (0, 1, 0, 0)),
    "s": (Fraction(1), (0, 0, 1, 0)),
    "A": (Fraction(1), (0, 0, 0, 1)),
    "N": (Fraction(1), (1, 1, -2, 0)),
    "Pa": (Fraction(1), (1, -1, -2, 0)),
    "Hz": (Fraction(1), (0, 0, -1, 0)),
    "V": (Fraction(1), (1, 2, -3, -1)),
    "W": (Fraction(1), (1, 2, -3, 0)),
    "ohm": (Fraction(1), (1, 2, -3, -2)),
    "H": (Fraction(1), (1, 2, -2, -2)),
    "l": (Fraction("0.001"), (0, 3, 0, 0)),
    "L": (Fraction("0.001"), (0, 3, 0, 0)),
    "bar": (Fraction(100_000), (1, -1, -2, 0)),
}
_PLAIN: dict[str, tuple[Fraction, Dimension]] = {
    "t": (Fraction(1000), (1, 0, 0, 0)),
    "lb": (_POUND, (1, 0, 0, 0)),
    "in": (_INCH, (0, 1, 0, 0)),
    "ft": (12 * _INCH, (0, 1, 0, 0)),
    "min": (Fraction(60), (0, 0, 1, 0)),
    "gal": (Fraction("0.01"), (0, 1, -2, 0)),
    "lbf": (_POUND_FORCE, (1, 1, -2, 0)),
    "kip": (1000 * _POUND_FORCE, (1, 1, -2, 0)),
    "psi": (_POUND_FORCE / _INCH**2, (1, -1, -2, 0)),
    "%": (Fraction("0.01"), (0, 0, 0, 0)),
    "1": (Fraction(1), (0, 0, 0, 0)),
    "-": (Fraction(1), (0, 0, 0, 0)),
}
_GRAVITIES = {"g": Fraction(1), "mg": Fraction("0.001"), "%g": Fraction("0.01")}  # of an acceleration
_ACCELERATION: Dimension = (0, 1, -2, 0)
_SPELLED = str.maketrans(
    {"\xb5": "u", "\u03bc": "u", "\u03a9": "ohm", "\u2126": "ohm", "\xb7": " ", "\u22c5": " ", "*": " "}
)
_SUPERSCRIPT = str.maketrans({"\u207b": "-", "\xb9": "1", "\xb2": "2", "\xb3": "3"})
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE]([+-]?\d+))?)\s*(\S.*)?", re.ASCII)
_TOKEN = re.compile(r"\s*(?:([A-Za-z%]+)(?:\^?(-?\d))?|([-1()/]))", re.ASCII)
# Units in which a quantity may be shorter than in the SI unit.
_OTHERS = {
    "m": ("mm",), "m/s": ("mm/s",), "m^2": ("cm^2",), "m^3": ("cm^3",), "m/A": ("mm/A",), "s": ("ms",),
    "A": ("mA",), "N": ("kN", "MN"), "N/m": ("kN/m", "MN/m"), "N s/m": ("kN s/m", "MN s/m"),
    "Pa": ("kPa", "MPa", "GPa"), "Hz": ("kHz",),
}  # fmt: skip
_LONGEST = 80  # characters of a quantity


class QuantityError(ValueError):
    """A text is no quantity of the wanted unit; the message is the remedy."""


@lru_cache(maxsize=1024)
def to_si(text: str, unit: str) -> float:
    """Return a quantity in SI.

    Parameters
    ----------
    text
        A number and a unit, such as ``"180 kg"``; a number alone is in `unit`.
    unit
        SI unit that the quantity must be convertible to, such as ``"N s/m"``; ``"-"`` for a ratio.

    Raises
    ------
    QuantityError
        If the text is no number with a unit, or the unit is unknown or measures another quantity.
    """
    known = f"such as '1 {unit}'" if unit != "-" else "without a unit, such as 0.05, or '5 %'"
    match = _QUANTITY.fullmatch(text) if len(text) <= _LONGEST else None
    if match is None or len(match[2] or "") > 4:
        raise QuantityError(f"must be a number, or a number with a unit {known}")
    number, given = Fraction(match[1]), match[3]
    if given is not None:
        wanted = _dimension(unit)
        if wanted is None:
            raise QuantityError(f"must be a number of {unit}, without a unit")
        number *= _factor(given.strip(), wanted, unit)
    try:
        return float(number)
    except OverflowError:
        return math.inf if number > 0 else -math.inf


def format_quantity(value: float, unit: str) -> str:
    """Return a finite number of an SI unit as a quantity, such as ``"70 mm"``, in the shortest way.

    It converts back to the same double.
    """
    ways = [f"{_shortest(value)} {unit}"]
    for other in _OTHERS.get(unit, ()) if 1e-100 < abs(value) < 1e100 else ():
        way = f"{_shortest(float(Fraction(value) / _parsed(other)[0]))} {other}"
        if to_si(way, unit) == value:
            ways.append(way)
    return min(ways, key=len)


def _shortest(value: float) -> str:
    return repr(float(value)).removesuffix(".0")


def is_unit(unit: str) -> bool:
    """Return whether `unit` is one that quantities have, as "physics steps" is not."""
    return _dimension(unit) is not None


@lru_cache(maxsize=256)
def _dimension(unit: str) -> Dimension | None:
    try:
        return _parsed(unit)[1]
    except QuantityError:
        return None


def _factor(given: str, wanted: Dimension, unit: str) -> Fraction:
    """Return what a unit is multiplied by to be the SI one."""
    if wanted == _ACCELERATION and given in _GRAVITIES:
        return _GRAVITIES[given] * Fraction(str(GRAVITY))
    factor, dimension = _parsed(given)
    if dimension != wanted:
        remedy = f"has the unit {given}, which does not convert to {unit}"
        raise QuantityError(remedy if unit != "-" else f"has the unit {given}, and must have none")
    return factor


def _parsed(text: str) -> tuple[Fraction, Dimension]:
    """Return factor and dimension of a unit; a slash divides by the one unit or bracket after it."""
    spelled = re.sub(
        "[\u207b\xb9\xb2\xb3]+", lambda superscripts: "^" + superscripts[0].translate(_SUPERSCRIPT), text
    ).translate(_SPELLED)
    tokens, place = [], 0
    while place < len(spelled.rstrip()):
        match = _TOKEN.match(spelled, place)
        if match is None:
            raise QuantityError(f"{text!r} is no unit: write it as in 'kN s/m' or 'm^3/(Pa s)'")
        tokens.append((match[1] or match[3], int(match[2] or 1)))
        place = match.end()
    factor, exponents = Fraction(1), [0, 0, 0, 0]
    signs, divides, opened = [1], False, 0
    for token, power in tokens:
        sign = signs[-1] * (-1 if divides else 1)
        if token == "/":
            if divides:
                raise QuantityError(f"{text!r} is no unit: two slashes follow one another")
            divides = True
            continue
        if token == "(":
            signs.append(sign)
            opened += 1
        elif token == ")":
            if not opened or divides:
                raise QuantityError(f"{text!r} is no unit: its brackets do not match")
            signs.pop()
            opened -= 1
        else:
            value, dimension = _atom(token)
            factor *= value ** (sign * power)
            exponents = [e + sign * power * d for e, d in zip(exponents, dimension, strict=True)]
        divides = False
    if opened or divides or not tokens:
        raise QuantityError(f"{text!r} is no unit: it ends too early")
    kg, m, s, ampere = exponents
    return factor, (kg, m, s, ampere)


def _atom(name: str) -> tuple[Fraction, Dimension]:
    for table in (_PLAIN, _PREFIXED):
        if name in table:
            return table[name]
    if name[:1] in _PREFIXES and name[1:] in _PREFIXED:
        factor, dimension = _PREFIXED[name[1:]]
        return factor * Fraction(10) ** _PREFIXES[name[0]], dimension
    usual = ("kg", "mm", "cm", "ms", "mA", "kN", "MN", "kPa", "MPa", "GPa", "kHz", "mV")
    near = get_close_matches(name, [*_PREFIXED, *_PLAIN, *usual], n=1, cutoff=0.5)
    hint = f": did you mean {near[0]!r}?" if near else ""
    raise QuantityError(f"{name!r} is no known unit{hint}")
