"""Sampled-data LQR on the environment's own discrete model, and the analytic cost of a linear law.

The stage cost of a control period is lifted exactly: its value after every physics step is a linear
function of the state, the held current and the noise, so that cost, gain and J* have no step error
(compare Anderson and Moore, Optimal Control, 1990, ch. 11, and Chen and Francis, Optimal
Sampled-Data Control Systems, 1995).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from baselines.lqr.design_states import DesignStates, IntArray
from shake_env.errors import NumericalError, ParameterError, ScenarioError
from shake_env.model.discretization import DiscretePlant
from shake_env.model.parameters import FloatArray, is_number
from shake_env.model.plant import REFERENCE_CURRENT, CoupledPlant
from shake_env.scenario.objective import StageCost
from shake_env.scenario.scenario import Scenario

GROUND_DISPLACEMENT = 2  # place in the state of a ground filter with the high-pass

_NO_SOLUTION = (
    "has no stabilising solution that arithmetic can find: damp every storey and the table, and check "
    "the units of mass, stiffness and valve"
)


@dataclass(frozen=True)
class StationaryPerformance:
    """Stationary response of a linear law to the unit-intensity filtered noise."""

    cost: float  # expected stage cost
    acceleration_rms: float  # of y_A - y~ [m/s^2]
    base_shear_rms: float  # of f_s - f~_s [N]
    acceleration_rms_ratio: float  # relative to the target's rms [-]
    base_shear_rms_ratio: float  # relative to the reference's rms [-]
    current_rms: float  # [A]

    @classmethod
    def from_mean_squares(
        cls,
        plant: CoupledPlant,
        cost: StageCost,
        acceleration: float,
        shear: float,
        current: float,
    ) -> StationaryPerformance:
        """Put the mean squares of both errors [(m/s^2)^2, N^2] and the current [A^2] together."""
        return cls(
            cost=float(cost.acceleration * acceleration + cost.force * shear + cost.current * current),
            acceleration_rms=float(np.sqrt(acceleration)),
            base_shear_rms=float(np.sqrt(shear)),
            acceleration_rms_ratio=float(np.sqrt(acceleration / plant.target_variance)),
            base_shear_rms_ratio=float(np.sqrt(shear / plant.reference_shear_variance)),
            current_rms=float(np.sqrt(current)),
        )


def action_row(scenario: Scenario, gain: FloatArray) -> FloatArray:
    """Return ``u = -gain @ x`` as a row: fraction of the current limit per observation entry.

    The row has the observation's length; what follows the full state in it gets no weight.

    Raises
    ------
    ParameterError
        If the gain has not one entry a state.
    ScenarioError
        If the scenario does not show the full state.
    """
    if not scenario.sensing.full_state:
        raise ScenarioError(
            "sensing", scenario.observation.reading_names, "the law needs the full state: use lqg"
        )
    if gain.shape != (scenario.plant.layout.order,):
        raise ParameterError("gain shape", gain.shape, f"must be ({scenario.plant.layout.order},)")
    row = np.zeros(scenario.observation.size)
    row[: len(gain)] = -gain * scenario.plant.state_scale / scenario.current_limit
    return row


class LinearFeedback:
    """A state feedback as a `Controller`: observation in, fraction of the current limit out.

    Parameters
    ----------
    scenario
        Whose observation it reads and whose current limit it is scaled by.
    gain
        (n,) [A per SI unit of each state], ``u = -gain @ x``.
    """

    def __init__(self, scenario: Scenario, gain: FloatArray) -> None:
        self.row = action_row(scenario, gain)  # (size,) action per entry of the observation

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the action (..., 1) for an observation (..., n), within [-1, 1]."""
        action = np.clip(observation @ self.row, -1.0, 1.0)
        return action[..., None].astype(np.float32), None


def lqr(scenario: Scenario) -> LinearFeedback:
    """Return the sampled-data LQR of a scenario's own model and objective, ready to drive it."""
    return LinearFeedback(scenario, sampled_lqr(scenario.discrete, scenario.stage_cost).gain)


