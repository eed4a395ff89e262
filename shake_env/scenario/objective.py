"""The weighted performance z as a stage cost, and the errors by which a test is judged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import array_api_compat

from shake_env.errors import ParameterError
from shake_env.model.plant import REFERENCE_CURRENT, CoupledPlant
from shake_env.model.ranges import RANGES, check, check_ranges

Array = Any  # a numpy array or a torch tensor


@dataclass(frozen=True, kw_only=True)
class Objective:
    """Weights of acceleration tracking, structural-force tracking and valve current.

    The stage cost of a control period is the mean over its physics steps, taken after each step, of
    ``w_a (y_A - y~)^2 / ||G_W||^2 + w_f (f_s - f~_s)^2 / ||f~_s||^2``, plus ``w_u (u / 25 mA)^2``:
    each error relative to the rms of the unit-intensity target. :meth:`raw` gives the paper's weights
    instead, ``q_1^2 (y_A - y~)^2 + q_2^2 (f_s - f~_s)^2 + r^2 u^2`` in SI (eq. 12).

    Raises
    ------
    ParameterError
        If a weight is negative or not finite, or the weight of the current is zero.
    """

    acceleration_weight: float = 1.0  # w_a [-], or q_1^2 [(s^2/m)^2]
    force_weight: float = 1.0  # w_f [-], or q_2^2 [1/N^2]
    current_weight: float = 0.01  # w_u [-], or r^2 [1/A^2]
    normalised: bool = True  # whether errors are relative to the target's rms

    def __post_init__(self) -> None:
        check_ranges(self)

    @classmethod
    def raw(cls, q_1: float, q_2: float, r: float = 1.0) -> Objective:
        """Return the paper's weights on the SI performance z of eq. 12."""
        for (field, allowed), value in zip(RANGES["Objective.raw"].items(), (q_1, q_2, r), strict=True):
            check(field, value, allowed)
        if r == 0.0:
            raise ParameterError("r", r, "must be above 0: a current that costs nothing has no bound")
        return cls(
            acceleration_weight=q_1**2, force_weight=q_2**2, current_weight=r**2, normalised=False
        )

    def coefficients(self, plant: CoupledPlant) -> StageCost:
        """Return the cost with its coefficients in SI for `plant`."""
        if not self.normalised:
            return StageCost(self.acceleration_weight, self.force_weight, self.current_weight)
        force = self.force_weight and self.force_weight / plant.reference_shear_variance
        return StageCost(
            self.acceleration_weight / plant.target_variance,
            force,
            self.current_weight / REFERENCE_CURRENT**2,
        )


@dataclass(frozen=True)
class CostTerms:
    """The three terms of the stage cost, each (...)."""

    acceleration: Array
    force: Array
    current: Array

    @property
    def total(self) -> Array:
        """Stage cost (...)."""
        return self.acceleration + self.force + self.current


@dataclass(frozen=True)
class StageCost:
    """Quadratic stage cost with coefficients in SI."""

    acceleration: float  # [(s^2/m)^2]
    force: float  # [1/N^2]
    current: float  # [1/A^2]

    def terms(
        self,
        table_acceleration: Array,
        target_acceleration: Array,
        base_shear: Array,
        reference_shear: Array,
        current: Array,
    ) -> CostTerms:
        """Return the terms for responses (..., k) after each physics step and a current (...)."""
        xp = array_api_compat.array_namespace(table_acceleration)
        return CostTerms(
            self.acceleration * xp.mean((table_acceleration - target_acceleration) ** 2, axis=-1),
            self.force * xp.mean((base_shear - reference_shear) ** 2, axis=-1),
            self.current * current**2,
        )

    def motionless(self, plant: CoupledPlant) -> float:
        """Return the expected stage cost of a table that stands still under the unit target."""
        force = self.force and self.force * plant.reference_shear_variance
        return self.acceleration * plant.target_variance + force
