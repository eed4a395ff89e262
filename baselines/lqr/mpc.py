"""Model predictive control: the preview LQR within limits of current, velocity and stroke.

The unknowns are the corrections c_j to the preview law over H periods, ``u_j = -K x_j + v_j + c_j``
(the closed-loop form of Kouvaritakis, Rossiter and Schuurmans, IEEE TAC 45, 2000). Completing the square
makes the whole cost to infinity ``R_u sum c_j^2``, Riccati and expected references behind the horizon
included. Without an active limit c = 0 is therefore the answer and the law is the preview LQR itself.
The current's bound is hard. Velocity and displacement are soft: their excess is a variable with a
steep cost (Kerrigan and Maciejowski, UKACC 2000), so that a solution always exists. The QP is solved by
OSQP (Stellato and others, Math. Prog. Comp. 12, 2020).
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from baselines.lqr.preview import Forecast
from baselines.lqr.tracking_problem import TrackingProblem
from shake_env.errors import ParameterError, ScenarioError, ShakeError, install_hint
from shake_env.model.parameters import FloatArray, require_positive
from shake_env.model.plant import REFERENCE_CURRENT, TABLE_DISPLACEMENT, TABLE_VELOCITY
from shake_env.scenario.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class MPCSettings:
    """Horizon, limits and solver settings; a limit of None is the scenario's, infinity switches it off.

    An excess of s times a limit, the largest over the horizon, costs ``slope s + curvature s^2`` in
    stage costs. A motionless table pays about 2 a period, so that the slope outweighs any tracking.

    Raises
    ------
    ParameterError
        If a value is not above zero.
    """

    horizon: float = 0.2  # [s]
    current: float | None = None  # [A]; None: the scenario's current limit
    velocity: float | None = None  # [m/s]; None: where the scenario's soft limit begins
    displacement: float | None = None  # [m]; None: where the scenario's soft limit begins
    position: float | None = None  # [m] what an error of place is worth, as for `preview_lqr`
    slope: float = 100.0  # [-]
    curvature: float = 1000.0  # [-]
    tolerance: float = 1e-4  # OSQP's eps_abs and eps_rel; 1 is REFERENCE_CURRENT or a limit
    penalty: float = 0.3  # OSQP's rho, kept, so that a decision depends on what is passed in only
    iterations: int = 4000  # at most
    solve_all: bool = False  # True: also where the preview law already keeps every limit

    def __post_init__(self) -> None:
        require_positive(self, "horizon", "slope", "curvature", "tolerance", "penalty", "iterations")
        for name in ("current", "velocity", "displacement", "position"):
            value = getattr(self, name)
            if value is not None and not value > 0.0:
                raise ParameterError(name, value, "must be above 0 (inf: no limit)")


@dataclass(frozen=True)
class DecisionTimes:
    """How long the QPs took, each table's decision by itself."""

    decisions: int  # asked for
    solved: int  # of them by the solver; in the others the preview law kept every limit
    unfinished: int  # stopped at the limit of iterations
    median: float  # [s] of those solved; NaN where none was
    p95: float  # [s]
    longest: float  # [s]


