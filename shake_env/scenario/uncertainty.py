"""What is not known of a table and its specimen before the test: ranges drawn at each reset.

The scenario's own values are the nominal model, which controllers are designed on; what is drawn is the
true plant, which nobody is shown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from shake_env.errors import ParameterError
from shake_env.model.ranges import UNCERTAIN, check, is_number

MASS_FACTOR, STIFFNESS_FACTOR = "mass_factor", "stiffness_factor"  # of a storey, by its number


@dataclass(frozen=True)
class Uniform:
    """A uniform distribution from `low` to `high`.

    Raises
    ------
    ParameterError
        If the ends are not finite, not in order, or below zero.
    """

    low: float  # least value that is drawn, in the parameter's unit
    high: float  # largest value that is drawn, in the parameter's unit

    def __post_init__(self) -> None:
        if not (
            is_number(self.low) and is_number(self.high) and 0.0 <= self.low <= self.high < math.inf
        ):
            raise ParameterError(
                "uniform range", (self.low, self.high), "needs 0 <= low <= high, finite"
            )

    def draw(self, stream: np.random.Generator) -> float:
        """Return a value."""
        return float(stream.uniform(self.low, self.high))


@dataclass(frozen=True, kw_only=True)
class Uncertainty:
    """Distributions of the true plant; None leaves a parameter at its nominal value.

    The number of storeys is common to a batch. Storeys are drawn equal (`Specimen.uniform`), and then
    multiplied by a factor each, where `storey_factor` is drawn.
    """

    mass_ratio: Uniform | None = None  # [-]
    storey_frequency: Uniform | None = None  # [Hz]
    damping_ratio: Uniform | None = None  # [-]
    bulk_modulus: Uniform | None = None  # [Pa]
    leakage: Uniform | None = None  # [m^3/(Pa s)]
    valve_time_constant: Uniform | None = None  # [s]
    valve_gain: Uniform | None = None  # [m/A]
    coulomb_friction: Uniform | None = None  # [N]
    delay: Uniform | None = None  # [physics steps], a fraction is allowed
    table_mass: Uniform | None = None  # [kg]; the specimen's mass ratio stays over the nominal one
    supply_pressure: Uniform | None = None  # [Pa]; the flow gain stays that of the rated pressure
    valve_natural_frequency: Uniform | None = None  # [Hz]
    storey_factor: Uniform | None = None  # [-] one on each storey's mass, one on its stiffness

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is not None and not isinstance(value, Uniform):
                raise ParameterError(name, value, "must be a Uniform(low, high), or None")
            for end in () if value is None else (value.low, value.high):
                check(f"uncertainty.{name}", end, UNCERTAIN[name])

    @property
    def active(self) -> bool:
        """Whether anything is drawn."""
        return any(value is not None for value in vars(self).values())

    def sample(self, stream: np.random.Generator, stories: int) -> dict[str, float]:
        """Return a value of each uncertain parameter, drawn in fixed order.

        The factors of the storeys are called mass_factor_1, stiffness_factor_1, ... from the table up.
        """
        values: dict[str, float] = {}
        for name, distribution in vars(self).items():
            if distribution is None:
                continue
            names = [name]
            if name == "storey_factor":
                floors = range(1, stories + 1)
                names = [f"{kind}_{i}" for kind in (MASS_FACTOR, STIFFNESS_FACTOR) for i in floors]
            values |= {each: distribution.draw(stream) for each in names}
        return values

    def largest(self, name: str) -> float | None:
        """Return the largest value that a parameter can have; None where it is not drawn."""
        drawn = getattr(self, name, None)
        return None if drawn is None else float(drawn.high)
