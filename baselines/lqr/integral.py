"""LQR with integral action on displacement: the table keeps its place, whatever the valve's offset.

The stage cost knows no position, so the plain LQR lets the table drift. Here the displacement error
``e = x_a - x_g`` and its integral xi, the controller's memory, join the state and are weighted on
purpose (Anderson and Moore, Optimal Control, 1990, sec. 4.3; Young and Willems, Int. J. Control 15,
1972). x_g is the ground's displacement, a filter state when the ground has a high-pass; without one it
is a random walk that no stroke follows, and e is the position itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, solve_discrete_lyapunov

from baselines.lqr.design_states import DesignStates
from baselines.lqr.sampled import ScaledProblem, StationaryPerformance, action_row, riccati
from shake_env.errors import NumericalError
from shake_env.model.discretization import DiscretePlant
from shake_env.model.parameters import FloatArray, require_non_negative, require_positive
from shake_env.model.plant import REFERENCE_CURRENT, CoupledPlant
from shake_env.scenario.objective import StageCost
from shake_env.scenario.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class DisplacementWeights:
    """What keeping the table's place is worth: ``position (e / d)^2 + integral (xi / (d s))^2``.

    Added to the stage cost of each control period, d the unit of displacement and s one second.

    Raises
    ------
    ParameterError
        If a weight is not above zero; only `position` may be zero.
    """

    position: float = 0.01  # [-]
    integral: float = 0.01  # [-]
    displacement: float = 0.07  # d [m], the soft stroke

    def __post_init__(self) -> None:
        require_non_negative(self, "position")
        require_positive(self, "integral", "displacement")


@dataclass(frozen=True)
class IntegralDesign:
    """``u = -gain @ x - integral_gain * xi``, with ``xi[i+1] = xi[i] + T (error_row @ x[i])``."""

    gain: FloatArray  # (n,) [A per SI unit of each state]
    integral_gain: float  # [A/(m s)]
    error_row: FloatArray  # (n,) e = error_row @ x [m]
    period: float  # T [s]
    analytic_cost: float  # stationary expected stage cost and displacement terms
    performance: StationaryPerformance  # of the stage cost alone
    displacement_error_rms: float  # of e at the control instants [m]
    spectral_radius: float  # of the closed loop, position and integral included


def displacement_error(plant: CoupledPlant) -> FloatArray:
    """Return the row (n,) of ``e = x_a - x_g`` [m]."""
    layout = plant.layout
    row = np.zeros(layout.order)
    row[layout.table_displacement] = 1.0
    if layout.filter_states == 4:
        row[layout.ground.stop - 2] = -1.0
    return row


def lqr_integral(
    discrete: DiscretePlant, cost: StageCost, weights: DisplacementWeights | None = None
) -> IntegralDesign:
    """Design the LQR of the stage cost with displacement terms.

    Raises
    ------
    NumericalError
        If the Riccati equation has no solution, or its cost differs from the closed loop's.
    """
    w = DisplacementWeights() if weights is None else weights
    plant, n, period = discrete.plant, discrete.layout.order, discrete.substeps * discrete.dt
    scale = plant.state_scale
    p = ScaledProblem.from_plant(discrete, DesignStates.from_plant(plant, whole=True))
    e = displacement_error(plant) * scale / w.displacement  # in units of d; xi in units of d s
    F = np.block([[p.F, np.zeros((n, 1))], [period * e, np.ones((1, 1))]])
    G, N = np.vstack([p.G, [[0.0]]]), np.pad(p.N, ((0, 1), (0, 0)))
    Q, R, S = p.stage(cost)
    Q = block_diag(Q + w.position * np.outer(e, e), w.integral)
    P, K = riccati(F, G, Q, R, np.vstack([S, [[0.0]]]))
    analytic = float(np.einsum("id,ij,jd->", N, P, N)) + p.unreached(cost)

    closed = F - G @ K
    covariance = solve_discrete_lyapunov(closed, N @ N.T)
    Z = np.concatenate([p.Z_x, np.zeros((*p.Z_x.shape[:2], 1))], axis=2) - p.Z_u @ K
    variance = np.einsum("koi,ij,koj->o", Z, covariance, Z) + np.sum(p.Z_d**2, axis=(0, 2))
    acceleration, shear = variance / discrete.substeps
    current = float(K[0] @ covariance @ K[0]) * REFERENCE_CURRENT**2
    performance = StationaryPerformance.from_mean_squares(plant, cost, acceleration, shear, current)
    error, integral = float(e @ covariance[:n, :n] @ e), float(covariance[n, n])
    whole = performance.cost + w.position * error + w.integral * integral
    if not abs(whole - analytic) <= 1e-6 * analytic:
        raise NumericalError("cost", analytic, f"differs from the closed loop's {whole!r}")
    return IntegralDesign(
        gain=K[0, :n] * REFERENCE_CURRENT / scale,
        integral_gain=float(K[0, n]) * REFERENCE_CURRENT / w.displacement,
        error_row=displacement_error(plant),
        period=period,
        analytic_cost=analytic,
        performance=performance,
        displacement_error_rms=w.displacement * float(np.sqrt(error)),
        spectral_radius=float(np.max(np.abs(np.linalg.eigvals(closed)))),
    )


class IntegralFeedback:
    """The law of an `IntegralDesign` as a `Controller`; xi is its memory.

    Where the current saturates, xi does not move further the way that asks for more of it.

    Parameters
    ----------
    scenario
        Whose observation it reads (the full state in it) and whose current limit it is scaled by.
    design
        The law.
    """

    def __init__(self, scenario: Scenario, design: IntegralDesign) -> None:
        self.row = action_row(scenario, design.gain)  # (size,) action per entry of the observation
        self.error_row = np.zeros_like(self.row)  # (size,) what a period adds to xi [m s]
        self.error_row[: len(design.error_row)] = (
            design.error_row * scenario.plant.state_scale * design.period
        )
        self.integral_gain = -design.integral_gain / scenario.current_limit  # [1/(m s)]

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the action (..., 1) for an observation (..., size), and xi (...) [m s]."""
        x = observation
        xi = np.zeros(x.shape[:-1]) if state is None else np.asarray(state[0], dtype=float)
        if episode_start is not None:
            xi = np.where(np.reshape(episode_start, xi.shape), 0.0, xi)
        wanted = x @ self.row + self.integral_gain * xi
        action = np.clip(wanted, -1.0, 1.0)
        step = x @ self.error_row
        winding = (wanted != action) & (self.integral_gain * step * wanted > 0.0)
        return action[..., None].astype(np.float32), (xi + np.where(winding, 0.0, step),)