@dataclass(frozen=True)
class Prediction:
    """Signals of the horizon as ``rows @ observation + response @ c``, over their limits.

    In order: currents (H), velocities (H), displacements (H), each at the periods' ends but the
    currents, which are held over them.
    """

    rows: FloatArray  # (3 H, size of the observation)
    response: FloatArray  # (3 H, H); c in units of REFERENCE_CURRENT

    @classmethod
    def from_scenario(
        cls, scenario: Scenario, problem: TrackingProblem, limits: FloatArray, H: int
    ) -> Prediction:
        """Run the preview law's closed loop on a basis; `limits` (3,) [A, m/s, m]."""
        plant, layout, shown = scenario.plant, scenario.plant.layout, scenario.observation
        lifted, n = scenario.discrete.lifted, layout.order
        c = np.r_[layout.controlled]  # the displacement included, which the law may not see
        scale = plant.state_scale[c]
        F = lifted.state[np.ix_(c, c)] * scale / scale[:, None]
        G = lifted.state[c, n] * REFERENCE_CURRENT / scale
        K = -problem.row(problem.L)[c]
        feed = feed_forward(scenario, problem, H)
        state = np.zeros((len(c), shown.size))
        state[np.arange(len(c)), c] = 1.0
        kick = np.zeros((len(c), H))
        signals, responses = np.empty((3, H, shown.size)), np.empty((3, H, H))
        places = [TABLE_VELOCITY, TABLE_DISPLACEMENT]
        for j in range(H):
            u, u_c = feed[j] - K @ state, np.eye(H)[j] - K @ kick
            state, kick = F @ state + np.outer(G, u), F @ kick + np.outer(G, u_c)
            signals[0, j], responses[0, j] = u * REFERENCE_CURRENT, u_c * REFERENCE_CURRENT
            signals[1:, j] = state[places] * scale[places, None]
            responses[1:, j] = kick[places] * scale[places, None]
        by = 1.0 / limits[:, None, None]  # an infinite limit leaves zeros
        return cls((signals * by).reshape(3 * H, -1), (responses * by).reshape(3 * H, H))


def feed_forward(scenario: Scenario, problem: TrackingProblem, periods: int) -> FloatArray:
    """Return what an observation says to MPC of v now and in the coming periods, (periods, size)."""
    shown = scenario.observation
    forecast = Forecast.from_problem(problem, shown.preview_samples, shown.preview_spacing)
    reach, draws = forecast.periods, problem.N.shape[1]
    future = problem.future_rows(reach)
    on_state, on_draws = np.empty((periods, len(problem.A))), np.zeros((periods, reach, draws))
    row, past = problem.L[0], np.empty((periods, draws))
    for j in range(periods):
        # Draws before period j reach v_j through x_e, later ones directly.
        on_state[j] = row
        known = min(j, reach)
        on_draws[j, :known] = past[:j][::-1][:known]
        on_draws[j, known:] = future[: reach - known]
        past[j] = row @ problem.N
        row = row @ problem.A
    b = forecast.expectation(on_draws.reshape(periods, -1))
    feed = np.zeros((periods, shown.size))
    # Observations are over the state's scale, as is x_e; y~ is over the unit target's rms.
    feed[:, problem.exogenous] = on_state - b @ forecast.C_y
    feed[:, shown.preview] = b * math.sqrt(scenario.plant.target_variance)
    return feed


