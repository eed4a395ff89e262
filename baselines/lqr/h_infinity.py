"""Guaranteed-cost H-infinity state feedback for a specimen of uncertain mass.

Storeys of another mass at the same frequencies and damping move alike; what changes is the base shear,
by the factor of the mass. The uncertain specimen is therefore the nominal one with a force on the table
``w = delta rho f_s``, abs(delta) <= 1, rho the uncertain share of the mass. A game Riccati equation
(Basar and Bernhard, H-infinity Optimal Control, 1995, ch. 3; solved through python-control) lets w be
the worst of all forces, each paying for its size and earning that of rho f_s. Its value bounds the cost
under every w within the uncertainty: the guaranteed cost of Petersen and McFarlane (IEEE TAC 39, 1994).
The constant scaling d between paying and earning is chosen to make the bound least. The gain from w to
``rho f_s`` is then measured by `baselines.lqr.h_infinity_norm`, which does not use the Riccati equation.

What is guaranteed, for every mass within ``1 +- rho`` of the nominal one, even one that changed at each
physics step: the closed loop is stable, and its mean stage cost is at most `guaranteed_cost`. That holds
for the model whose uncertain force is held over a physics step, with the full state known, without
delay, and without any other uncertainty: storey frequencies are not covered. Noise counts as the white
noise that it is and not as the worst of its energy: an H-infinity bound on that, from noise to errors,
gave up most of the tracking to resist a sine at the specimen's resonance.
"""

from __future__ import annotations

from dataclasses import dataclass

import control
import numpy as np
from scipy.optimize import minimize_scalar

from baselines.lqr.design_states import DesignStates
from baselines.lqr.h_infinity_norm import discrete_h_infinity_norm
from baselines.lqr.sampled import ScaledProblem, StationaryPerformance, stationary_performance
from shake_env.dynamics.nonlinear import FORCE, controlled_plant
from shake_env.errors import NumericalError, ParameterError
from shake_env.model.discretization import zero_order_hold
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import REFERENCE_CURRENT, StateSpace
from shake_env.scenario.scenario import Scenario

SCALINGS = (1e-3, 1e3)  # between which d is searched
TRIALS = 49  # of d before the best is refined


@dataclass(frozen=True)
class RobustDesign:
    """A robust law ``u = -gain @ x`` and what it guarantees."""

    gain: FloatArray  # (n,) [A per SI unit of each state]
    mass_uncertainty: float  # rho [-]
    guaranteed_cost: float  # mean stage cost that no mass within 1 +- rho exceeds
    gamma: float  # H-infinity norm from w to rho f_s, below 1; stable up to rho / gamma [-]
    scaling: float  # d [-]
    performance: StationaryPerformance  # of the nominal plant


