"""Tracking as a linear-quadratic problem: the table follows signals that its current does not reach.

In the corrected equations the current moves ``x_c = [x_A, x_S]`` only, and the target reaches the cost
only as the signals to be followed, ``r = [y~, f~_s]`` after every physics step. Completing the square
over a future of r gives, for the current u_i of period i,

    cost = R_u sum_i (u_i + K x_c,i - v_i)^2 + (what no current changes),
    v_i = (1/R_u) (Z_u' r_i + G' h_i+1),    h_i = Psi r_i + (F - G K)' h_i+1,

with K and R_u of the Riccati equation of x_c alone (Anderson and Moore, Optimal Control, 1990, ch. 4;
Tomizuka, J. Dyn. Syst. Meas. Control 97, 1975). What is not known of the future enters as the
conditional expectation of v_i, and costs R_u times its conditional variance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.lqr.design_states import DesignStates, IntArray
from baselines.lqr.discrete_lyapunov import discrete_lyapunov
from baselines.lqr.sampled import ScaledProblem, riccati
from shake_env.errors import NumericalError, ScenarioError
from shake_env.model.discretization import DiscretePlant
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import REFERENCE_CURRENT
from shake_env.scenario.objective import StageCost


@dataclass(frozen=True)
class TrackingProblem:
    """The lifted problem, split: scaled states, current in units of REFERENCE_CURRENT.

    m states x_c that the current reaches, e exogenous states ``x_e = [x_W, x~_S]``, k physics steps a
    period, `draws` unit normal draws a period.
    """

    discrete: DiscretePlant
    cost: StageCost
    states: DesignStates  # of x_c and x_e together
    indices: IntArray  # (m,) where x_c lies in the full state
    exogenous: IntArray  # (e,) where x_e lies in the full state
    F: FloatArray  # (m, m)
    G: FloatArray  # (m, 1)
    Z_x: FloatArray  # (k, 2, m) [y_A, f_s] [m/s^2, N] after each physics step
    Z_u: FloatArray  # (k, 2, 1)
    A: FloatArray  # (e, e)
    N: FloatArray  # (e, draws)
    C: FloatArray  # (k, 2, e) r = [y~, f~_s] [m/s^2, N] after each physics step
    D: FloatArray  # (k, 2, draws)
    P: FloatArray  # (m, m) Riccati solution of x_c
    K: FloatArray  # (1, m) feedback of x_c
    R_u: float  # curvature of the cost in the current
    closed: FloatArray  # (m, m) F - G K
    L: FloatArray  # (1, e) v_i = L x_e,i + sum_j M_j d_i+j
    M_0: FloatArray  # (1, draws)
    Gamma: FloatArray  # (m, draws) M_j = G' closed'^(j-1) Gamma / R_u for j >= 1

    @classmethod
    def from_plant(
        cls, discrete: DiscretePlant, cost: StageCost, position: float | None = None
    ) -> TrackingProblem:
        """Split the lifted plant and solve what does not depend on the information.

        Parameters
        ----------
        discrete, cost
            Plant at its physics step and control rate, and the stage cost to minimise.
        position
            [m] d: the law also minimises ``((x_a - x_g) / d)^2`` at each period's end, x_g the ground's
            displacement; None leaves the table's position to itself.

        Raises
        ------
        ScenarioError
            If the target drives the specimen directly, as in the printed equations, or the position is
            weighed and the ground filter has no high-pass: its displacement then has no bound.
        NumericalError
            If the Riccati equation has no solution, or target or reference have no stationary response.
        """
        plant, layout = discrete.plant, discrete.layout
        if plant.equations.specimen_feels_target:
            raise ScenarioError("equations", plant.equations, "preview needs the corrected equations")
        p = ScaledProblem.from_plant(
            discrete, DesignStates.from_plant(plant, whole=position is not None)
        )
        inside = (p.indices >= layout.controlled.start) & (p.indices < layout.controlled.stop)
        c, e = np.flatnonzero(inside), np.flatnonzero(~inside)
        F, G, A, N = p.F[np.ix_(c, c)], p.G[c], p.F[np.ix_(e, e)], p.N[e]
        radius = float(np.max(np.abs(np.linalg.eigvals(A))))
        if not radius < 1.0:
            raise NumericalError("spectral radius", radius, "target and reference must be stationary")
        # The errors are Z - r: what the lifted errors make of exogenous states and draws is -r.
        Z_x, Z_u, C, D = p.Z_x[:, :, c], p.Z_u, -p.Z_x[:, :, e], -p.Z_d
        z_x, z_u, r_e, r_d = (weighted_outputs(cost, part) for part in (Z_x, Z_u, C, D))
        if position is not None:
            place = p.place(plant, position)
            on_table, on_ground = place[c], -place[e]
            z_x, z_u = np.vstack([z_x, on_table @ F]), np.vstack([z_u, on_table @ G])
            r_e, r_d = np.vstack([r_e, on_ground @ A]), np.vstack([r_d, on_ground @ N])
        stage = z_u.T @ z_u + cost.current * REFERENCE_CURRENT**2
        P, K = riccati(F, G, z_x.T @ z_x, stage, z_x.T @ z_u)
        R_u = float((stage + G.T @ P @ G)[0, 0])
        closed = F - G @ K
        Psi = (z_x - z_u @ K).T
        H = discrete_lyapunov(closed.T, Psi @ r_e, A)  # E[h_i | x_e,i] = H x_e,i
        return cls(
            discrete, cost, p.states, p.indices[c], p.indices[e],
            F, G, Z_x, Z_u, A, N, C, D, P, K, R_u, closed,
            L=(z_u.T @ r_e + G.T @ H @ A) / R_u,
            M_0=(z_u.T @ r_d + G.T @ H @ N) / R_u,
            Gamma=Psi @ r_d + closed.T @ H @ N,
        )  # fmt: skip

    def row(self, on_exogenous: FloatArray) -> FloatArray:
        """Return ``-K x_c + on_exogenous x_e`` as a row (n,) over the whole scaled state.

        Parameters
        ----------
        on_exogenous
            (1, e).
        """
        row = np.zeros(self.discrete.layout.order)
        row[self.indices], row[self.exogenous] = -self.K[0], on_exogenous[0]
        return self.states.completed(row, self.discrete.plant.state_scale)

    def future_rows(self, periods: int) -> FloatArray:
        """Return M_0 ... M_(periods - 1), (periods, draws): what v_i takes of each period's draws."""
        rows = np.empty((periods, self.N.shape[1]))
        co_state = self.G.T / self.R_u
        for j in range(periods):
            rows[j] = self.M_0[0] if j == 0 else (co_state @ self.Gamma)[0]
            if j:
                co_state = co_state @ self.closed.T
        return rows

    @property
    def unseen(self) -> float:
        """Conditional variance of v_i given the present state alone."""
        reach = discrete_lyapunov(self.closed, self.G @ self.G.T, self.closed.T) / self.R_u**2
        return float(np.sum(self.M_0**2) + np.einsum("id,ij,jd->", self.Gamma, reach, self.Gamma))


def weighted_outputs(cost: StageCost, outputs: FloatArray) -> FloatArray:
    """Return outputs (k, 2, columns) as rows (2 k, columns) whose squares sum to the stage cost."""
    k = len(outputs)
    weights = np.sqrt(np.array([cost.acceleration, cost.force]) / k)
    rows: FloatArray = (outputs * weights[None, :, None]).reshape(2 * k, -1)
    return rows
