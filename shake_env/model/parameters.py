"""SI parameters of the actuator, the specimen and the ground-motion filter.

The defaults are Table I of Gavin and Hoagg (ACC 2009). Values are frozen and checked when made; what
can be derived from them is a property.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import islice
from typing import Any, TypeVar

import numpy as np
import scipy  # loads scipy.linalg on first use, which takes a third of a second

from shake_env.errors import ParameterError
from shake_env.model.matrices import FloatArray as FloatArray
from shake_env.model.matrices import chain_matrix, symmetric_rows
from shake_env.model.matrices import diagonal as diagonal
from shake_env.model.nonlinearity import Nonlinearity, ServoValve
from shake_env.model.ranges import RANGES, check, check_ranges
from shake_env.model.ranges import is_number as is_number

TABLE_MASS = 180.0  # m_a [kg] of Table I; a specimen's mass ratio refers to it unless told otherwise
GRAVITY = 9.80665  # [m/s^2] standard gravity, used only where a record comes in units of g


Part = TypeVar("Part", "Actuator", "Specimen", ServoValve, Nonlinearity)


def replace_unchecked(part: Part, **changes: Any) -> Part:
    """Return a copy of parameters with fields changed that follow from checked ones: none is checked."""
    changed = copy.copy(part)
    for name, value in changes.items():
        object.__setattr__(changed, name, value)
    return changed


def stacked(parts: Sequence[Part]) -> Part:
    """Return the parameters of N plants as one, whose numbers are arrays, (N,) or (N, stories).

    Each of `parts` was checked when it was made.
    """
    columns = {f.name: [getattr(part, f.name) for part in parts] for f in fields(parts[0])}
    given = {name: values for name, values in columns.items() if any(v is not None for v in values)}
    return replace_unchecked(parts[0], **{name: np.array(values) for name, values in given.items()})


def require_positive(owner: object, *fields: str) -> None:
    """Raise ParameterError unless each named field is a finite number above zero."""
    for field in fields:
        value = getattr(owner, field)
        if not (is_number(value) and 0.0 < value < math.inf):
            raise ParameterError(field, value, "must be a finite number above 0")


def require_non_negative(owner: object, *fields: str) -> None:
    """Raise ParameterError unless each named field is a finite number of at least zero."""
    for field in fields:
        value = getattr(owner, field)
        if not (is_number(value) and 0.0 <= value < math.inf):
            raise ParameterError(field, value, "must be a finite number of at least 0")


@dataclass(frozen=True, kw_only=True)
class Actuator:
    """Servo-hydraulic actuator and table (paper, eqs. 1 to 3 and Table I).

    Raises
    ------
    ParameterError
        If a mass, area, volume, modulus, gain or time constant is not above zero, or a stiffness,
        damping or leakage is negative.
    """

    table_mass: float = TABLE_MASS  # [kg] m_a, platen, piston and what is fixed to them
    table_damping: float = 1000.0  # [N s/m] c_a, viscous friction of table and actuator
    table_stiffness: float = 0.0  # [N/m] k_a, spring between table and ground; none in most tables
    piston_area: float = 0.00237  # [m^2] A_p, effective area
    oil_volume: float = 0.00036  # [m^3] V, oil in both chambers and in the lines to the valve
    bulk_modulus: float = 1.4e8  # [Pa] beta, of the oil with its air
    leakage: float = 1e-16  # [m^3/(Pa s)] K_c, leakage and flow-pressure coefficient
    flow_gain: float = 76.0  # [m^2/s] K_q, flow for a spool displacement
    valve_gain: float = 5e-4  # [m/A] K_v, spool displacement for a current
    valve_time_constant: float = 0.010  # [s] T_v, of the first-order valve

    def __post_init__(self) -> None:
        check_ranges(self)

    @property
    def oil_stiffness(self) -> float:
        """Stiffness of the oil column k_ac = 4 beta A_p^2 / V [N/m] (Table I)."""
        return 4.0 * self.bulk_modulus * self.piston_area**2 / self.oil_volume

    @property
    def velocity_gain(self) -> float:
        """Steady velocity of the unloaded table for an ampere, K_q K_v / A_p [m/(s A)]."""
        return self.flow_gain * self.valve_gain / self.piston_area

    @property
    def oil_column_frequency(self) -> float:
        """Oil-column frequency f_ac [Hz]: 35.07 with Table I, where the paper's text says 30."""
        return math.sqrt(self.oil_stiffness / self.table_mass) / (2.0 * math.pi)

    @property
    def oil_column_damping(self) -> float:
        """Oil-column damping ratio zeta_ac [-]: 0.0126 with Table I (the text says 0.01)."""
        return self.table_damping / (2.0 * math.sqrt(self.table_mass * self.oil_stiffness))


