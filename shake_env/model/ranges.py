"""The range of every numeric parameter, in one table; `check_ranges` holds a value against it.

The ranges are wide: from a hand-held model to the largest table there is, with a margin of at least ten.
Inside them the arithmetic of double precision holds; combinations that do not go together, such as a
physics step that is long beside the fastest mode, are refused where they meet (`scenario.py`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from shake_env.errors import ParameterError


def is_number(value: object) -> bool:
    """Return whether `value` is a real number, which a bool is not."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


@dataclass(frozen=True)
class Range:
    """What a parameter may be: `low` to `high`, and what lies beside that.

    Where `high` is inf, inf switches the part off.
    """

    low: float
    high: float
    unit: str = "-"
    zero: bool = False  # 0 is allowed too
    optional: bool = False  # None is allowed too
    whole: bool = False  # whole numbers only

    def holds(self, value: object) -> bool:
        """Return whether `value` is allowed."""
        if value is None:
            return self.optional
        if not is_number(value) or (self.whole and not isinstance(value, (int, np.integer))):
            return False
        number: float = value  # type: ignore[assignment]
        return self.low <= number <= self.high or (self.zero and number == 0.0)

    @property
    def interval(self) -> str:
        """The range in words, such as ``0, or 1e-06 to 100 kg``."""
        unit = "" if self.unit == "-" else f" {self.unit}"
        zero = "0, or " if self.zero else ""
        none = ", or None" if self.optional else ""
        if math.isinf(self.high):
            return f"{zero}at least {self.low:g}{unit}; inf: off{none}"
        return f"{zero}{self.low:g} to {self.high:g}{unit}{none}"

    @property
    def remedy(self) -> str:
        """What an error says."""
        finite = "" if math.isinf(self.high) else "finite "
        kind = "whole number" if self.whole else f"{finite}number"
        if self.zero or self.low == 0.0:
            bound = "of at least 0"
        else:
            bound = f"of at least {self.low:g}" if self.low == 1.0 else "above 0"
        return f"must be a {kind} {bound}: {self.interval}"


_PREPARED = {
    "amplitude": Range(1e-12, 1e6, zero=True),
    "duration": Range(1e-6, 1e5, "s", optional=True),
    "time_compression": Range(1e-2, 1e2),
    "highpass_frequency": Range(1e-4, 1e5, "Hz", optional=True),
    "lowpass_frequency": Range(1e-4, 1e5, "Hz", optional=True),
}

