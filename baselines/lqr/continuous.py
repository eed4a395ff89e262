"""Continuous-time LQR on the coupled plant with the paper's weights (Gavin and Hoagg 2009, sec. II-E).

The problem is badly conditioned in three places, and each has its remedy here:

- SI states span ten decades, so every state is scaled by its rms (`CoupledPlant.state_scale`).
- Force tracking is judged by ``f_s - f~_s``, a difference of nearly equal numbers. The specimen's state
  is therefore replaced by ``x_S - x~_S``, whose equations are the exact difference of two rows.
- A table that runs at constant speed leaves both errors at zero and costs only the current that holds
  the valve open. Its closed-loop pole is near 1e-6 rad/s where the fastest is near 2e5 rad/s, and in
  physical states rounding alone decides its sign. The velocity is therefore replaced by that steady
  motion, spool, pressure and holding current included: its column then contains exact zeros.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_continuous_are, solve_continuous_lyapunov, solve_sylvester

from baselines.lqr.design_states import DesignStates, IntArray
from shake_env.errors import NumericalError, ParameterError
from shake_env.model.parameters import FloatArray, require_non_negative, require_positive
from shake_env.model.plant import LOAD_PRESSURE, CoupledPlant

POSITION_TIME = 1000.0
"""[s] Unit of x_a over that of v_a, in the arithmetic only. With x_a in metres, the double integrator
from velocity to position is a Jordan block whose two poles rounding splits apart by 1e-6 rad/s; a large
unit makes its off-diagonal as small as the poles themselves."""


LEAST_WEIGHT = 1e-10
"""Added weight below which the position is left out all the same: its pole and the velocity's lie within
rounding of each other there, and leaving it out changes no norm by more than 1e-6 of itself."""

MOST_WEIGHT = 30.0
"""Largest added weight: above it double precision loses the position's pole against the fastest."""


@dataclass(frozen=True)
class SteadyCoordinates:
    """The coupled plant in states xi fit for Riccati and Lyapunov equations, and a shifted current.

    ``x = transform @ xi`` and ``u = holding @ xi + v``: `v` is the current beyond what holds a steady
    velocity. Order of xi as the full state.
    """

    transform: FloatArray  # (n, n) x in SI per unit of xi
    holding: FloatArray  # (n,) [A] per unit of xi
    A: FloatArray  # (n, n) with v = 0
    B: FloatArray  # (n, 2) inputs [v, w]
    E: FloatArray  # (2, n) rows of y_A - y~ [m/s^2] and f_s - f~_s [N]

    @classmethod
    def from_plant(cls, plant: CoupledPlant, position_time: float = POSITION_TIME) -> SteadyCoordinates:
        """Return the coordinates for `plant`, with `position_time` [s] as explained at its default.

        Raises
        ------
        NumericalError
            If the steady motion found is not one that leaves both errors at zero.
        """
        model, layout = plant.coupled, plant.layout
        n, velocity = layout.order, layout.table_displacement + 1
        transform, holding, scale = np.eye(n), np.zeros(n), plant.state_scale.copy()
        transform[layout.specimen, layout.reference] = np.eye(2 * layout.stories)
        displaced = DesignStates.from_plant(plant).left_out
        steady = bool(np.any(displaced))  # a stiffness beside leakage ends the steady motion
        if steady:
            transform[:, layout.table_displacement] = displaced
            transform[:, velocity], holding[velocity] = _steady_velocity(plant, displaced)
            scale[layout.table_displacement] = position_time * scale[velocity]
        inverse = np.linalg.inv(transform)
        A = inverse @ (model.A @ transform + np.outer(model.B[:, 0], holding))
        E = np.stack([model.C[0] - model.C[2], model.C[1] - model.C[3]]) @ transform
        if steady:
            # What is left in this column is rounding, and it would drown the slow pole.
            rate, errors = A[:, velocity].copy(), E[:, velocity] * scale[velocity]
            rate[layout.table_displacement] -= 1.0
            remainder = float(np.max(np.abs(np.append(rate * scale[velocity] / scale, errors))))
            if remainder <= 1e-8:
                A[:, velocity], E[:, velocity] = 0.0, 0.0
                A[layout.table_displacement, velocity] = 1.0
            elif plant.actuator.table_stiffness == 0.0:
                raise NumericalError(
                    "steady velocity", remainder, "does not satisfy the plant's equations"
                )
        return cls(
            transform=transform * scale,
            holding=holding * scale,
            A=A * scale / scale[:, None],
            B=inverse @ model.B / scale[:, None],
            E=E * scale,
        )

    def shifted_gain(self, gain: FloatArray) -> FloatArray:
        """Return k, (n,), with ``v = -k @ xi`` for the law ``u = -gain @ x`` in SI."""
        shifted: FloatArray = gain @ self.transform + self.holding
        return shifted

    def physical_gain(self, shifted: FloatArray) -> FloatArray:
        """Return the gain in SI, (n,), of the law ``v = -shifted @ xi``."""
        return np.asarray(np.linalg.solve(self.transform.T, shifted - self.holding), dtype=np.float64)


