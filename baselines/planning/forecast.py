"""What an observation says of the horizon: expected target and reference, and the cost behind its end.

Target and reference over the horizon are conditional means given the filter state, the reference
specimen and the previewed samples. Behind the horizon the table is taken for linear: its cost there is
quadratic in the state at the end, and what is known of the target beyond the end enters linearly
(:mod:`baselines.lqr.tracking_problem`, with the loop delay's commands as states). With a linear table
and no limits the plan's first current is therefore that of preview LQR, whatever the horizon.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from baselines.lqr.design_states import observable_states
from baselines.lqr.discrete_lyapunov import discrete_lyapunov
from baselines.lqr.preview import Forecast
from baselines.lqr.sampled import GROUND_DISPLACEMENT, riccati
from baselines.lqr.tracking_problem import TrackingProblem, weighted_outputs
from baselines.planning.ekf import model_error
from baselines.planning.model import PlanningModel, compiled
from shake_env.model.nonlinearity import Nonlinearity, ServoValve
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import REFERENCE_CURRENT, TABLE_DISPLACEMENT
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uncertainty


@dataclass(frozen=True)
class HorizonForecast:
    """Linear maps of ``z = [x_W, x~_S, previewed y~]``, in observation units, (e + p) long."""

    signals: FloatArray  # (2 H k, e + p) y~ [m/s^2] after each physics step, then f~_s [N]
    place: FloatArray  # (H, e + p) ground displacement at each period's end [m]; zeros without one
    end: FloatArray  # (e, e + p) x_e at the horizon's end, over its scale
    on_end: FloatArray  # (n, e) tail's linear cost of the scaled state, from x_e at the end
    beyond: FloatArray  # (n, e + p) the same from what the preview says of the time behind the end
    curvature: FloatArray  # (n, n) tail's P, of z'P z / 2 on the scaled state
    periods: int  # H

    @classmethod
    def from_scenario(
        cls, scenario: Scenario, model: PlanningModel, periods: int, position: float | None
    ) -> HorizonForecast:
        """Return the maps of a scenario's observation.

        Parameters
        ----------
        model
            Whose state the tail is of, with disturbances or without.
        periods
            Horizon H [control periods].
        position
            [m] as for `preview_lqr`.
        """
        cost, discrete = scenario.stage_cost, scenario.discrete
        problem = TrackingProblem.from_plant(discrete, cost, position)
        shown, e = scenario.observation, len(problem.A)
        known = Forecast.from_problem(problem, shown.preview_samples, shown.preview_spacing)
        samples, draws = shown.preview_samples, problem.N.shape[1]
        width = known.periods * draws
        on_y = known.expectation(np.eye(width)) if samples else np.zeros((0, 0))
        rms = np.sqrt(scenario.plant.target_variance)
        # d_j = E[draws of period j | z]
        draw = np.zeros((max(periods, known.periods), draws, e + samples))
        if samples:
            expected = np.hstack([-on_y @ known.C_y, on_y * rms])
            draw[: known.periods] = expected.reshape(known.periods, draws, e + samples)
        scale = scenario.plant.state_scale[problem.exogenous]
        held = scenario.plant.layout.filter_states == 4
        now = np.eye(e, e + samples)
        signals, places = [], []
        for j in range(periods):
            signals.append(problem.C @ now + problem.D @ draw[j])
            now = problem.A @ now + problem.N @ draw[j]
            place = now[GROUND_DISPLACEMENT] * scale[GROUND_DISPLACEMENT]
            places.append(place if held else np.zeros(e + samples))
        ordered = np.array(signals).transpose(2, 0, 1, 3).reshape(-1, e + samples)
        P, on_end, gamma, closed = _tail(scenario, problem, model, position)
        beyond, power = np.zeros((model.states, e + samples)), np.eye(model.states)
        for j in range(periods, known.periods):
            beyond += power @ gamma @ draw[j]
            power = power @ closed.T
        return cls(ordered, np.array(places), now, -2.0 * on_end, -2.0 * beyond, 2.0 * P, periods)


def _tail(
    scenario: Scenario, problem: TrackingProblem, model: PlanningModel, position: float | None
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return P (n, n), H (n, e), Gamma (n, draws) and the closed loop, transposed into `model`'s state.

    As in `TrackingProblem`, for the linear table with its delay: ``V = x'P x - 2 x'h + ...``,
    ``E[h | x_e] = H x_e``, and Gamma what a draw of the first period adds to h.
    """
    cost, plant = scenario.stage_cost, scenario.plant
    valve = scenario.nonlinearity.valve
    linear_valve = ServoValve(
        natural_frequency=valve.natural_frequency, damping_ratio=valve.damping_ratio
    )
    nominal = replace(scenario, uncertainty=Uncertainty())
    linear = replace(nominal, nonlinearity=Nonlinearity(valve=linear_valve))
    table = PlanningModel.of(linear, model_error(scenario) if model.disturbances else None)
    jacobian = compiled("ilqr_kernel").period_with_jacobian
    n = table.states
    _, _, F, G, C, D = jacobian(np.zeros(n), 0.0, table.arrays, table.scale)
    G, D, k = G[:, None] * REFERENCE_CURRENT, D[:, None] * REFERENCE_CURRENT, scenario.substeps
    # Outputs (k, 2, .) as `weighted_outputs` takes them.
    z_x = weighted_outputs(cost, C.reshape(2, k, n).swapaxes(0, 1))
    z_u = weighted_outputs(cost, D.reshape(2, k, 1).swapaxes(0, 1))
    r_e, r_d = weighted_outputs(cost, problem.C), weighted_outputs(cost, problem.D)
    retained = np.arange(n)
    if position is not None:
        row = np.zeros((1, n))
        row[0, TABLE_DISPLACEMENT] = table.scale[TABLE_DISPLACEMENT] / position
        ground = np.zeros((1, len(problem.A)))
        size = plant.state_scale[problem.exogenous][GROUND_DISPLACEMENT]
        ground[0, GROUND_DISPLACEMENT] = size / position
        z_x, z_u = np.vstack([z_x, row @ F]), np.vstack([z_u, row @ G])
        r_e, r_d = np.vstack([r_e, ground @ problem.A]), np.vstack([r_d, ground @ problem.N])
    elif plant.layout.table_displacement not in observable_states(plant):
        retained = np.delete(retained, TABLE_DISPLACEMENT)
    F, G, z_x = F[np.ix_(retained, retained)], G[retained], z_x[:, retained]
    stage = z_u.T @ z_u + cost.current * REFERENCE_CURRENT**2
    P, K = riccati(F, G, z_x.T @ z_x, stage, z_x.T @ z_u)
    closed = F - G @ K
    Psi = (z_x - z_u @ K).T
    H = discrete_lyapunov(closed.T, Psi @ r_e, problem.A)
    Gamma = Psi @ r_d + closed.T @ H @ problem.N
    # The linear state from the nonlinear one: a slip shifts what a storey's spring feels.
    M = _linear_state(scenario, model, table)[retained]
    size = len(problem.A)
    whole = np.zeros((model.states, model.states))
    # Of the closed loop only products with Gamma are asked for: kept in the linear coordinates by M.
    lifted = np.linalg.pinv(M)
    whole = M.T @ closed.T @ lifted.T
    assert H.shape[1] == size
    return M.T @ P @ M, M.T @ H, M.T @ Gamma, whole.T


def _linear_state(scenario: Scenario, model: PlanningModel, table: PlanningModel) -> FloatArray:
    """Return the map (n', n) from the model's scaled state to that of the linear table."""
    n, shown = scenario.specimen.stories, 4 + 2 * scenario.specimen.stories
    slips = n if scenario.nonlinearity.yielding.active else 0
    M = np.zeros((table.states, model.states))
    M[:shown, :shown] = np.eye(shown)
    M[shown:, shown + slips :] = np.eye(table.states - shown)
    released = 1.0 - scenario.nonlinearity.yielding.stiffness_ratio
    for storey in range(slips):
        for below in range(storey + 1):
            sizes = model.scale[shown + below] / model.scale[4 + storey]
            M[4 + storey, shown + below] = -released * sizes
    return M
