"""Parameters to continuous state space: actuator, specimen, ground filter and the coupled plant.

Leading axes are the batch: from parameters that are `stacked`, every matrix comes out one a plant.

Full state, in order (SI): ``[x_W, x_A, x_S, x~_S]`` - ground filter, actuator ``[p_l, x_a, v_a, x_v]``,
specimen ``[x_r, x_r']`` relative to the table, and the reference specimen on real ground.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy  # loads scipy.linalg on first use, which takes a third of a second
from numpy.typing import NDArray

from shake_env.errors import NumericalError, ParameterError
from shake_env.model.parameters import (
    Actuator,
    FloatArray,
    GroundFilter,
    ModelEquations,
    Specimen,
    diagonal,
)
from shake_env.model.specimens import damped_specimen

LOAD_PRESSURE, TABLE_DISPLACEMENT, TABLE_VELOCITY, SPOOL_POSITION = range(4)  # places in x_A

REFERENCE_CURRENT = 0.025  # [A] rated current of the valve; unit of the current in the stage cost


@dataclass(frozen=True)
class StateSpace:
    """Continuous linear model ``x' = A x + B u``, ``y = C x + D u`` (SI).

    Raises
    ------
    ParameterError
        If the shapes do not fit together.
    """

    A: FloatArray  # (..., n, n)
    B: FloatArray  # (..., n, inputs)
    C: FloatArray  # (..., outputs, n)
    D: FloatArray  # (..., outputs, inputs)

    def __post_init__(self) -> None:
        check_shapes(self.A, self.B, self.C, self.D)

    @property
    def order(self) -> int:
        """Number of states n."""
        return int(self.A.shape[-1])

    def frequency_response(self, omega: FloatArray) -> FloatArray:
        """Return G(j omega), complex (frequencies, outputs, inputs); `omega` (frequencies,) [rad/s]."""
        identity = np.eye(self.order)
        resolvent = np.linalg.solve(1j * omega[:, None, None] * identity - self.A, self.B + 0j)
        response: FloatArray = self.C @ resolvent + self.D
        return response


def check_shapes(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> None:
    """Raise ParameterError unless the four matrices make one linear model."""
    shapes = (A.shape, B.shape, C.shape, D.shape)
    *batch, _, n = A.shape
    inputs, outputs = B.shape[-1], C.shape[-2]
    if shapes != tuple(
        (*batch, *pair) for pair in ((n, n), (n, inputs), (outputs, n), (outputs, inputs))
    ):
        raise ParameterError("A, B, C, D shapes", shapes, "must be (n,n), (n,i), (o,n), (o,i)")


def submatrix(matrix: FloatArray, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> FloatArray:
    """Return some rows and columns of each matrix (..., m, n)."""
    part: FloatArray = matrix[..., rows[:, None], columns]
    return part


@dataclass(frozen=True)
class StateLayout:
    """Where each part of the full state lies."""

    filter_states: int
    stories: int

    @property
    def order(self) -> int:
        """Length n of the full state."""
        return self.filter_states + 4 + 4 * self.stories

    @property
    def ground(self) -> slice:
        """x_W, the ground filter."""
        return slice(0, self.filter_states)

    @property
    def actuator(self) -> slice:
        """x_A = [p_l, x_a, v_a, x_v]."""
        return slice(self.filter_states, self.filter_states + 4)

    @property
    def specimen(self) -> slice:
        """x_S = [x_r, x_r']."""
        return slice(self.filter_states + 4, self.filter_states + 4 + 2 * self.stories)

    @property
    def controlled(self) -> slice:
        """[x_A, x_S], the part that the current reaches; 4 + 2 stories long."""
        return slice(self.filter_states, self.filter_states + 4 + 2 * self.stories)

    @property
    def reference(self) -> slice:
        """x~_S, the reference specimen."""
        return slice(self.filter_states + 4 + 2 * self.stories, self.order)

    @property
    def table_displacement(self) -> int:
        """Index of x_a."""
        return self.filter_states + TABLE_DISPLACEMENT

    @property
    def table_velocity(self) -> int:
        """Index of v_a."""
        return self.filter_states + TABLE_VELOCITY

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each state with its unit, in order."""
        ground: tuple[str, ...] = ("ground filter x_w [m/s]", "ground filter x_w' [m/s^2]")
        if self.filter_states == 4:
            ground += ("ground displacement [m]", "ground velocity [m/s]")
        table = (
            "load pressure [Pa]", "table displacement [m]", "table velocity [m/s]",
            "valve spool position [m]",
        )  # fmt: skip
        floors = range(1, self.stories + 1)
        return (
            ground
            + table
            + tuple(
                f"{who} floor {floor} {what}"
                for who in ("specimen", "reference")
                for what in ("displacement [m]", "velocity [m/s]")
                for floor in floors
            )
        )


def ground_filter(ground: GroundFilter) -> StateSpace:
    """Return the filter from white noise w to the target acceleration y~ (eqs. 9 to 11).

    With the high-pass the states are ``[x_w, x_w', ground displacement, ground velocity]``.
    """
    omega, zeta = ground.omega, ground.damping_ratio
    A = np.array([[0.0, 1.0], [-(omega**2), -2.0 * zeta * omega]])
    B = np.array([[0.0], [1.0]])
    C = np.array([[0.0, 2.0 * zeta * omega]])
    if ground.highpass_frequency is None:
        return StateSpace(A, B, C, np.zeros((1, 1)))
    omega_h = 2.0 * np.pi * ground.highpass_frequency
    spring = np.array([[-(omega_h**2), -2.0 * ground.highpass_damping_ratio * omega_h]])
    A_full = np.block([[A, np.zeros((2, 2))], [np.zeros((1, 2)), np.array([[0.0, 1.0]])], [C, spring]])
    return StateSpace(A_full, np.pad(B, ((0, 2), (0, 0))), np.hstack([C, spring]), np.zeros((1, 1)))


def specimen_plant(specimen: Specimen) -> StateSpace:
    """Return the specimen from the acceleration of its base to its base shear f_s (eqs. 6 to 8)."""
    n, batch = specimen.stories, np.shape(specimen.masses)[:-1]
    A, B = np.zeros((*batch, 2 * n, 2 * n)), np.zeros((*batch, 2 * n, 1))
    C = np.zeros((*batch, 1, 2 * n))
    A[..., :n, n:] = np.eye(n)
    K, damping = specimen.stiffness_matrix, specimen.damping_matrix
    if specimen.coupled:
        A[..., n:, :n] = -np.linalg.solve(specimen.mass_matrix, K)
        A[..., n:, n:] = -np.linalg.solve(specimen.mass_matrix, damping)
        # The base carries what accelerates all floors: 1'M (x_r'' + 1 y_A) = -(1'K x_r + 1'C x_r').
        C[..., 0, :n], C[..., 0, n:] = K.sum(axis=-2), damping.sum(axis=-2)
    else:
        inverse_mass = diagonal(1.0 / np.asarray(specimen.masses))
        A[..., n:, :n] = -inverse_mass @ K
        A[..., n:, n:] = -inverse_mass @ damping
        C[..., 0, 0] = np.asarray(specimen.stiffnesses)[..., 0]
        C[..., 0, n] = np.asarray(specimen.dampings)[..., 0]
    B[..., n:, 0] = -1.0
    return StateSpace(A, B, C, np.zeros((*batch, 1, 1)))


def actuator_plant(actuator: Actuator, equations: ModelEquations) -> StateSpace:
    """Return the actuator and table: inputs ``[u, f_s]`` [A, N], output y_A [m/s^2] (eqs. 1 to 5)."""
    a = actuator
    modulus = a.bulk_modulus if equations.oil_modulus_in_stiffness else a.oil_volume
    oil = 4.0 * modulus / a.oil_volume
    batch = np.shape(a.table_mass)
    A, B, D = np.zeros((*batch, 4, 4)), np.zeros((*batch, 4, 2)), np.zeros((*batch, 1, 2))
    A[..., 0, 0], A[..., 0, 2], A[..., 0, 3] = oil * -a.leakage, oil * -a.piston_area, oil * a.flow_gain
    A[..., 1, 2] = 1.0
    A[..., 2, 0] = a.piston_area / a.table_mass
    A[..., 2, 1] = -a.table_stiffness / a.table_mass
    A[..., 2, 2] = -a.table_damping / a.table_mass
    A[..., 3, 3] = -1.0 / a.valve_time_constant
    B[..., 2, 1] = (1.0 if equations.reaction_on_table else -1.0) / a.table_mass
    B[..., 3, 0] = a.valve_gain / a.valve_time_constant
    if equations.shear_in_table_acceleration:
        D[..., 0, 1] = B[..., 2, 1]
    return StateSpace(A, B, A[..., 2:3, :].copy(), D)


_REMEDY = "frequencies and damping ratios of ground and specimen lie too far apart: bring them closer"


def stationary_covariance(A: FloatArray, B: FloatArray) -> FloatArray:
    """Return the stationary covariance (..., n, n) of ``x' = A x + B w`` under unit white noise w.

    Raises
    ------
    NumericalError
        If the equation has no finite solution.
    """
    intensity = B @ np.swapaxes(B, -1, -2)
    n = A.shape[-1]
    pairs = zip(A.reshape(-1, n, n), intensity.reshape(-1, n, n), strict=True)
    try:
        solutions = [scipy.linalg.solve_continuous_lyapunov(a, -q) for a, q in pairs]
        covariance = np.array(solutions).reshape(A.shape)
    except (np.linalg.LinAlgError, ValueError) as error:  # singular; not finite
        raise NumericalError("stationary covariance", str(error), _REMEDY) from None
    if not np.isfinite(covariance).all():
        raise NumericalError("stationary covariance", "not finite", _REMEDY)
    return covariance


def _variance(A: FloatArray, B: FloatArray, row: FloatArray, scale: FloatArray) -> Any:
    """Return the mean square (...) of ``row x``, scaled for the arithmetic."""
    scaled = A * scale[..., None, :] / scale[..., None]
    return _quadratic(row * scale, stationary_covariance(scaled, B / scale[..., None]))


def _quadratic(row: FloatArray, matrix: FloatArray) -> Any:
    square = (row[..., None, :] @ matrix @ row[..., :, None])[..., 0, 0]
    return square if square.ndim else float(square)


@dataclass(frozen=True)
class CoupledPlant:
    """Actuator, specimen and reference specimen under one target acceleration."""

    actuator: Actuator
    specimen: Specimen
    ground: GroundFilter
    equations: ModelEquations

    @property
    def layout(self) -> StateLayout:
        """Where each part of the full state lies."""
        return StateLayout(self.ground.states, self.specimen.stories)

    @cached_property
    def driven(self) -> StateSpace:
        """The plant without its ground filter.

        States ``[x_A, x_S, x~_S]``, inputs ``[u, y~]`` [A, m/s^2], outputs ``[y_A, f_s, f~_s]``
        [m/s^2, N, N].
        """
        table = actuator_plant(self.actuator, self.equations)
        building = specimen_plant(self.specimen)
        m, batch = building.order, table.A.shape[:-2]
        A = np.zeros((*batch, 4 + 2 * m, 4 + 2 * m))
        B = np.zeros((*batch, 4 + 2 * m, 2))
        C = np.zeros((*batch, 3, 4 + 2 * m))
        a, s, r = slice(0, 4), slice(4, 4 + m), slice(4 + m, 4 + 2 * m)
        C[..., 0, a] = table.C[..., 0, :]
        C[..., 0, s] = table.D[..., 0, 1:] * building.C[..., 0, :]
        C[..., 1, s] = building.C[..., 0, :]
        C[..., 2, r] = building.C[..., 0, :]
        A[..., a, a] = table.A
        A[..., a, s] = table.B[..., 1:] @ building.C
        A[..., s, :] = building.B @ C[..., :1, :]
        A[..., s, s] += building.A
        A[..., r, r] = building.A
        B[..., a, 0] = table.B[..., 0]
        B[..., r, 1] = building.B[..., 0]
        if self.equations.specimen_feels_target:
            B[..., s, 1] = building.B[..., 0]
        return StateSpace(A, B, C, np.zeros((*batch, 3, 2)))

    @cached_property
    def coupled(self) -> StateSpace:
        """The whole plant of eq. 13.

        States ``[x_W, x_A, x_S, x~_S]``, inputs ``[u, w]``, outputs ``[y_A, f_s, y~, f~_s]``.
        """
        source, driven = ground_filter(self.ground), self.driven
        w, n, batch = source.order, driven.order, driven.A.shape[:-2]
        A, B = np.zeros((*batch, w + n, w + n)), np.zeros((*batch, w + n, 2))
        C = np.zeros((*batch, 4, w + n))
        A[..., :w, :w] = source.A
        A[..., w:, :w] = driven.B[..., 1:] @ source.C
        A[..., w:, w:] = driven.A
        B[..., w:, 0] = driven.B[..., 0]
        B[..., :w, 1] = source.B[:, 0]
        C[..., [0, 1, 3], w:] = driven.C
        C[..., 2, :w] = source.C[0]
        return StateSpace(A, B, C, np.zeros((*batch, 4, 2)))

    @cached_property
    def state_scale(self) -> FloatArray:
        """Size of each state, (..., n) in SI: the one place where states are scaled.

        A state's scale is its rms in a table that tracks the unit-intensity target perfectly. The
        numerical methods scale by it inside, and observations are divided by it. The high-pass and the
        amplitude of a motion leave it as it is, so that a gain or a policy keeps its meaning. A storey
        damped below 1 % counts as damped by 1 % here: an undamped one has no finite rms.
        """
        plain = GroundFilter(frequency=self.ground.frequency, damping_ratio=self.ground.damping_ratio)
        damped = damped_specimen(self.specimen)
        base = CoupledPlant(self.actuator, damped, plain, ModelEquations())
        a, layout = self.actuator, base.layout
        exogenous = np.r_[layout.ground, layout.reference]
        A = submatrix(base.coupled.A, exogenous, exogenous)
        variance = stationary_covariance(A, base.coupled.B[..., exogenous, 1:])
        if not np.all(np.diagonal(variance, axis1=-2, axis2=-1) > 0.0):
            raise NumericalError("stationary covariance", "not positive", _REMEDY)
        rms = np.sqrt(np.diagonal(variance, axis1=-2, axis2=-1))
        shear = np.sqrt(_quadratic(base.coupled.C[..., 3, exogenous], variance))
        omega, zeta = plain.omega, plain.damping_ratio
        acceleration, velocity = np.sqrt(zeta * omega), np.sqrt(zeta / omega)
        force = np.sqrt(
            (a.table_mass * acceleration) ** 2 + (a.table_damping * velocity) ** 2 + shear**2
        )
        displacement = velocity / omega
        table = (
            force / a.piston_area, displacement, velocity, a.piston_area * velocity / a.flow_gain,
        )  # fmt: skip
        highpass = (displacement, velocity) if self.ground.states == 4 else ()
        middle = np.stack(np.broadcast_arrays(*highpass, *table), axis=-1)
        building = rms[..., 2:]
        return np.concatenate([rms[..., :2], middle, building, building], axis=-1)

    @cached_property
    def target_variance(self) -> float:
        """||G_W||^2 [(m/s^2)^2]: mean square of the stationary target at unit intensity."""
        source = ground_filter(self.ground)
        # Of all plants of a stack the same, and so is the scale of its states.
        scale = self.state_scale.reshape(-1, self.layout.order)[0, self.layout.ground]
        return float(_variance(source.A, source.B, source.C[0], scale))

    @cached_property
    def reference_shear_variance(self) -> Any:
        """||f~_s||^2 [N^2], (...): mean square of the reference base shear at unit intensity."""
        if np.min(self.specimen.dampings) == 0.0:
            raise ParameterError(
                "dampings",
                self.specimen.dampings,
                "an undamped reference specimen has no stationary base shear to normalise by: "
                "damp every storey, or give the force no weight",
            )
        coupled, states = self.coupled, np.r_[self.layout.ground, self.layout.reference]
        A, B = submatrix(coupled.A, states, states), coupled.B[..., states, 1:]
        return _variance(A, B, coupled.C[..., 3, states], self.state_scale[..., states])

    @property
    def natural_frequencies(self) -> FloatArray:
        """Undamped frequencies of table, oil column and specimen together, (1 + stories,) [Hz].

        Taken from the coupled state space with every damping, leakage and the valve removed, so that
        they show what the equations in use contain.
        """
        eigenvalues = np.linalg.eigvals(self._undamped)
        # What does not oscillate (position and spool) has eigenvalues on the real axis and sorts last.
        return np.sort(eigenvalues.imag)[-(1 + self.specimen.stories) :] / (2.0 * np.pi)

    @property
    def oil_column_frequency(self) -> float:
        """The one of the natural frequencies [Hz] whose mode the load pressure takes most part in.

        Mostly the highest; a stiff storey's may lie above it. A state's part in a mode is the product of
        its entries in the right and the left eigenvector, whatever its unit (Perez-Arriaga et al., IEEE
        Trans. Power Apparatus and Systems 101, 1982).
        """
        poles, right = np.linalg.eig(self._undamped)
        part = np.abs(right[LOAD_PRESSURE] * np.linalg.inv(right)[:, LOAD_PRESSURE])
        frequency = poles.imag[np.argmax(np.where(poles.imag > 0.0, part, 0.0))] / (2.0 * np.pi)
        frequencies = self.natural_frequencies
        return float(frequencies[np.argmin(np.abs(frequencies - frequency))])

    @property
    def _undamped(self) -> FloatArray:
        """State matrix (4 + 2 stories, ...) of table and specimen without damping, scaled."""
        actuator = replace(self.actuator, table_damping=0.0, leakage=0.0)
        undamped = CoupledPlant(actuator, self.specimen.undamped, self.ground, self.equations)
        layout = undamped.layout
        keep = np.r_[layout.controlled]
        A = undamped.coupled.A[np.ix_(keep, keep)]
        scale = undamped.state_scale[keep]
        scaled: FloatArray = A * scale / scale[:, None]
        return scaled
