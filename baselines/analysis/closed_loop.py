"""The coupled plant under a state feedback, from the white noise w to every output of interest.

In the coordinates of `baselines.lqr.continuous.SteadyCoordinates`, so that the slow pole of a table at
steady speed (1e-6 rad/s) survives beside the fast ones (2e5 rad/s). The position x_a feeds nothing back
when k_a = 0: it is left out of the states, which makes the loop stable, and is the integral of the
velocity among the outputs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import expm, matrix_balance

from baselines.analysis.h2 import ComplexArray
from baselines.lqr.continuous import SteadyCoordinates
from baselines.lqr.design_states import DesignStates
from shake_env.errors import NumericalError, ParameterError
from shake_env.model.parameters import FloatArray, GroundFilter
from shake_env.model.plant import (
    LOAD_PRESSURE,
    REFERENCE_CURRENT,
    SPOOL_POSITION,
    TABLE_VELOCITY,
    CoupledPlant,
    StateSpace,
)

ERRORS = ("acceleration_error", "base_shear_error")
CURRENT = "current"


@dataclass(frozen=True)
class ContinuousClosedLoop:
    """A stable closed loop from w, the unit white noise ahead of the ground filter."""

    plant: CoupledPlant
    system: StateSpace  # one input w; outputs in SI, in the order of `outputs`
    outputs: tuple[str, ...]
    sizes: FloatArray  # (outputs,) SI: rms of each output when the unit-intensity target is tracked

    @property
    def index(self) -> dict[str, int]:
        """Place of each output."""
        return {name: i for i, name in enumerate(self.outputs)}

    @cached_property
    def poles(self) -> ComplexArray:
        """Poles [rad/s], (n,), the fastest first."""
        eigenvalues = np.linalg.eigvals(self.system.A).astype(np.complex128)
        return eigenvalues[np.argsort(-np.abs(eigenvalues))]

    def scaled(self, outputs: tuple[str, ...] | None = None) -> StateSpace:
        """Return the model with `outputs` (None: all), each over its size: fit to be reduced.

        An error counts against the size of the signal that it is an error of, not against its own.
        """
        rows = [self.index[name] for name in (outputs or self.outputs)]
        s = self.system
        return StateSpace(
            s.A, s.B, s.C[rows] / self.sizes[rows, None], s.D[rows] / self.sizes[rows, None]
        )


def closed_loop(plant: CoupledPlant, gain: FloatArray) -> ContinuousClosedLoop:
    """Return the closed loop of ``u = -gain @ x``.

    Parameters
    ----------
    plant
        The coupled plant.
    gain
        (n,) [A per SI unit of each state], zero on a position that nothing sees.

    Returns
    -------
    The loop with outputs ``acceleration_error`` (y_A - y~) [m/s^2], ``base_shear_error`` (f_s - f~_s)
    [N], ``table_acceleration``, ``target_acceleration`` [m/s^2], ``base_shear``,
    ``reference_base_shear`` [N], ``load_pressure`` [Pa], ``table_velocity`` [m/s], ``spool_position``
    [m], ``drift_1`` ... and ``reference_drift_1`` ... (between neighbouring floors, counted from the
    table) [m], and ``current`` [A].

    Raises
    ------
    ParameterError
        If the gain has the wrong shape, or feeds back a position that nothing else sees.
    NumericalError
        If the closed loop is not stable.
    """
    layout = plant.layout
    if gain.shape != (layout.order,):
        raise ParameterError("gain shape", gain.shape, f"must be ({layout.order},)")
    keep = DesignStates.from_law(plant, gain).indices
    if len(keep) == layout.order and plant.actuator.table_stiffness == 0.0:
        raise ParameterError("gain", gain, "feeds back the position, which is left out here")
    xi = SteadyCoordinates.from_plant(plant)
    shifted = xi.shifted_gain(gain)
    A = (xi.A - np.outer(xi.B[:, 0], shifted))[np.ix_(keep, keep)]
    slowest = float(np.max(np.linalg.eigvals(A).real))
    if not slowest < 0.0:
        raise NumericalError("closed-loop pole", slowest, "the closed loop is not stable: another gain")

    signals = plant.coupled.C @ xi.transform  # y_A, f_s, y~, f~_s
    table = xi.transform[layout.actuator]
    # y_A and f_s are written as target plus error, so that the difference of nearly equal rows is exact.
    rows = {
        "acceleration_error": xi.E[0],
        "base_shear_error": xi.E[1],
        "table_acceleration": signals[2] + xi.E[0],
        "target_acceleration": signals[2],
        "base_shear": signals[3] + xi.E[1],
        "reference_base_shear": signals[3],
        "load_pressure": table[LOAD_PRESSURE],
        "table_velocity": table[TABLE_VELOCITY],
        "spool_position": table[SPOOL_POSITION],
    }
    scale = plant.state_scale
    acceleration, shear = np.sqrt(plant.target_variance), np.sqrt(plant.reference_shear_variance)
    actuator = scale[layout.actuator]
    sizes = [acceleration, shear] + 2 * [acceleration] + 2 * [shear]
    sizes += [actuator[i] for i in (LOAD_PRESSURE, TABLE_VELOCITY, SPOOL_POSITION)]
    for prefix, part in (("drift", layout.specimen), ("reference_drift", layout.reference)):
        floors = xi.transform[part][: layout.stories]
        drifts = np.diff(floors, axis=0, prepend=np.zeros((1, layout.order)))
        rows |= {f"{prefix}_{storey + 1}": row for storey, row in enumerate(drifts)}
        # One size for all storeys: that of the first, which carries the base shear.
        sizes += [scale[part][0]] * layout.stories
    rows[CURRENT] = xi.holding - shifted
    sizes.append(REFERENCE_CURRENT)
    C = np.stack(list(rows.values()))[:, keep]
    system = StateSpace(A, xi.B[keep, 1:], C, np.zeros((len(rows), 1)))
    return ContinuousClosedLoop(plant, system, tuple(rows), np.array(sizes))


@dataclass(frozen=True)
class Response:
    """Answer of a model from w to one target motion, sampled at the target's own step."""

    outputs: FloatArray  # (samples, outputs) in the model's units
    displacement: FloatArray  # (samples,) integral of the chosen output, from zero
    noise: FloatArray  # (samples,) the w that makes the ground filter produce the target