@dataclass(frozen=True)
class GeneralizedPlant:
    """One control period: ``x+ = A x + B_w w + B_d d + B_u u`` and what is kept small.

    Scaled states of `baselines.lqr.sampled.ScaledProblem`; w is the uncertain force of each physics step
    over rho and the reference shear's rms, z the base shear at each step's start over the same.
    """

    A: FloatArray  # (m, m)
    B: tuple[FloatArray, FloatArray, FloatArray]  # (m, k), (m, draws), (m, 1)
    C: tuple[FloatArray, FloatArray]  # (k, m) z, (2 k + 1, m) errors and current, weighed
    D: tuple[tuple[FloatArray, FloatArray, FloatArray], ...]  # both rows of outputs on w, d, u

    @classmethod
    def from_scenario(cls, scenario: Scenario, position: float | None = None) -> GeneralizedPlant:
        """Add the uncertain force to the lifted problem of a scenario; see `robust_feedback`."""
        discrete, cost = scenario.discrete, scenario.stage_cost
        p, plant, k = _problem(scenario, position), discrete.plant, discrete.substeps
        layout, unit = plant.layout, float(np.sqrt(plant.reference_shear_variance))
        table = controlled_plant(plant, Nonlinearity())
        columns = [0, 1 + FORCE]
        held = StateSpace(table.A, table.B[:, columns], table.C, table.D[:, columns])
        step = zero_order_hold(held, discrete.dt, plant.state_scale[layout.controlled])
        # The force's way over one period, from rest; states and currents are the lifted model's.
        state = np.zeros((len(step.A), k))
        shear, acceleration = np.zeros((k, k)), np.zeros((k, k))
        for j in range(k):
            shear[j] = step.C[1] @ state
            state = step.A @ state
            state[:, j] += step.B[:, 1]
            acceleration[j] = step.C[0] @ state
            acceleration[j, j] += step.D[0, 1]
        after = np.vstack([shear[1:], step.C[1] @ state])  # f_s after each step
        n = layout.order
        B_w = np.zeros((n, k))
        B_w[layout.controlled] = state * unit
        # f_s at each step's start: the present state's, then the lifted model's after each step but one.
        now = plant.coupled.C[1, p.indices] * p.scale
        lifted = discrete.lifted.outputs[:-1, 1]
        z_x = np.vstack([now, lifted[:, p.indices] * p.scale])
        z_u = np.append(0.0, lifted[:, n] * REFERENCE_CURRENT)[:, None]
        z_d = np.vstack([np.zeros(p.N.shape[1]), lifted[:, n + 1 :]])
        weights = np.sqrt(np.array([cost.acceleration, cost.force]) / k)
        effort = np.sqrt(cost.current) * REFERENCE_CURRENT

        def errors(rows: FloatArray, last: float = 0.0) -> FloatArray:
            weighed = (rows * weights[:, None]).reshape(2 * k, -1)
            return np.vstack([weighed, np.full((1, weighed.shape[1]), last)])

        on_w = np.stack([acceleration, after], axis=1) * unit
        B = (p.states.rows(B_w) / p.scale[:, None], p.N, p.G)
        on_x, on_inputs = errors(p.Z_x), (errors(on_w), errors(p.Z_d), errors(p.Z_u, effort))
        if position is not None:
            place = p.place(plant, position)
            on_x = np.vstack([on_x, place @ p.F])
            on_w, on_d, on_u = (np.vstack([on, place @ b]) for on, b in zip(on_inputs, B, strict=True))
            on_inputs = (on_w, on_d, on_u)
        return cls(A=p.F, B=B, C=(z_x / unit, on_x), D=((shear, z_d / unit, z_u / unit), on_inputs))

    def law(self, rho: float, d: float) -> tuple[FloatArray, float] | None:
        """Return the gain (1, m) against the worst w and its guaranteed cost, or None if there is none.

        The game's stage is ``errors^2 + (d rho z)^2 - (d w)^2``: no force within the uncertainty is
        paid for by its last two terms, so that the game's value bounds the cost.
        """
        (B_w, B_d, B_u), (C_z, C_e) = self.B, self.C
        C = np.vstack([d * rho * C_z, C_e])
        D_w, D_d, D_u = (np.vstack([d * rho * on_z, on_e]) for on_z, on_e in zip(*self.D, strict=True))
        B_w, D_w = B_w / d, D_w / d
        k = B_w.shape[1]
        B, D = np.hstack([B_w, B_u]), np.hstack([D_w, D_u])
        R = D.T @ D
        R[:k, :k] -= np.eye(k)
        try:
            X, _, gains = control.dare(self.A, B, C.T @ C, R, C.T @ D, method="scipy")
        except (ValueError, np.linalg.LinAlgError):
            return None
        K: FloatArray = np.atleast_2d(gains)[k:]
        room = np.eye(k) - D_w.T @ D_w - B_w.T @ X @ B_w
        stable = np.max(np.abs(np.linalg.eigvals(self.A - B_u @ K))) < 1.0
        positive = np.linalg.eigvalsh(0.5 * (X + X.T))[0] > -1e-9 * np.max(np.abs(X))
        if not (stable and positive and np.linalg.eigvalsh(room)[0] > 0.0):
            return None
        # The force of a period knows the period's own noise as well: the most it makes of it.
        mixed = D_w.T @ D_d + B_w.T @ X @ B_d
        noise = B_d.T @ X @ B_d + D_d.T @ D_d + mixed.T @ np.linalg.solve(room, mixed)
        return K, float(np.trace(noise))

    def force_gain(self, K: FloatArray, rho: float) -> float:
        """Return the H-infinity norm [-] from w to ``rho z`` under ``u = -K x`` (1, m)."""
        (B_w, _, B_u), C_z, (on_w, _, on_u) = self.B, self.C[0], self.D[0]
        return discrete_h_infinity_norm(self.A - B_u @ K, B_w, rho * (C_z - on_u @ K), rho * on_w)


def _problem(scenario: Scenario, position: float | None) -> ScaledProblem:
    """Return the lifted problem, of the whole state where there is a displacement weight."""
    states = DesignStates.from_plant(scenario.plant, whole=position is not None)
    return ScaledProblem.from_plant(scenario.discrete, states)


def robust_feedback(
    scenario: Scenario, mass_uncertainty: float, position: float | None = None
) -> RobustDesign:
    """Design the law of least guaranteed cost for masses within ``1 +- mass_uncertainty``.

    Parameters
    ----------
    scenario
        Its specimen is the nominal one.
    mass_uncertainty
        rho, above 0 and below 1.
    position
        [m] error of the table's place that is worth a motionless table's stage cost; the guaranteed
        cost then contains it. None: no error of place is worth anything, and the table drifts.

    Raises
    ------
    ParameterError
        If rho is outside its range.
    ScenarioError
        If the equations are not the corrected ones, or the position is weighed and the ground filter has
        no high-pass.
    NumericalError
        If no law was found, or its measured gain is not below one.
    """
    rho = mass_uncertainty
    if not 0.0 < rho < 1.0:
        raise ParameterError("mass_uncertainty", rho, "must lie between 0 and 1")
    plant = GeneralizedPlant.from_scenario(scenario, position)

    def bound(log_d: float) -> float:
        design = plant.law(rho, float(np.exp(log_d)))
        return np.inf if design is None else design[1]

    grid = np.log(np.geomspace(*SCALINGS, TRIALS))
    best = int(np.argmin([bound(x) for x in grid]))
    near = grid[max(best - 1, 0)], grid[min(best + 1, TRIALS - 1)]
    x = minimize_scalar(bound, bounds=near, method="bounded", options={"xatol": 1e-3}).x
    x = min((float(x), float(grid[best])), key=bound)
    design = plant.law(rho, float(np.exp(x)))
    if design is None:
        raise NumericalError("guaranteed cost", np.inf, "no law holds for so uncertain a mass")
    K, guaranteed = design
    gamma = plant.force_gain(K, rho)
    if not gamma < 1.0:
        raise NumericalError("H-infinity norm", gamma, "the measured gain is not below one")
    p = _problem(scenario, position)
    row = p.gain(K)
    performance = stationary_performance(scenario.discrete, scenario.stage_cost, row)
    return RobustDesign(row, rho, guaranteed, gamma, float(np.exp(x)), performance)