@dataclass(frozen=True)
class LQRDesign:
    """A sampled-data LQR: ``u = -gain @ x`` with the full state x in SI."""

    gain: FloatArray  # (n,) [A per SI unit of each state]; a table that stands displaced asks for none
    analytic_cost: float  # J*, stationary expected stage cost
    performance: StationaryPerformance


@dataclass(frozen=True)
class ScaledProblem:
    """The lifted problem on a design's states, scaled, and a current in units of REFERENCE_CURRENT."""

    F: FloatArray  # (m, m)
    G: FloatArray  # (m, 1)
    N: FloatArray  # (m, draws)
    Z_x: FloatArray  # (k, 2, m) errors [m/s^2, N] after each physics step
    Z_u: FloatArray  # (k, 2, 1)
    Z_d: FloatArray  # (k, 2, draws)
    states: DesignStates
    scale: FloatArray  # (m,)

    @classmethod
    def from_plant(cls, discrete: DiscretePlant, states: DesignStates | None = None) -> ScaledProblem:
        """Scale the lifted plant; `states` None leaves out what stands still and costs nothing."""
        plant, lifted = discrete.plant, discrete.lifted
        n = plant.layout.order
        states = DesignStates.from_plant(plant) if states is None else states
        retained, scale = states.indices, plant.state_scale[states.indices]
        state = states.rows(lifted.state)
        errors = lifted.outputs[:, [0, 1]] - lifted.outputs[:, [2, 3]]
        return cls(
            F=state[:, retained] * scale / scale[:, None],
            G=state[:, n : n + 1] * REFERENCE_CURRENT / scale[:, None],
            N=state[:, n + 1 :] / scale[:, None],
            Z_x=errors[:, :, retained] * scale,
            Z_u=errors[:, :, n : n + 1] * REFERENCE_CURRENT,
            Z_d=errors[:, :, n + 1 :],
            states=states,
            scale=scale,
        )

    @property
    def indices(self) -> IntArray:
        """Places (m,) of the design's states in the full state."""
        return self.states.indices

    def gain(self, K: FloatArray) -> FloatArray:
        """Return the law's gain (n,) [A per SI unit of each state] from K (1, m)."""
        gain = np.zeros(len(self.states.left_out))
        gain[self.indices] = K[0] * REFERENCE_CURRENT / self.scale
        return self.states.completed(gain, np.ones(len(gain)))

    def stage(self, cost: StageCost) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return Q, R, S, (m, m), (1, 1) and (m, 1), of the expected stage ``x'Qx + u'Ru + 2 x'Su``."""
        weights = np.array([cost.acceleration, cost.force]) / len(self.Z_x)
        Q = np.einsum("o,koi,koj->ij", weights, self.Z_x, self.Z_x)
        S = np.einsum("o,koi,koj->ij", weights, self.Z_x, self.Z_u)
        R = np.einsum("o,koi,koj->ij", weights, self.Z_u, self.Z_u)
        return Q, R + cost.current * REFERENCE_CURRENT**2, S

    def place(self, plant: CoupledPlant, position: float) -> FloatArray:
        """Return the row (m,) of the table's error of place in units of `position` [m].

        The problem must keep the whole state.

        Raises
        ------
        ParameterError
            If the position is not above 0.
        ScenarioError
            If the ground filter has no high-pass: its displacement then has no bound.
        """
        if not (is_number(position) and 0.0 < position < math.inf):
            raise ParameterError(
                "position", position, "must be above 0 m, or None: no displacement weight"
            )
        if plant.layout.filter_states != 4:
            raise ScenarioError(
                "highpass_frequency", plant.ground.highpass_frequency, "a displacement weight needs one"
            )
        row = np.zeros(len(self.scale))
        row[plant.layout.table_displacement], row[GROUND_DISPLACEMENT] = 1.0, -1.0
        return row * self.scale / position

    def unreached(self, cost: StageCost) -> float:
        """Return the part of the stage cost that the noise within a period makes, whatever the law."""
        acceleration, force = np.sum(self.Z_d**2, axis=(0, 2)) / len(self.Z_d)
        return float(cost.acceleration * acceleration + cost.force * force)