@dataclass(frozen=True, kw_only=True)
class Specimen:
    """A structure on the table, a shear building or any other; floors are counted upwards.

    Give per-storey values here, or use :meth:`uniform` for equal storeys. A structure that is no chain
    of storeys has matrices besides (`shake_env.model.specimens`), of floors that move in one direction
    relative to the table. `masses` are then the sums of the rows of M, and `stiffnesses` and `dampings`
    those of a similar shear building, by which the program scales.

    Raises
    ------
    ParameterError
        If there is no storey, the arrays differ in length, a mass or stiffness is not above zero, or
        a damping is negative.
    """

    masses: tuple[float, ...]  # (stories,) [kg]
    stiffnesses: tuple[float, ...]  # (stories,) [N/m], storey i between floors i-1 and i
    dampings: tuple[float, ...]  # (stories,) [N s/m]
    # (stories, stories) where the structure is no shear building; None: as the storeys give it
    coupled_masses: tuple[tuple[float, ...], ...] | None = None  # M [kg]
    coupled_stiffnesses: tuple[tuple[float, ...], ...] | None = None  # K [N/m]
    coupled_dampings: tuple[tuple[float, ...], ...] | None = None  # C [N s/m]

    def __post_init__(self) -> None:
        most = RANGES["Specimen.uniform"]["stories"]
        for field, allowed in RANGES["Specimen"].items():
            try:
                values = tuple(islice(getattr(self, field), int(most.high) + 1))
            except TypeError:
                values = (None,)
            if not all(is_number(value) for value in values):
                raise ParameterError(
                    field, getattr(self, field), "must be a sequence of numbers, one per storey"
                )
            for storey, value in enumerate(values, start=1):
                check(f"{field}[storey {storey}]", value, allowed)
            if len(values) > most.high:
                raise ParameterError(f"storeys of {field}", f"over {most.high:g}", most.remedy)
            object.__setattr__(self, field, tuple(float(value) for value in values))
        lengths = (len(self.masses), len(self.stiffnesses), len(self.dampings))
        if lengths[0] < 1 or len(set(lengths)) != 1:
            raise ParameterError(
                "masses, stiffnesses, dampings",
                lengths,
                "give the same number of storeys (at least 1) in all three",
            )
        for field in ("coupled_masses", "coupled_stiffnesses", "coupled_dampings"):
            if getattr(self, field) is not None:
                object.__setattr__(self, field, symmetric_rows(field, getattr(self, field), lengths[0]))
        if self.coupled and (self.coupled_stiffnesses is None or self.coupled_dampings is None):
            raise ParameterError("coupled_stiffnesses, coupled_dampings", None, "give both, or none")

    @classmethod
    def uniform(
        cls,
        *,
        stories: int = 2,
        mass_ratio: float = 0.5,
        storey_frequency: float = 7.0,
        damping_ratio: float = 0.05,
        table_mass: float = TABLE_MASS,
    ) -> Specimen:
        """Return equal storeys by the rules of Table I.

        Parameters
        ----------
        stories
            Number of storeys n_m, at least 1.
        mass_ratio
            mu: specimen mass over table mass [-], above 0.
        storey_frequency
            f_1 = sqrt(k/m) / (2 pi) of one storey [Hz]; not the first mode of the building.
        damping_ratio
            zeta_1 of one storey [-], at least 0.
        table_mass
            m_a that `mass_ratio` refers to [kg].
        """
        values = (stories, mass_ratio, storey_frequency, damping_ratio, table_mass)
        for (field, allowed), value in zip(RANGES["Specimen.uniform"].items(), values, strict=True):
            check(field, value, allowed)
        mass = mass_ratio * table_mass / stories
        stiffness = (2.0 * math.pi * storey_frequency) ** 2 * mass
        damping = 2.0 * damping_ratio * math.sqrt(mass * stiffness)
        return cls(
            masses=(mass,) * stories,
            stiffnesses=(stiffness,) * stories,
            dampings=(damping,) * stories,
        )

    def uniform_values(self, table_mass: float = TABLE_MASS) -> dict[str, Any]:
        """Return what :meth:`uniform` would have made this specimen of.

        Raises
        ------
        ParameterError
            If its storeys differ.
        """
        m, k, c = self.masses[0], self.stiffnesses[0], self.dampings[0]
        if (
            self.coupled
            or set(self.masses) != {m}
            or set(self.stiffnesses) != {k}
            or set(self.dampings) != {c}
        ):
            raise ParameterError(
                "specimen", self, "its storeys differ: change it with specimen=Specimen(...)"
            )
        return {
            "stories": self.stories,
            "mass_ratio": self.mass / table_mass,
            "storey_frequency": math.sqrt(k / m) / (2.0 * math.pi),
            "damping_ratio": c / (2.0 * math.sqrt(m * k)),
        }

    @property
    def stories(self) -> int:
        """Number of storeys n_m."""
        return np.shape(self.masses)[-1]

    @property
    def mass(self) -> float:
        """Total mass [kg]."""
        return math.fsum(self.masses)

    @property
    def mass_matrix(self) -> FloatArray:
        """M, (..., stories, stories) [kg]."""
        return diagonal(self.masses) if self.coupled_masses is None else np.array(self.coupled_masses)

    @property
    def stiffness_matrix(self) -> FloatArray:
        """K, (..., stories, stories) [N/m]; tridiagonal for storeys."""
        given = self.coupled_stiffnesses
        return chain_matrix(self.stiffnesses) if given is None else np.array(given)

    @property
    def damping_matrix(self) -> FloatArray:
        """C, (..., stories, stories) [N s/m]; tridiagonal for storeys."""
        return (
            chain_matrix(self.dampings)
            if self.coupled_dampings is None
            else np.array(self.coupled_dampings)
        )

    @property
    def coupled(self) -> bool:
        """Whether matrices say what the structure is, and not its storeys."""
        matrices = (self.coupled_masses, self.coupled_stiffnesses, self.coupled_dampings)
        return any(matrix is not None for matrix in matrices)

    def scaled(self, *, mass: float = 1.0, frequency: float = 1.0, damping: float = 1.0) -> Specimen:
        """Return the structure with every mass, frequency and damping ratio times a factor."""
        factors = {"masses": mass, "stiffnesses": mass * frequency**2}
        factors["dampings"] = mass * frequency * damping
        changes: dict[str, Any] = {}
        for name, factor in factors.items():
            changes[name] = tuple(factor * value for value in getattr(self, name))
            matrix = getattr(self, f"coupled_{name}")
            if matrix is not None:
                changes[f"coupled_{name}"] = tuple(tuple(factor * v for v in row) for row in matrix)
        return replace(self, **changes)

    @property
    def undamped(self) -> Specimen:
        """The structure without damping, for its natural frequencies."""
        none = None if not self.coupled else tuple((0.0,) * self.stories for _ in self.masses)
        return replace(self, dampings=(0.0,) * self.stories, coupled_dampings=none)

    @property
    def fixed_base_frequencies(self) -> FloatArray:
        """Undamped natural frequencies on a fixed base, (stories,) [Hz], rising."""
        if self.coupled:
            squares = scipy.linalg.eigh(self.stiffness_matrix, self.mass_matrix, eigvals_only=True)
        else:
            root = np.sqrt(np.asarray(self.masses))
            squares = np.linalg.eigvalsh(self.stiffness_matrix / np.outer(root, root))
        frequencies: FloatArray = np.sqrt(squares) / (2.0 * np.pi)
        return frequencies


