"""The update of a table with nonlinear parts: linear part exact, nonlinear forces second order.

``x' = A x + B u + N g(x)`` with g the nonlinear parts' difference from the linear plant, stepped by the
exponential Runge-Kutta scheme ETD2RK (Cox and Matthews, J. Comput. Phys. 176, 2002): its weights are
those of the exact zero- and first-order hold. With g = 0 it is the exact linear step.

Written against the array API, for numpy and torch. Where numba is installed, float64 numpy arrays go
through the same equations compiled (`shake_env.kernels.table`), equal to rounding; the environment
variable ``SHAKE_ENV_COMPILED=0``, or :data:`numba_support.COMPILED` set to False, keeps them here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import array_api_compat
import numpy as np

from shake_env import numba_support
from shake_env.dynamics.linear import PeriodResponse, as_like
from shake_env.dynamics.low_pass import LowPass, first_low_pass, with_low_passes
from shake_env.errors import ScenarioError
from shake_env.model.discretization import first_order_hold
from shake_env.model.nonlinearity import Nonlinearity, Yielding
from shake_env.model.parameters import FloatArray, ModelEquations, diagonal
from shake_env.model.plant import (
    LOAD_PRESSURE,
    SPOOL_POSITION,
    TABLE_DISPLACEMENT,
    TABLE_VELOCITY,
    CoupledPlant,
    StateSpace,
    specimen_plant,
)
from shake_env.numba_support import compiled_module

if TYPE_CHECKING:
    from shake_env.kernels.table import CompiledStep

Array = Any  # a numpy array or a torch tensor


ARRAYS = ("advance", "slope", "C", "D", "valve", "coulomb", "arrival")
FLOW, FORCE, SPOOL_RATE = range(3)  # columns of N: [m] spool, [N] on the table, [m/s] spool; then slips


def drift_matrix(stories: int) -> FloatArray:
    """Return E, (stories, stories): drift of each storey from floor displacements."""
    return np.eye(stories) - np.eye(stories, k=-1)


def specimen_with_slip(plant: CoupledPlant, yielding: Yielding) -> StateSpace:
    """Return the specimen with slip states: base acceleration and slip rates in, base shear out.

    States ``[x_r, x_r', s]`` (3 stories), inputs ``[base acceleration, s']`` (1 + stories).
    """
    specimen = plant.specimen
    n, batch = specimen.stories, np.shape(specimen.masses)[:-1]
    rigid, upper = specimen_plant(specimen), slice(n, 2 * n)
    inverse_mass = diagonal(1.0 / np.asarray(specimen.masses))
    relaxed = (1.0 - yielding.stiffness_ratio) * np.asarray(specimen.stiffnesses)
    A, B = np.zeros((*batch, 3 * n, 3 * n)), np.zeros((*batch, 3 * n, 1 + n))
    C = np.zeros((*batch, 1, 3 * n))
    A[..., : 2 * n, : 2 * n], B[..., : 2 * n, :1], C[..., : 2 * n] = rigid.A, rigid.B, rigid.C
    A[..., upper, 2 * n :] = inverse_mass @ drift_matrix(n).T @ diagonal(relaxed)
    B[..., 2 * n :, 1:] = np.eye(n)
    C[..., 0, 2 * n] = -relaxed[..., 0]
    return StateSpace(A, B, C, np.zeros((*batch, 1, 1 + n)))


def floor_rows(plant: CoupledPlant, yielding: Yielding) -> FloatArray:
    """Return the map from ``[x_r, x_r']``, with slips ``s`` if storeys yield, to floor accelerations.

    (..., stories, 2 or 3 stories); absolute accelerations [m/s^2]: a floor feels nothing but its
    storeys.
    """
    n = plant.specimen.stories
    rows = specimen_with_slip(plant, yielding).A[..., n : 2 * n, :]
    return rows if yielding.active else rows[..., : 2 * n]


def controlled_plant(
    plant: CoupledPlant, parts: Nonlinearity, low_passes: Sequence[LowPass] = ()
) -> StateSpace:
    """Return the continuous linear part of the table with inputs for its nonlinear parts.

    States ``[x_A, x_S]``, then ``s`` (stories) if storeys yield, then the outputs of low-passes, then
    ``x_v'`` if the valve is of second order. Inputs ``[u, flow, force, spool rate]`` [A, m, N, m/s],
    then ``s'`` (stories) [m/s]. Outputs ``[y_A, f_s]``, whose D holds the force's part in y_A.

    Raises
    ------
    ScenarioError
        If the equations are not the corrected ones: on the printed ones a nonlinear part has no meaning.
    """
    if plant.equations != ModelEquations():
        raise ScenarioError("equations", plant.equations, "nonlinear parts need the corrected equations")
    actuator, n = plant.actuator, plant.specimen.stories
    slips = n if parts.yielding.active else 0
    second_order = parts.valve.natural_frequency is not None
    linear = 4 + 2 * n
    order = linear + slips + second_order
    driven = plant.driven
    batch = driven.A.shape[:-2]
    A, B = np.zeros((*batch, order, order)), np.zeros((*batch, order, 4 + slips))
    C, D = np.zeros((*batch, 2, order)), np.zeros((*batch, 2, 4 + slips))
    A[..., :linear, :linear] = driven.A[..., :linear, :linear]
    B[..., :linear, 0] = driven.B[..., :linear, 0]
    C[..., :linear] = driven.C[..., :2, :linear]
    # A force on the table enters its acceleration, and through it every storey.
    push = np.zeros((*batch, order, 1))
    push[..., TABLE_VELOCITY, 0] = 1.0 / actuator.table_mass
    push[..., 4 + n : linear, :] = -push[..., TABLE_VELOCITY, None, :]
    B[..., LOAD_PRESSURE, 1 + FLOW] = A[..., LOAD_PRESSURE, SPOOL_POSITION]
    B[..., 1 + FORCE], D[..., 0, 1 + FORCE] = push[..., 0], push[..., TABLE_VELOCITY, 0]
    B[..., SPOOL_POSITION, 1 + SPOOL_RATE] = 1.0
    if slips:
        building = specimen_with_slip(plant, parts.yielding)
        slip = slice(linear, linear + n)
        released = building.C[..., 2 * n :]
        A[..., 4 + n : linear, slip] = building.A[..., n : 2 * n, 2 * n :]
        C[..., 1:, slip] = released
        C[..., :1, slip] = released * push[..., TABLE_VELOCITY, None, :]
        A[..., slip] += push * released
        B[..., slip, 4:] = np.eye(n)
    if second_order:
        omega = 2.0 * math.pi * np.asarray(parts.valve.natural_frequency)  # one, or one a plant
        A[..., SPOOL_POSITION, :], B[..., SPOOL_POSITION, 0] = 0.0, 0.0
        A[..., SPOOL_POSITION, -1] = 1.0
        A[..., -1, SPOOL_POSITION] = -(omega**2)
        A[..., -1, -1] = -2.0 * parts.valve.damping_ratio * omega
        B[..., -1, 0] = omega**2 * actuator.valve_gain
    table = StateSpace(A, B, C, D)
    if not low_passes:
        return table
    floors = floor_rows(plant, parts.yielding)
    return with_low_passes(table, low_passes, first_low_pass(plant, parts), floors)


def controlled_scale(
    plant: CoupledPlant, parts: Nonlinearity, low_passes: Sequence[LowPass] = ()
) -> FloatArray:
    """Return the size of each state of :func:`controlled_plant`, for the arithmetic only."""
    scale = plant.state_scale[..., plant.layout.controlled]
    n = plant.specimen.stories
    extra = [scale[..., 4 : 4 + n]] if parts.yielding.active else []
    sizes = np.array([low_pass.scale for low_pass in low_passes])
    extra.append(np.broadcast_to(sizes, (*scale.shape[:-1], len(sizes))))
    if parts.valve.natural_frequency is not None:
        omega = 2.0 * math.pi * np.asarray(parts.valve.natural_frequency)[..., None]
        extra.append(scale[..., [SPOOL_POSITION]] * omega)
    return np.concatenate([scale, *extra], axis=-1)


def apply(matrix: Array, vector: Array) -> Array:
    """Return matrix times vector, with one matrix for the batch (m, n) or one a table (..., m, n)."""
    if matrix.ndim == 2:
        return vector @ matrix.T
    return (matrix @ vector[..., None])[..., 0]


@dataclass(frozen=True)
class NonlinearDynamics:
    """One control period of a table with nonlinear parts, in physics steps.

    Matrices are common to the batch, or carry its leading axes when every table has a plant of its own.
    """

    parts: Nonlinearity
    advance: Array  # (..., m, m + 1 + inputs) of [state, current, g], all held: one product a step
    slope: Array  # (..., m, inputs) what the change of g over a step adds
    C: Array  # (..., 2, m) [y_A, f_s]
    D: Array  # (..., 2, inputs)
    # (..., 3) linear spool rate [1/s, m/(A s)] from [x_v, u], zeros if the valve is of second order, and
    # what the supply is short of its rated pressure [Pa]
    valve: Array
    coulomb: Array  # (...) Coulomb friction [N]
    arrival: Array  # (..., k, commands + 1) which command, oldest first, acts in each physics step
    stories: int
    substeps: int

    @classmethod
    def from_plant(
        cls,
        plant: CoupledPlant,
        parts: Nonlinearity,
        dt: float,
        substeps: int,
        *,
        delay: float = 0.0,
        longest_delay: float = 0.0,
        low_passes: Sequence[LowPass] = (),
    ) -> NonlinearDynamics:
        """Discretise a plant with nonlinear parts and a loop delay of `delay` physics steps.

        The outputs of `low_passes` are states, from `first_low_pass` on.

        Plants that are to be stacked share a `longest_delay`, so that as many commands are kept. From a
        stacked plant every matrix comes out one a plant; friction and delay are common to them.
        """
        continuous = controlled_plant(plant, parts, low_passes)
        model, slope = first_order_hold(continuous, dt, controlled_scale(plant, parts, low_passes))
        level = model.B + slope  # zero-order hold is the sum of the first-order hold's two weights
        first_order = parts.valve.natural_frequency is None
        at, batch = SPOOL_POSITION, continuous.A.shape[:-2]
        rate = np.stack([continuous.A[..., at, at], continuous.B[..., at, 0]], axis=-1)
        missing = np.broadcast_to(np.asarray(parts.valve.missing)[..., None], (*batch, 1))
        picks = arrival(delay, substeps, commands_under_way(max(delay, longest_delay), substeps))
        return cls(
            parts=parts,
            advance=np.concatenate([model.A, level], axis=-1),
            slope=slope[..., 1:],
            C=continuous.C,
            D=continuous.D[..., 1:],
            valve=np.concatenate([rate if first_order else np.zeros_like(rate), missing], axis=-1),
            coulomb=np.full(batch, parts.friction.coulomb),
            arrival=np.tile(picks, (*batch, 1, 1)),
            stories=plant.specimen.stories,
            substeps=substeps,
        )

    # The planning model calls it so; its source is part of the key of stored bounds (`bound_store`).
    of = from_plant

    @property
    def states(self) -> int:
        """Length of the state: m of the plant, and the commands under way."""
        return int(self.advance.shape[-2] + self.arrival.shape[-1] - 1)

    def to(self, array: Array) -> NonlinearDynamics:
        """Return this update in the library, precision and device of `array`."""
        return replace(self, **{name: as_like(getattr(self, name), array) for name in ARRAYS})

    @cached_property
    def _compiled(self) -> CompiledStep | None:
        compiled = compiled_module("shake_env.kernels.table")
        if compiled is None:
            return None
        matrices = {name: getattr(self, name) for name in ARRAYS}
        step: CompiledStep = compiled.CompiledStep.of(self.parts, self.stories, matrices)
        return step

    def nonlinear(self, state: Array, current: Array) -> Array:
        """Return g, (..., 3 or 3 + stories): what the linear plant leaves out, in :data:`FLOW` order."""
        xp = array_api_compat.array_namespace(state)
        parts = self.parts
        spool, velocity = state[..., SPOOL_POSITION], state[..., TABLE_VELOCITY]
        zero = xp.zeros_like(spool)
        flow = force = rate = zero
        if parts.valve.flow_active:
            flow = parts.valve.opening(spool, state[..., LOAD_PRESSURE], self.valve[..., 2]) - spool
        if parts.friction.active:
            force = parts.friction.force(velocity, self.coulomb)
        if parts.stops.active:
            force = force + parts.stops.force(state[..., TABLE_DISPLACEMENT], velocity)
        if math.isfinite(parts.valve.spool_rate_limit):
            limit = parts.valve.spool_rate_limit
            free = self.valve[..., 0] * spool + self.valve[..., 1] * current
            if parts.valve.natural_frequency is not None:
                free = state[..., -1]
            rate = free.clip(-limit, limit) - free
        columns = xp.stack([flow, force, rate], axis=-1)
        if not parts.yielding.active:
            return columns
        n = self.stories
        floors = state[..., 4 : 4 + 3 * n]
        slips = slip_rates(parts.yielding, floors, n)
        return xp.concat([columns, slips], axis=-1)

    def physics_step(self, state: Array, current: Array, g: Array) -> Array:
        """Return the state after one physics step; `g` is `nonlinear` at its start."""
        xp = array_api_compat.array_namespace(state)
        predicted = apply(self.advance, xp.concat([state, current[..., None], g], axis=-1))
        change = self.nonlinear(predicted, current) - g
        moved = predicted + apply(self.slope, change)
        if math.isfinite(
            self.parts.valve.spool_limit
        ):  # the spool rests on its stop, it does not wind up
            at = SPOOL_POSITION
            limited = self.parts.valve.limited(moved[..., at : at + 1])
            moved = xp.concat([moved[..., :at], limited, moved[..., at + 1 :]], axis=-1)
        return moved

    def control_step(self, state: Array, current: Array, drive: Array | None = None) -> PeriodResponse:
        """Advance by one control period.

        Parameters
        ----------
        state
            (..., m + commands) in SI; the last ones are the commands under way [A], oldest first.
        current
            (...) command [A], held over a period that begins once the loop's delay has passed.
        drive
            None: with the corrected equations the table feels the current only.
        """
        if numba_support.COMPILED and type(state) is np.ndarray:
            step = self._compiled
            if step is not None and step.fits(state, current):
                return PeriodResponse(*step(state, current))
        xp = array_api_compat.array_namespace(state, current)
        commands = self.arrival.shape[-1] - 1
        if commands:
            queue = xp.concat([state[..., -commands:], current[..., None]], axis=-1)
            arriving = apply(self.arrival, queue)
            currents = [arriving[..., j] for j in range(self.substeps)]
            state = state[..., :-commands]
        else:
            currents = [current] * self.substeps
        outputs = []
        g = self.nonlinear(state, currents[0])
        for now, following in zip(currents, currents[1:] + currents[-1:], strict=True):
            state = self.physics_step(state, now, g)
            # Of g the outputs see the force only, which does not depend on the current; what is computed
            # for them also begins the next step.
            g = self.nonlinear(state, following)
            outputs.append(apply(self.C, state) + apply(self.D, g))
        if commands:
            state = xp.concat([state, queue[..., 1:]], axis=-1)
        both = xp.stack(outputs, axis=-2)
        return PeriodResponse(state, both[..., 0], both[..., 1])

    def control_periods(self, state: FloatArray, current: FloatArray) -> PeriodResponse:
        """Advance by P control periods under commands that do not depend on what the tables do.

        Parameters
        ----------
        state
            (N, m + commands) at the start, see `control_step`.
        current
            (P, N) command [A] of each period.

        Returns
        -------
        PeriodResponse
            With a leading axis of P: the states at each period's end and the outputs in it.
        """
        if numba_support.COMPILED:
            step = self._compiled
            if step is not None and step.fits(state, current[0]):
                return PeriodResponse(*step.periods(state, current))
        periods = []
        for command in current:
            periods.append(self.control_step(state, command))
            state = periods[-1].state
        return PeriodResponse(
            np.stack([period.state for period in periods]),
            np.stack([period.table_acceleration for period in periods]),
            np.stack([period.base_shear for period in periods]),
        )


def commands_under_way(delay: float, substeps: int) -> int:
    """Return how many earlier commands the loop delay still holds back."""
    return math.ceil(delay / substeps)


def arrival(delay: float, substeps: int, commands: int) -> FloatArray:
    """Return which delayed command acts in each physics step of a period, (substeps, commands + 1).

    Rows sum to 1. Where a command arrives within a physics step, the step takes the mean current: the
    valve gets the same charge, and its lag is far longer than the step.

    Parameters
    ----------
    delay
        Physics steps from the controller's command to the valve; a fraction is allowed.
    substeps
        Physics steps per control period.
    commands
        Earlier commands kept, oldest first; the present one comes last.
    """
    whole, fraction = math.floor(delay), delay - math.floor(delay)
    picks = np.zeros((substeps, commands + 1))
    for j in range(substeps):
        picks[j, commands + (j - whole) // substeps] += 1.0 - fraction
        if fraction:
            picks[j, commands + (j - whole - 1) // substeps] += fraction
    return picks


def slip_rates(yielding: Yielding, floors: Array, stories: int) -> Array:
    """Return s' (..., stories) from the specimen's ``[x_r, x_r', s]`` (..., 3 stories)."""
    xp = array_api_compat.array_namespace(floors)
    n = stories
    position, velocity, slip = floors[..., :n], floors[..., n : 2 * n], floors[..., 2 * n :]
    drift = xp.concat([position[..., :1], position[..., 1:] - position[..., :-1]], axis=-1)
    rate = xp.concat([velocity[..., :1], velocity[..., 1:] - velocity[..., :-1]], axis=-1)
    return yielding.slip_rate(drift, rate, slip)