RANGES: dict[str, dict[str, Range]] = {
    "Actuator": {
        "table_mass": Range(1e-2, 1e8, "kg"),
        "table_damping": Range(1e-6, 1e9, "N s/m", zero=True),
        "table_stiffness": Range(1e-6, 1e12, "N/m", zero=True),
        "piston_area": Range(1e-7, 1e2, "m^2"),
        "oil_volume": Range(1e-9, 1e2, "m^3"),
        "bulk_modulus": Range(1e4, 1e12, "Pa"),
        "leakage": Range(1e-25, 1e-3, "m^3/(Pa s)", zero=True),
        "flow_gain": Range(1e-6, 1e6, "m^2/s"),
        "valve_gain": Range(1e-9, 1e3, "m/A"),
        "valve_time_constant": Range(1e-6, 1e1, "s"),
    },
    "Specimen": {  # each storey
        "masses": Range(1e-12, 1e12, "kg"),
        "stiffnesses": Range(1e-15, 1e18, "N/m"),
        "dampings": Range(1e-20, 1e18, "N s/m", zero=True),
    },
    "Specimen.uniform": {
        "stories": Range(1, 200, whole=True),
        "mass_ratio": Range(1e-12, 1e3),
        "storey_frequency": Range(1e-2, 1e3, "Hz"),
        "damping_ratio": Range(1e-6, 1e2, zero=True),
        "table_mass": Range(1e-2, 1e8, "kg"),
    },
    "GroundFilter": {
        "frequency": Range(1e-2, 1e2, "Hz"),
        "damping_ratio": Range(1e-2, 1e2),
        "highpass_frequency": Range(1e-3, 1e2, "Hz", optional=True),
        "highpass_damping_ratio": Range(1e-2, 1e2),
    },
    "Envelope": {
        "rise": Range(1e-6, 1e5, "s", zero=True),
        "hold": Range(1e-6, 1e5, "s", zero=True),
        "decay_rate": Range(1e-9, 1e3, "1/s", zero=True),
    },
    "FilteredNoise": {
        "duration": Range(1e-6, 1e5, "s"),
        "amplitude": _PREPARED["amplitude"],
    },
    "RecordedMotion": _PREPARED,
    "MotionSet": {"amplitude": _PREPARED["amplitude"]},
    "Objective": {
        "acceleration_weight": Range(1e-15, 1e15, zero=True),
        "force_weight": Range(1e-30, 1e15, zero=True),
        "current_weight": Range(1e-15, 1e15),
    },
    "Objective.raw": {
        "q_1": Range(1e-7, 1e7, "s^2/m", zero=True),
        "q_2": Range(1e-15, 1e7, "1/N", zero=True),
        "r": Range(1e-7, 1e7, "1/A", zero=True),
    },
    "Limits": {
        "table_displacement": Range(1e-9, 1e6, "m", optional=True),
        "table_velocity": Range(1e-9, 1e6, "m/s", optional=True),
        "load_pressure": Range(1e-3, 1e12, "Pa", optional=True),
        "table_acceleration": Range(1e-9, 1e6, "m/s^2", optional=True),
        "current": Range(1e-9, 1e6, "A", optional=True),
        "specimen_acceleration": Range(1e-9, 1e6, "m/s^2", optional=True),
        "soft_weight": Range(1e-12, 1e9, zero=True),
        "state_limit": Range(1e-6, 1e3),
        "cost_factor": Range(1.0, 1e9),
        "cost_horizon": Range(1e-6, 1e9, "s", optional=True),
    },
    "Friction": {
        "coulomb": Range(1e-9, 1e9, "N", zero=True),
        "static": Range(1e-9, 1e9, "N", zero=True, optional=True),
        "stribeck_velocity": Range(1e-6, 1e3, "m/s"),
        "smoothing_velocity": Range(1e-6, 1e3, "m/s"),
        "viscous": Range(1e-6, 1e9, "N s/m", zero=True),
    },
    "ServoValve": {
        "supply_pressure": Range(1e-3, math.inf, "Pa"),
        "rated_pressure": Range(1e-3, 1e12, "Pa", optional=True),
        "supply_sag": Range(1e-3, 1e15, "Pa/m", zero=True),
        "spool_limit": Range(1e-12, math.inf, "m"),
        "spool_rate_limit": Range(1e-12, math.inf, "m/s"),
        "dead_band": Range(1e-15, 1e1, "m", zero=True),
        "natural_frequency": Range(1e-2, 1e5, "Hz", optional=True),
        "damping_ratio": Range(1e-2, 1e2),
    },
    "StrokeStops": {
        "gap": Range(1e-9, math.inf, "m"),
        "stiffness": Range(1e-3, 1e15, "N/m"),
        "damping": Range(1e-3, 1e12, "N s/m", zero=True),
    },
    "Yielding": {
        "yield_drift": Range(1e-9, math.inf, "m"),
        "stiffness_ratio": Range(1e-9, 1.0, zero=True),
        "exponent": Range(1.0, 1e3),
    },
    "Scenario": {
        "physics_step": Range(1e-6, 1.0, "s"),
        "control_rate": Range(0.5, 1e6, "Hz"),
        "current_limit": Range(1e-9, 1e6, "A"),
        "delay": Range(0.0, 1e3, "physics steps"),
    },
    "Sensor": {
        "noise": Range(1e-15, 1e12, "of the signal", zero=True),
        "bias": Range(1e-15, 1e12, "of the signal", zero=True),
        "resolution": Range(1e-15, 1e12, "of the signal", zero=True),
        "lowpass_frequency": Range(1e-3, 1e6, "Hz", optional=True),
        "gain_error": Range(1e-9, 1.0, zero=True),
    },
    "Sensing": {
        "preview": Range(1e-6, 1e2, "s", zero=True),
        "preview_spacing": Range(1e-6, 1e2, "s", optional=True),
        "history": Range(0, 10_000, "control periods", whole=True),
    },
    "TableCapacity": {
        "displacement": Range(1e-9, 1e6, "m"),
        "velocity": Range(1e-9, 1e6, "m/s"),
        "acceleration": Range(1e-9, math.inf, "m/s^2"),
        "force": Range(1e-9, 1e15, "N"),
        "moving_mass": Range(1e-3, 1e12, "kg"),
        "table_damping": Range(1e-6, 1e9, "N s/m", zero=True),
    },
}
"""Class, or class and constructor, to field to range."""

UNCERTAIN = {
    "mass_ratio": RANGES["Specimen.uniform"]["mass_ratio"],
    "storey_frequency": RANGES["Specimen.uniform"]["storey_frequency"],
    "damping_ratio": RANGES["Specimen.uniform"]["damping_ratio"],
    "bulk_modulus": RANGES["Actuator"]["bulk_modulus"],
    "leakage": RANGES["Actuator"]["leakage"],
    "valve_time_constant": RANGES["Actuator"]["valve_time_constant"],
    "valve_gain": RANGES["Actuator"]["valve_gain"],
    "coulomb_friction": RANGES["Friction"]["coulomb"],
    "delay": RANGES["Scenario"]["delay"],
    "table_mass": RANGES["Actuator"]["table_mass"],
    "supply_pressure": Range(1e-3, 1e12, "Pa"),
    "valve_natural_frequency": Range(1e-2, 1e5, "Hz"),
    "storey_factor": Range(1e-3, 1e3),
}  # of what an `Uncertainty` draws


def check_ranges(owner: object) -> None:
    """Raise ParameterError unless every field of `owner` is within its range."""
    for field, allowed in RANGES[type(owner).__name__].items():
        check(field, getattr(owner, field), allowed)


def check(field: str, value: object, allowed: Range) -> None:
    """Raise ParameterError unless the `value` of a parameter is within its range."""
    if not allowed.holds(value):
        raise ParameterError(field, value, allowed.remedy)