def forced_response(
    system: StateSpace, ground: GroundFilter, target: FloatArray, step: float, velocity: int
) -> Response:
    """Return the exact response of a model from w, full or reduced, to a given target from rest.

    Parameters
    ----------
    system
        Stable model with the one input w.
    ground
        Filter between w and the target, inverted here: ``w`` is what would have produced the target.
    target
        (samples,) y~ at multiples of `step`, the first at time 0 [m/s^2].
    step
        [s] It need not resolve the model's poles.
    velocity
        Which output is the table's velocity, to be integrated to its displacement.

    Notes
    -----
    Between samples the target runs along a cubic spline, whose third derivative is constant over each
    step: the spline, the inverse filter and the model are one linear system under a held input, and one
    matrix exponential steps it without error, whatever its poles. Straight lines would not do: a fast
    loop answers each of their kinks with a spike of current that the motion doesn't contain. For the
    same reason a target that does not begin at zero is led up to by ten samples.
    """
    if target.ndim != 1 or len(target) < 4:
        raise ParameterError("target shape", target.shape, "must be (samples,), at least four of them")
    lead = 0.5 * target[0] * (1.0 - np.cos(np.pi * np.arange(LEAD_SAMPLES) / LEAD_SAMPLES))
    led = np.concatenate([lead, target])
    known, n = 1 + len(_SPLINE_ORDERS), system.order
    w_row = np.append(0.0, _inverse_filter(ground))
    A = np.zeros((known + n + 1, known + n + 1))  # third derivative, chain, model, displacement
    A[np.arange(1, known), np.arange(known - 1)] = 1.0
    given, moved, model = slice(0, known), slice(known, None), slice(known, known + n)
    A[model, given] = np.outer(system.B[:, 0], w_row)
    A[model, model] = system.A
    C = np.hstack([np.outer(system.D[:, 0], w_row), system.C, np.zeros((len(system.C), 1))])
    A[-1] = C[velocity]
    even, (scale, _) = matrix_balance(A * step, permute=False, separate=1)
    power = expm(even) * scale[:, None] / scale
    # The chain is known at every node. Integrating it step by step would let rounding grow as t^3.
    spline = CubicSpline(np.arange(len(led)) * step, led, bc_type="natural")
    forced = np.zeros((len(led), known))
    forced[:-1, 0] = 6.0 * spline.c[0]
    for column, order in enumerate(_SPLINE_ORDERS, start=1):
        values = spline(spline.x, order) if order >= 0 else spline.antiderivative(-order)(spline.x)
        forced[:, column] = values
    push = forced @ power[moved, given].T
    step_map = np.ascontiguousarray(power[moved, moved])
    states = np.zeros((len(led), n + 1))
    for j in range(len(led) - 1):
        np.dot(step_map, states[j], out=states[j + 1])
        states[j + 1] += push[j]
    outputs = forced @ C[:, given].T + states @ C[:, moved].T
    cut = slice(LEAD_SAMPLES, None)
    return Response(outputs[cut], states[cut, -1], (forced @ w_row)[cut])


LEAD_SAMPLES = 10
_SPLINE_ORDERS = (2, 1, 0, -1, -2, -3)  # derivatives and integrals of the target that w is made of


def _inverse_filter(ground: GroundFilter) -> FloatArray:
    """Return the row (6,) of w over the target's derivatives and integrals, in `_SPLINE_ORDERS`."""
    gain = 2.0 * ground.damping_ratio * ground.omega
    highpass = 2.0 * np.pi * (ground.highpass_frequency or 0.0)
    friction = 2.0 * ground.highpass_damping_ratio * highpass
    # gain x_w' = y~ + friction (integral of y~) + highpass^2 (its second integral), and
    # w = x_w'' + gain x_w' + omega^2 x_w.
    source = np.array([1.0, friction, highpass**2])
    row = np.zeros(len(_SPLINE_ORDERS))
    for shift, factor in enumerate((1.0, gain, ground.omega**2)):
        row[1 + shift : 4 + shift] += factor * source / gain
    return row