@dataclass(frozen=True, kw_only=True)
class GroundFilter:
    """Filter from white noise to the target acceleration (paper, eqs. 9 to 11).

    The Kanai-Tajimi form of the paper lets the ground drift away as a random walk. `highpass_frequency`
    adds Clough and Penzien's second filter, whose two states are the displacement and velocity of the
    ground, so that both stay bounded.

    Raises
    ------
    ParameterError
        If a frequency or a damping ratio is not above zero.
    """

    frequency: float = 1.1  # omega_g / (2 pi) [Hz]
    damping_ratio: float = 1.4  # zeta_g [-]
    highpass_frequency: float | None = None  # [Hz]; None leaves the high-pass out
    highpass_damping_ratio: float = 0.7  # [-]

    def __post_init__(self) -> None:
        check_ranges(self)

    @property
    def omega(self) -> float:
        """omega_g [rad/s]."""
        return 2.0 * math.pi * self.frequency

    @property
    def states(self) -> int:
        """Number of filter states: 2, or 4 with the high-pass."""
        return 2 if self.highpass_frequency is None else 4


@dataclass(frozen=True, kw_only=True)
class ModelEquations:
    """Which form of the paper's equations the plant uses; each difference is a switch of its own.

    The default is the corrected model. :meth:`as_printed` returns the published one, for reproducing
    the paper only.
    """

    reaction_on_table: bool = True
    """True: f_s enters the table's equation with +1/m_a. False: with -1/m_a, as eq. 3 prints it."""
    shear_in_table_acceleration: bool = True
    """True: y_A = v_a', which contains f_s/m_a. False: y_A = C_A x_A, as eq. 5 prints it."""
    specimen_feels_target: bool = False
    """False: the specimen on the table feels the table only. True: eq. 13's B_S C_W in row 3."""
    oil_modulus_in_stiffness: bool = True
    """True: 4 beta / V in the oil's equation. False: 4 V / V, as eq. 3 prints it (a misprint in units,
    contradicted by Table I; no part of :meth:`as_printed`)."""

    def __post_init__(self) -> None:
        for field, value in vars(self).items():
            if not isinstance(value, bool):
                raise ParameterError(field, value, "must be True or False")

    @classmethod
    def corrected(cls) -> ModelEquations:
        """Return the corrected equations (the default)."""
        return cls()

    @classmethod
    def as_printed(cls) -> ModelEquations:
        """Return the equations as published (eqs. 3, 5 and 13), with Table I's oil stiffness."""
        return cls(
            reaction_on_table=False, shear_in_table_acceleration=False, specimen_feels_target=True
        )

    @classmethod
    def named(cls, name: Any) -> ModelEquations:
        """Return the equations called `name`: ``"corrected"`` or ``"as_printed"``."""
        forms = {"corrected": cls.corrected, "as_printed": cls.as_printed}
        if not isinstance(name, str) or name not in forms:
            raise ParameterError("equations", name, f"known: {', '.join(sorted(forms))}")
        return forms[name]()
