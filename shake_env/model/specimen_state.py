"""What a specimen at rest keeps of the shakes that it has borne."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.nonlinearity import Yielding
from shake_env.model.parameters import FloatArray

SLIP, REFERENCE_SLIP = "storey_slip", "reference_storey_slip"
ENERGY, REFERENCE_ENERGY = "dissipated_energy", "reference_dissipated_energy"


@dataclass(frozen=True, kw_only=True)
class SpecimenState:
    """Damage of a specimen at rest, and of the reference specimen under the same motions.

    A yielding storey at rest bears no force: with slip s its drift is ``(1 - alpha) s``, alpha the
    stiffness ratio of `Yielding`. An episode that begins from this state goes on as if the two shakes
    were one motion with a long rest between them.

    Raises
    ------
    ParameterError
        If a value is not finite, an energy negative, or the two specimens have other numbers of storeys.
    """

    slip: tuple[float, ...] = ()  # s of each storey [m]; (): no storey has yielded
    reference_slip: tuple[float, ...] = ()  # likewise, of the reference specimen
    energy: float = 0.0  # dissipated in the first storey so far [J]
    reference_energy: float = 0.0  # likewise, in the reference specimen's

    def __post_init__(self) -> None:
        for name in ("slip", "reference_slip"):
            object.__setattr__(self, name, tuple(map(float, getattr(self, name))))
            if not all(map(math.isfinite, getattr(self, name))):
                raise ParameterError(name, getattr(self, name), "must hold finite numbers [m]")
        if len(self.slip) != len(self.reference_slip):
            sizes = (len(self.slip), len(self.reference_slip))
            raise ParameterError("slip, reference_slip", sizes, "must have as many storeys each")
        for name in ("energy", "reference_energy"):
            value = getattr(self, name)
            if not (isinstance(value, float | int) and 0.0 <= value < math.inf):
                raise ParameterError(name, value, "must be at least 0 J, finite")

    @property
    def values(self) -> dict[str, float]:
        """Values by name, as samples of a plant hold them."""
        named = {f"{SLIP}_{i}": value for i, value in enumerate(self.slip, start=1)}
        named |= {f"{REFERENCE_SLIP}_{i}": v for i, v in enumerate(self.reference_slip, start=1)}
        return named | {ENERGY: self.energy, REFERENCE_ENERGY: self.reference_energy}

    @classmethod
    def from_values(cls, values: Mapping[str, float], stories: int) -> SpecimenState | None:
        """Return the state that values by name hold; None where they hold none.

        Raises
        ------
        ParameterError
            If a value is missing or out of range.
        """
        if not any(is_state_value(name) for name in values):
            return None
        places = range(1, stories + 1)
        names = [f"{SLIP}_{i}" for i in places], [f"{REFERENCE_SLIP}_{i}" for i in places]
        for name in (*names[0], *names[1], ENERGY, REFERENCE_ENERGY):
            if name not in values:
                raise ParameterError(name, None, "a state of the specimen needs it: give all of them")
        slip, reference = (tuple(values[name] for name in part) for part in names)
        return cls(
            slip=slip,
            reference_slip=reference,
            energy=values[ENERGY],
            reference_energy=values[REFERENCE_ENERGY],
        )

    @property
    def damaged(self) -> bool:
        """Whether a storey has yielded."""
        return any(self.slip) or any(self.reference_slip)

    def initial(self, yielding: Yielding, stories: int) -> FloatArray | None:
        """Return ``[x_r, x_r', s]`` of specimen and reference (2, 3 stories); None: as new.

        Raises
        ------
        ScenarioError
            If the storeys do not yield, or their number is another.
        """
        if not self.damaged:
            return None
        if not yielding.active:
            remedy = "the scenario's storeys do not yield: set nonlinearity.yielding"
            raise ScenarioError("specimen state", self.slip, remedy)
        if len(self.slip) != stories:
            raise ScenarioError("specimen state", self.slip, f"must hold {stories} storeys")
        slips = np.array([self.slip, self.reference_slip])
        floors = np.cumsum((1.0 - yielding.stiffness_ratio) * slips, axis=1)
        return np.concatenate([floors, np.zeros_like(slips), slips], axis=1)

    def after(
        self, state: FloatArray, reference: FloatArray, energy: float, reference_energy: float
    ) -> SpecimenState:
        """Return the state after a shake.

        Parameters
        ----------
        state, reference
            ``[x_r, x_r', s]`` (3 stories,) of specimen and reference at its end; (0,) where storeys do
            not yield.
        energy, reference_energy
            That it dissipated in the first storey [J]; below 0, by the springs' rest, counts as 0.
        """
        stories = len(state) // 3
        return SpecimenState(
            slip=tuple(state[2 * stories :].tolist()),
            reference_slip=tuple(reference[2 * stories :].tolist()),
            energy=self.energy + max(float(energy), 0.0),
            reference_energy=self.reference_energy + max(float(reference_energy), 0.0),
        )


def is_state_value(name: str) -> bool:
    """Return whether a name is that of a value of a specimen's state."""
    return name in (ENERGY, REFERENCE_ENERGY) or name.startswith((f"{SLIP}_", f"{REFERENCE_SLIP}_"))


NEW = SpecimenState()