class PredictiveControl:
    """Model predictive control as a `Controller`; what a QP starts from is the passed state.

    Parameters
    ----------
    scenario
        Its plant, objective and limits are the model; its observation must show the full state.
    settings
        Horizon, limits, solver.
    """

    def __init__(self, scenario: Scenario, settings: MPCSettings | None = None) -> None:
        self.settings = s = MPCSettings() if settings is None else settings
        if not scenario.sensing.full_state:
            raise ScenarioError("sensing", scenario.observation.reading_names, "needs the full state")
        limit, share = scenario.limits, scenario.limits.soft_share
        known = (limit.table_velocity, limit.table_displacement)
        soft = [math.inf if value is None else share * value for value in known]
        given = (s.current, s.velocity, s.displacement)
        limits = [
            own if asked is None else asked
            for own, asked in zip((scenario.current_limit, *soft), given, strict=True)
        ]
        problem = TrackingProblem.from_plant(scenario.discrete, scenario.stage_cost, s.position)
        self._H = H = max(1, round(s.horizon / scenario.control_period))
        self.prediction = Prediction.from_scenario(scenario, problem, np.array(limits, dtype=float), H)
        self._action = limits[0] / scenario.current_limit
        self._solver = self._setup(problem.R_u)
        self._times: list[float] = []
        self._decisions = self._unfinished = 0

    def _setup(self, R_u: float) -> Any:
        """Return the solver of ``1/2 c'c + penalties``; only bounds change from one QP to the next."""
        s, H = self.settings, self._H
        soft = np.zeros((2 * H, 2))  # excess of velocity and of displacement
        soft[:H, 0] = soft[H:, 1] = 1.0
        R = self.prediction.response
        A = np.block(
            [
                [R[:H], np.zeros((H, 2))],
                [R[H:], -soft],
                [R[H:], soft],
                [np.zeros((2, H)), np.eye(2)],
            ]
        )
        self._low, self._high = np.full(len(A), -np.inf), np.full(len(A), np.inf)
        self._low[-2:] = 0.0
        weight = 1.0 / (2.0 * R_u)  # the cost is R_u c'c
        try:
            import osqp
        except ImportError:
            raise ShakeError("osqp", "missing", install_hint("classical")) from None
        solver = osqp.OSQP()
        solver.setup(
            sparse.csc_matrix(np.diag(np.append(np.ones(H), [2.0 * s.curvature * weight] * 2))),
            np.append(np.zeros(H), [s.slope * weight] * 2),
            sparse.csc_matrix(A),
            self._low,
            self._high,
            eps_abs=s.tolerance,
            eps_rel=s.tolerance,
            max_iter=int(s.iterations),
            rho=s.penalty,
            adaptive_rho=False,
            warm_starting=True,
            polishing=False,
            verbose=False,
        )
        return solver

    def _solve(self, free: FloatArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return primal and dual solution for signals `free` (3 H,) of the preview law."""
        H = self._H
        current, rest = free[:H], free[H:]
        self._low[:H], self._high[:H] = -1.0 - current, 1.0 - current
        self._high[H : 3 * H], self._low[3 * H : 5 * H] = 1.0 - rest, -1.0 - rest
        begun = time.perf_counter()
        self._solver.update(l=self._low, u=self._high)
        self._solver.warm_start(x=x, y=y)
        solution = self._solver.solve(raise_error=False)
        self._times.append(time.perf_counter() - begun)
        self._unfinished += solution.info.status != "solved"
        return np.array(solution.x), np.array(solution.y)

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the action (..., 1), and primal and dual solutions (..., unknowns), (..., bounds)."""
        H, lanes = self._H, observation.shape[:-1]
        free = (observation @ self.prediction.rows.T).reshape(-1, 3 * H)
        if state is None:
            x, y = np.zeros((len(free), H + 2)), np.zeros((len(free), 5 * H + 2))
        else:
            x, y = (_shifted(np.reshape(part, (len(free), -1)), H) for part in state)
        if episode_start is not None:
            started = np.reshape(episode_start, -1)
            x[started] = y[started] = 0.0
        self._decisions += len(free)
        active = np.any(np.abs(free) > 1.0, axis=1) | self.settings.solve_all
        x[~active] = y[~active] = 0.0
        for lane in np.flatnonzero(active):
            x[lane], y[lane] = self._solve(free[lane], x[lane], y[lane])
        current = free[:, 0] + x[:, 0] * self.prediction.response[0, 0]
        action = np.clip(self._action * np.clip(current, -1.0, 1.0), -1.0, 1.0)
        memory = x.reshape(*lanes, -1), y.reshape(*lanes, -1)
        return action.reshape(*lanes, 1).astype(np.float32), memory

    @property
    def decision_times(self) -> DecisionTimes:
        """How long decisions took since the controller was made."""
        times = np.array(self._times or [math.nan])
        median, p95 = np.quantile(times, [0.5, 0.95])
        return DecisionTimes(
            self._decisions,
            len(self._times),
            self._unfinished,
            float(median),
            float(p95),
            float(np.max(times)),
        )


def _shifted(solution: FloatArray, horizon: int) -> FloatArray:
    """Return solutions (N, ...) one period later: each run of `horizon` entries moves up by one."""
    later = solution.copy()
    whole = solution.shape[1] // horizon * horizon
    runs = later[:, :whole].reshape(len(later), -1, horizon)
    runs[:, :, :-1] = runs[:, :, 1:].copy()
    later[:, :whole] = runs.reshape(len(later), -1)
    return later