def riccati(
    F: FloatArray, G: FloatArray, Q: FloatArray, R: FloatArray, S: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return P and K, (m, m) and (inputs, m), of the LQ problem with stage ``x'Qx + 2 x'Su + u'Ru``.

    Raises
    ------
    NumericalError
        If there is no stabilising solution, or it fails its residual check.
    """
    try:
        P = solve_discrete_are(F, G, Q, R, s=S)
    except (ValueError, np.linalg.LinAlgError) as error:  # scipy raises either
        raise NumericalError("Riccati equation", str(error), _NO_SOLUTION) from error
    K: FloatArray = np.linalg.solve(R + G.T @ P @ G, G.T @ P @ F + S.T)
    residual = F.T @ P @ F - P + Q - (F.T @ P @ G + S) @ K
    if not np.max(np.abs(residual)) <= 1e-8 * np.max(np.abs(P)):
        raise NumericalError("Riccati residual", float(np.max(np.abs(residual))), "is too large")
    # A pole on the unit circle that no current reaches lands on either side of it by rounding.
    radius = float(np.max(np.abs(np.linalg.eigvals(F - G @ K))))
    if not radius < 1.0 - 1e-10:
        raise NumericalError("Riccati equation's closed-loop radius", radius, _NO_SOLUTION)
    return P, K


def sampled_lqr(discrete: DiscretePlant, cost: StageCost) -> LQRDesign:
    """Design the LQR that minimises the stationary expected stage cost.

    Raises
    ------
    NumericalError
        If the Riccati solution fails its residual, stability or cost check.
    """
    p = ScaledProblem.from_plant(discrete)
    Q, R, S = p.stage(cost)
    P, K = riccati(p.F, p.G, Q, R, S)
    gain = p.gain(K)
    analytic = float(np.einsum("id,ij,jd->", p.N, P, p.N)) + p.unreached(cost)
    performance = stationary_performance(discrete, cost, gain)
    if not abs(performance.cost - analytic) <= 1e-6 * analytic:
        raise NumericalError(
            "J*", analytic, f"differs from the closed loop's Lyapunov cost {performance.cost!r}"
        )
    return LQRDesign(gain, analytic, performance)


def stationary_performance(
    discrete: DiscretePlant, cost: StageCost, gain: FloatArray
) -> StationaryPerformance:
    """Return the exact stationary performance of ``u = -gain @ x``.

    Parameters
    ----------
    gain
        (n,) [A per SI unit of each state]. A table that stands displaced is left out if the law ignores
        it (`DesignStates.from_law`).

    Raises
    ------
    NumericalError
        If the closed loop is not stable.
    """
    if gain.shape != (discrete.layout.order,):
        raise ParameterError("gain shape", gain.shape, f"must be ({discrete.layout.order},)")
    if not np.isfinite(gain).all():
        raise ParameterError("gain", gain, "must be finite")
    plant = discrete.plant
    p = ScaledProblem.from_plant(discrete, DesignStates.from_law(plant, gain))
    K = (gain[p.indices] * p.scale / REFERENCE_CURRENT)[None, :]
    closed = p.F - p.G @ K
    radius = float(np.max(np.abs(np.linalg.eigvals(closed))))
    if not radius < 1.0:
        raise NumericalError("spectral radius", radius, "the closed loop is unstable")
    covariance = solve_discrete_lyapunov(closed, p.N @ p.N.T)
    Z = p.Z_x - p.Z_u @ K
    variance = np.einsum("koi,ij,koj->o", Z, covariance, Z) + np.sum(p.Z_d**2, axis=(0, 2))
    acceleration, shear = variance / discrete.substeps
    current = float(K[0] @ covariance @ K[0]) * REFERENCE_CURRENT**2
    return StationaryPerformance.from_mean_squares(plant, cost, acceleration, shear, current)