def _steady_velocity(plant: CoupledPlant, displaced: FloatArray) -> tuple[FloatArray, float]:
    """Return the state (n,) that moves at a steady 1 m/s, and the current that holds it [A].

    With a stiffness the pressure rises with the displacement, at that of `displaced`, (n,) at 1 m.
    """
    model, layout, scale = plant.coupled, plant.layout, plant.state_scale
    velocity = layout.table_displacement + 1
    rows = np.setdiff1d(np.arange(layout.order)[layout.controlled], layout.table_displacement)
    unknown = np.setdiff1d(rows, velocity)
    matrix = np.column_stack([model.A[np.ix_(rows, unknown)] * scale[unknown], model.B[rows, 0]])
    rise = np.where(rows == layout.actuator.start + LOAD_PRESSURE, displaced[rows], 0.0)
    solution = np.linalg.solve(
        matrix / scale[rows, None], (rise - model.A[rows, velocity]) / scale[rows]
    )
    state = np.zeros(layout.order)
    state[unknown] = solution[:-1] * scale[unknown]
    state[layout.specimen] = 0.0  # no acceleration, no deformation: what came out is rounding
    state[velocity] = 1.0
    return state, float(solution[-1])


@dataclass(frozen=True, kw_only=True)
class ContinuousLQRDesign:
    """A continuous-time LQR: ``u = -gain @ x`` with the full state x in SI."""

    gain: FloatArray  # (n,) [A per SI unit of each state]; zero on a position that was left out
    added_weight: float  # lambda of R_1 = E_1' E_1 + lambda I
    slowest_pole: float  # largest real part of the controlled part's poles [rad/s], below zero
    fastest_pole: float  # largest magnitude of a pole [rad/s]
    residual: float  # of the Riccati equation, relative to its largest term


def performance_rows(plant: CoupledPlant, q_1: float, q_2: float) -> FloatArray:
    """Return the rows q_1 (y_A - y~) and q_2 (f_s - f~_s) of E_1, (2, n) in SI (eq. 12)."""
    C = plant.coupled.C
    return np.stack([q_1 * (C[0] - C[2]), q_2 * (C[1] - C[3])])


def printed_added_weight(plant: CoupledPlant, *, q_1: float, q_2: float) -> float:
    """Return 5 |lambda_min(E_1' E_1)| in raw SI states, as the paper prints it (below eq. 14).

    E_1' E_1 has rank 2, so that the true value is zero. What comes out is rounding noise: it differs
    from one machine, library or order of the states to the next.
    """
    E_1 = performance_rows(plant, q_1, q_2)
    return 5.0 * abs(float(np.linalg.eigvalsh(E_1.T @ E_1)[0]))


