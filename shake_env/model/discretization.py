"""Continuous to discrete, in one place: exact zero- and first-order hold, exact noise covariance.

Everything comes in and goes out in SI; inside, states are scaled (`CoupledPlant.state_scale`), because
SI states span ten decades and a matrix exponential of the raw matrices loses that many digits. Leading
axes of a model are a batch of plants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy  # loads scipy.linalg on first use, which takes a third of a second

from shake_env.errors import NumericalError, ParameterError
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import CoupledPlant, StateLayout, StateSpace, check_shapes

# Of the directions of a step's noise three to five lie above rounding; one more is rounding itself.
MOST_DIRECTIONS = 6


@dataclass(frozen=True)
class DiscreteStateSpace:
    """Discrete linear model ``x[j+1] = A x[j] + B u[j]``, ``y[j] = C x[j] + D u[j]`` (SI)."""

    A: FloatArray  # (..., n, n)
    B: FloatArray  # (..., n, inputs)
    C: FloatArray  # (..., outputs, n)
    D: FloatArray  # (..., outputs, inputs)
    dt: float  # [s]

    def __post_init__(self) -> None:
        check_shapes(self.A, self.B, self.C, self.D)
        _check_step(self.dt)

    @property
    def order(self) -> int:
        """Number of states n."""
        return int(self.A.shape[-1])


def check_directions(field: str, directions: int | None) -> None:
    """Raise ParameterError unless `directions` is None or a whole number of 1 to MOST_DIRECTIONS."""
    whole = isinstance(directions, int | np.integer) and not isinstance(directions, bool)
    if directions is not None and not (whole and 1 <= directions <= MOST_DIRECTIONS):
        remedy = f"must be a whole number of 1 to {MOST_DIRECTIONS}, or None for all above rounding"
        raise ParameterError(field, directions, remedy)


def _check_step(dt: float) -> None:
    if not (np.isfinite(dt) and dt > 0.0):
        raise ParameterError("dt", dt, "the step must be a finite time above 0 s")


def zero_order_hold(system: StateSpace, dt: float, scale: FloatArray) -> DiscreteStateSpace:
    """Return the exact model for inputs held constant over each step.

    Parameters
    ----------
    system
        Continuous model.
    dt
        Step [s].
    scale
        (..., n) size of each state, for the arithmetic only.
    """
    _check_step(dt)
    *batch, n, inputs = system.B.shape
    row, column = scale[..., None, :], scale[..., None]
    generator = np.zeros((*batch, n + inputs, n + inputs))
    generator[..., :n, :n] = system.A * row / column
    generator[..., :n, n:] = system.B / column
    power = scipy.linalg.expm(generator * dt)
    A = power[..., :n, :n] * column / row
    return DiscreteStateSpace(A, power[..., :n, n:] * column, system.C, system.D, dt)


def first_order_hold(
    system: StateSpace, dt: float, scale: FloatArray
) -> tuple[DiscreteStateSpace, FloatArray]:
    """Return the exact model for inputs that run straight from each sample to the next.

    Returns
    -------
    model
        ``x[j+1] = A x[j] + B u[j] + B_next u[j+1]``; its ``B`` multiplies the present sample.
    B_next
        (..., n, inputs) what multiplies the next sample.
    """
    _check_step(dt)
    *batch, n, inputs = system.B.shape
    row, column = scale[..., None, :], scale[..., None]
    generator = np.zeros((*batch, n + 2 * inputs, n + 2 * inputs))
    generator[..., :n, :n] = system.A * row / column * dt
    generator[..., :n, n : n + inputs] = system.B / column * dt
    generator[..., n : n + inputs, n + inputs :] = np.eye(inputs)
    power = scipy.linalg.expm(generator)
    A = power[..., :n, :n] * column / row
    level = power[..., :n, n : n + inputs] * column
    slope = power[..., :n, n + inputs :] * column
    return DiscreteStateSpace(A, level - slope, system.C, system.D, dt), slope


def noise_covariance(A: FloatArray, B: FloatArray, dt: float, scale: FloatArray) -> FloatArray:
    """Return the covariance that white noise of unit intensity leaves in the state after one step.

    ``integral_0^dt exp(A s) B B' exp(A' s) ds`` by Van Loan (IEEE TAC 23, 1978), (..., n, n) in SI.
    """
    _check_step(dt)
    *batch, n, _ = A.shape
    row, column = scale[..., None, :], scale[..., None]
    A_scaled, B_scaled = A * row / column, B / column
    generator = np.zeros((*batch, 2 * n, 2 * n))
    generator[..., :n, :n] = -A_scaled
    generator[..., :n, n:] = B_scaled @ _transposed(B_scaled)
    generator[..., n:, n:] = _transposed(A_scaled)
    power = scipy.linalg.expm(generator * dt)
    covariance: FloatArray = _transposed(power[..., n:, n:]) @ power[..., :n, n:]
    return 0.5 * (covariance + _transposed(covariance)) * (column * row)


def _transposed(matrix: FloatArray) -> FloatArray:
    return np.swapaxes(matrix, -1, -2)


def noise_factor(
    covariance: FloatArray,
    scale: FloatArray,
    directions: int | None = None,
    first: Sequence[int] = (),
) -> FloatArray:
    """Return L, (..., n, directions) in SI, with ``L @ L.T`` close to the covariance, or equal to it.

    Pivoted Cholesky on scaled states: each direction is what is left of one state's noise, together with
    what the others' have in common with it. A step's noise ``w`` reaches state i + 1 through the
    integral of state i, so that what r directions leave out is of order ``dt^(2 r)`` beside the first.
    Unlike eigenvectors these directions have no arbitrary sign, and vary smoothly with the plant.

    Parameters
    ----------
    covariance
        (..., n, n) in SI.
    scale
        (..., n) size of each state.
    directions
        How many to keep. None: all above rounding of the largest, so that L reproduces the covariance to
        rounding. Where there are fewer, the others have no weight.
    first
        States whose noise is taken first and so reproduced exactly; then the one with most left.

    Raises
    ------
    NumericalError
        If the covariance is not positive semi-definite.
    """
    row, column = scale[..., None, :], scale[..., None]
    left = covariance / (column * row)
    if not np.isfinite(left).all():
        raise NumericalError("noise covariance", "not finite", "shorten the physics step")
    values = np.linalg.eigvalsh(left)
    if np.any(values[..., 0] < -1e-9 * values[..., -1]):
        raise NumericalError("noise covariance", float(values.min()), "is not positive semi-definite")
    variance = np.diagonal(left, axis1=-2, axis2=-1)
    rounding = np.finfo(float).eps * np.max(variance, axis=-1)
    columns: list[FloatArray] = []
    while directions is None or len(columns) < directions:
        variance = np.diagonal(left, axis1=-2, axis2=-1)
        if directions is None and np.all(np.max(variance, axis=-1) <= rounding):
            break
        pivot = np.argmax(variance, axis=-1) if len(columns) >= len(first) else first[len(columns)]
        pivot = np.broadcast_to(pivot, variance.shape[:-1])[..., None]
        most = np.take_along_axis(variance, pivot, axis=-1)
        shared = np.take_along_axis(left, pivot[..., None], axis=-1)[..., 0]
        significant = most > rounding[..., None]
        columns.append(np.where(significant, shared / np.sqrt(np.where(significant, most, 1.0)), 0.0))
        left = left - columns[-1][..., :, None] * columns[-1][..., None, :]
    return np.stack(columns, axis=-1) * column if columns else np.zeros((*scale.shape, 0))


@dataclass(frozen=True)
class LiftedModel:
    """One control period as a single linear map of ``[x, u, d]``.

    `x` (n) is the state at the period's start, `u` (1) the current held over it and `d` (m) all the
    disturbance samples of the period in order of time. Outputs are taken after each physics step.
    """

    state: FloatArray  # (..., n, n + 1 + m): the state at the period's end
    outputs: FloatArray  # (..., substeps, outputs, n + 1 + m)


def lift(
    model: DiscreteStateSpace,
    disturbance: FloatArray,
    substeps: int,
    disturbance_next: FloatArray | None = None,
) -> LiftedModel:
    """Compose `substeps` physics steps into one map by running the step on a basis.

    Parameters
    ----------
    model
        Physics step; the first column of its B is the held control, D is zero.
    disturbance
        (..., n, r) what multiplies the disturbance sample at the start of a step.
    substeps
        Physics steps per control period.
    disturbance_next
        (..., n, r) what multiplies the sample at the step's end (first-order hold); then `d` holds
        ``substeps + 1`` samples instead of `substeps`.
    """
    *batch, n, rank = disturbance.shape
    samples = substeps + (disturbance_next is not None)
    running = np.zeros((*batch, n, n + 1 + samples * rank))
    running[..., :n] = np.eye(n)
    outputs = []
    for j in range(substeps):
        running = model.A @ running
        running[..., n] += model.B[..., 0]
        first = n + 1 + j * rank
        running[..., first : first + rank] += disturbance
        if disturbance_next is not None:
            running[..., first + rank : first + 2 * rank] += disturbance_next
        outputs.append(model.C @ running)
    return LiftedModel(running, np.stack(outputs, axis=-3))


@dataclass(frozen=True)
class DiscretePlant:
    """The coupled plant sampled at the physics step, under a control held over `substeps` steps.

    The stepping kernel, the LQR design and the analytic cost all read these matrices, so that none of
    them has a copy of an equation.
    """

    plant: CoupledPlant
    dt: float  # physics step [s]
    substeps: int  # physics steps per control period
    directions: int | None = None  # noise draws a physics step; None: all above rounding

    def __post_init__(self) -> None:
        _check_step(self.dt)
        if self.substeps < 1:
            raise ParameterError("substeps", self.substeps, "must be a whole number of at least 1")
        check_directions("directions", self.directions)

    @property
    def layout(self) -> StateLayout:
        """Where each part of the full state lies."""
        return self.plant.layout

    @cached_property
    def model(self) -> DiscreteStateSpace:
        """One physics step: input u, outputs ``[y_A, f_s, y~, f~_s]``, states as the coupled plant."""
        coupled = self.plant.coupled
        held = StateSpace(coupled.A, coupled.B[..., :1], coupled.C, coupled.D[..., :1])
        return zero_order_hold(held, self.dt, self.plant.state_scale)

    @cached_property
    def noise(self) -> FloatArray:
        """(..., n, rank) factor of the covariance that w leaves in the state after one step.

        x_w' comes first, x_w second: given draws make the same earthquake whatever the specimen. Two
        directions reproduce the law of both exactly, and what the other states share with them. What a
        third would add is, at 1 ms and a storey frequency of 7 Hz, 1e-9 of a mean square of reference or
        high-pass, 2e-9 of J* at 200 Hz and 4e-8 of its mean-square force error; it goes with dt^4, to
        1e-6 of J* at 5 ms. One direction loses 1e-4, 1e-4 and 3e-3. To tell a mean square from one that
        is less by a share e takes 2 / e^2 independent samples: 2e18 of them, against 2e8. No frequency
        of target and reference shear between 0.2 and 25 Hz loses more than 1e-6 of its power; the shear
        loses 3e-3 at 500 Hz, where it has 4e-13 of its peak.
        """
        coupled, scale = self.plant.coupled, self.plant.state_scale
        covariance = noise_covariance(coupled.A, coupled.B[..., 1:], self.dt, scale)
        return noise_factor(covariance, scale, self.directions, first=(1, 0))

    @cached_property
    def lifted(self) -> LiftedModel:
        """One control period under filtered noise: ``d`` are `substeps` draws of the noise factor."""
        return lift(self.model, self.noise, self.substeps)

    @cached_property
    def lifted_record(self) -> LiftedModel:
        """One control period under a given target, straight between its samples.

        States ``[x_A, x_S, x~_S]``, outputs ``[y_A, f_s, f~_s]``, and ``d`` the ``substeps + 1``
        samples of y~ at the ends of the physics steps.
        """
        scale = self.plant.state_scale[..., self.layout.filter_states :]
        model, B_next = first_order_hold(self.plant.driven, self.dt, scale)
        held = DiscreteStateSpace(
            model.A, model.B[..., :1] + B_next[..., :1], model.C, model.D[..., :1], self.dt
        )
        return lift(held, model.B[..., 1:], self.substeps, B_next[..., 1:])
