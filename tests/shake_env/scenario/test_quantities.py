"""Quantities with units: exact, strict, and back in the shortest words."""

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shake_env.model.parameters import GRAVITY
from shake_env.model.ranges import RANGES
from shake_env.scenario.quantities import QuantityError, format_quantity, is_unit, to_si


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("180 kg", "kg", 180.0),
        ("0.18 t", "kg", 180.0),
        ("70 mm", "m", 0.07),
        ("21 MPa", "Pa", 21e6),
        ("210 bar", "Pa", 21e6),
        ("5.78 kN s/m", "N s/m", 5780.0),
        ("5.78 kN·s·m⁻¹", "N s/m", 5780.0),
        ("5.78 kN*s/m", "N s/m", 5780.0),
        ("25 mA", "A", 0.025),
        ("24.6 ms", "s", 0.0246),
        ("0.2 kHz", "Hz", 200.0),
        ("23.7 cm^2", "m^2", 0.00237),
        ("23.7 cm²", "m^2", 0.00237),
        ("0.36 l", "m^3", 0.00036),
        ("1.67401e-7 m^3/s/kPa", "m^3/(Pa s)", 1.67401e-10),
        ("1e-16 m^3/(Pa s)", "m^3/(Pa s)", 1e-16),
        ("60 l/min", "m^3/s", 0.001),
        ("1 lbf/in", "N/m", 175.1268352464763780),
        ("12 in", "m", 0.3048),
        ("1 g", "m/s^2", GRAVITY),
        ("0.5 g", "kg", 0.0005),
        ("10 gal", "m/s^2", 0.1),
        ("5 %", "-", 0.05),
        ("0.05", "-", 0.05),
        ("180", "kg", 180.0),
        ("2.5", "physics steps", 2.5),
        ("1e400 m", "m", math.inf),
        ("23.4 mV", "V", 0.0234),
        ("2.94 ohm", "V/A", 2.94),
    ],
)
def test_a_quantity_in_si(text, unit, value):
    assert to_si(text, unit) == value


@pytest.mark.parametrize(
    ("text", "unit", "remedy"),
    [
        ("70 mm", "kg", "does not convert to kg"),
        ("70 mmm", "m", "did you mean 'mm'"),
        ("21 Mpa", "Pa", "did you mean 'MPa'"),
        ("many m", "m", "a number with a unit such as '1 m'"),
        ("1,5 kg", "kg", "is no unit"),
        ("3 m", "-", "must have none"),
        ("3 ms", "physics steps", "without a unit"),
        ("3 N//m", "N/m", "two slashes"),
        ("3 N/(m", "N/m", "ends too early"),
        ("3 N)", "N", "brackets"),
        ("1e99999 m", "m", "must be a number"),
        ("1" * 100, "m", "must be a number"),
        ("nan m", "m", "must be a number"),
        ("", "m", "must be a number"),
    ],
)
def test_what_is_no_quantity_is_refused_with_a_remedy(text, unit, remedy):
    with pytest.raises(QuantityError, match=remedy.replace("(", r"\(")):
        to_si(text, unit)


UNITS = sorted({r.unit for fields in RANGES.values() for r in fields.values() if is_unit(r.unit)})


@given(st.floats(allow_nan=False, allow_infinity=False), st.sampled_from(UNITS))
def test_words_give_the_same_double_again(value, unit):
    again = to_si(format_quantity(value, unit), unit)
    assert again == value and math.copysign(1.0, again) == math.copysign(1.0, value or 1.0)


@given(st.decimals(-1e6, 1e6, places=6), st.sampled_from([("mm", -3), ("MPa", 6), ("kN", 3)]))
def test_a_conversion_rounds_once(number, unit):
    si = {"mm": "m", "MPa": "Pa", "kN": "N"}[unit[0]]
    assert to_si(f"{number:f} {unit[0]}", si) == float(Fraction(number) * Fraction(10) ** unit[1])