def continuous_lqr(
    plant: CoupledPlant, *, q_1: float, q_2: float, r: float = 1.0, added_weight: float = 0.0
) -> ContinuousLQRDesign:
    """Design the LQR for ``R_1 = E_1' E_1 + added_weight I`` (SI states) and ``R_2 = r^2``.

    Parameters
    ----------
    q_1, q_2, r
        Weights of eq. 12 on y_A - y~ [m/s^2], f_s - f~_s [N] and u [A].
    added_weight
        Zero is the sound design: nothing added, and a table that stands displaced left out of the
        problem (`DesignStates`). Above zero, all states are weighted, the position among them (from
        `LEAST_WEIGHT` on).

    Notes
    -----
    Only the actuator and the specimen can be controlled, so the Riccati equation is solved for them
    alone. The gain on the ground filter and the reference specimen follows from a Sylvester equation,
    which is linear and well conditioned. SciPy's Riccati solution is then corrected by Newton steps
    (Kleinman, IEEE TAC 13, 1968), which bring its residual from about 1e-10 to about 1e-14 (with ten
    storeys, force weighting and a large added weight: from 1e-6 to 1e-8).

    Raises
    ------
    ParameterError
        If a weight is negative or `added_weight` too large, or `r` is zero.
    NumericalError
        If the Riccati solution fails its residual or stability check.
    """
    _Weights(q_1=q_1, q_2=q_2, r=r, added_weight=added_weight)
    layout = plant.layout
    # The slow pole grows as sqrt(lambda), and with it the largest unit of x_a that separates the two.
    xi = SteadyCoordinates.from_plant(
        plant, min(POSITION_TIME, 1.0 / np.sqrt(max(added_weight, LEAST_WEIGHT)))
    )
    states = DesignStates.from_plant(plant, whole=added_weight >= LEAST_WEIGHT).indices
    controlled = np.intersect1d(states, np.arange(layout.order)[layout.controlled])
    given = np.setdiff1d(states, controlled)
    W = np.array([[q_1], [q_2]]) * xi.E
    Q = W.T @ W + added_weight * xi.transform.T @ xi.transform + r**2 * np.outer(xi.holding, xi.holding)
    cross = r * xi.holding  # of the state with r v, the current scaled so that its weight is 1
    b = xi.B[controlled, :1] / r
    A = xi.A[np.ix_(controlled, controlled)]
    X, K, residual = _riccati(A, b, Q[np.ix_(controlled, controlled)], cross[controlled, None])
    poles = np.linalg.eigvals(A - b @ K)
    slowest = _slowest(A - b @ K)
    if not slowest < 0.0:
        raise NumericalError(
            "closed-loop pole", slowest, "the design is not stable to rounding; raise the weights"
        )
    linear = X @ xi.A[np.ix_(controlled, given)] + Q[np.ix_(controlled, given)]
    linear -= K.T @ cross[None, given]
    Y = solve_sylvester((A - b @ K).T, xi.A[np.ix_(given, given)], -linear)
    shifted = np.zeros(layout.order)
    shifted[controlled] = K[0] / r
    shifted[given] = (b.T @ Y + cross[None, given])[0] / r
    gain = xi.physical_gain(shifted)
    if plant.actuator.table_stiffness == 0.0:
        gain[_left_out(states, layout.order)] = 0.0
    return ContinuousLQRDesign(
        gain=gain,
        added_weight=added_weight,
        slowest_pole=slowest,
        fastest_pole=float(np.max(np.abs(poles))),
        residual=residual,
    )


@dataclass(frozen=True, kw_only=True)
class _Weights:
    q_1: float
    q_2: float
    r: float
    added_weight: float

    def __post_init__(self) -> None:
        require_non_negative(self, "q_1", "q_2", "added_weight")
        require_positive(self, "r")
        if self.added_weight > MOST_WEIGHT:
            raise ParameterError("added_weight", self.added_weight, f"must be at most {MOST_WEIGHT}")
        if self.q_1 == 0.0 and self.q_2 == 0.0:
            raise ParameterError("q_1, q_2", (self.q_1, self.q_2), "weight at least one error")


def _left_out(states: IntArray, order: int) -> IntArray:
    return np.setdiff1d(np.arange(order), states)


def _riccati(
    A: FloatArray, b: FloatArray, Q: FloatArray, s: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Return X, K and the relative residual for unit control weight and cross weight `s` (m, 1)."""
    try:
        X = solve_continuous_are(A, b, Q, np.eye(1), s=s)
    except np.linalg.LinAlgError as error:
        raise NumericalError("Riccati equation", str(error), "has no stabilising solution") from error
    K, residual = _check(A, b, Q, s, X)
    # SciPy's start is mostly good to 1e-10 but can be far off; Newton is sure from any stable start.
    for _ in range(60):
        if not _slowest(A - b @ K) < 0.0:
            break
        X_next = solve_continuous_lyapunov((A - b @ K).T, -(Q + K.T @ K - s @ K - K.T @ s.T))
        X_next = 0.5 * (X_next + X_next.T)
        K_next, residual_next = _check(A, b, Q, s, X_next)
        if not residual_next < 0.9 * residual or not _slowest(A - b @ K_next) < 0.0:
            break  # rounding is reached
        X, K, residual = X_next, K_next, residual_next
    if not residual <= 1e-7:
        raise NumericalError(
            "Riccati residual",
            residual,
            "is too large: design it sampled (sampled_lqr), where it is not",
        )
    return X, K, residual


def _check(
    A: FloatArray, b: FloatArray, Q: FloatArray, s: FloatArray, X: FloatArray
) -> tuple[FloatArray, float]:
    """Return the gain (1, m) of `X` and the residual relative to the equation's largest fixed term."""
    K = b.T @ X + s.T
    residual = np.max(np.abs(A.T @ X + X @ A - K.T @ K + Q))
    return np.asarray(K, dtype=np.float64), float(residual / np.max(np.abs(Q)))


def _slowest(A: FloatArray) -> float:
    return float(np.max(np.linalg.eigvals(A).real))
