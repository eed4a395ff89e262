"""LQR with friction and valve feed-forward, for a nonlinear table.

Friction and what an orifice withholds are disturbances that the controller knows in advance as well as
it knows the table's velocity, spool and pressure. The nominal closed loop predicts these for the coming
physics steps, and for the velocity how far it may be off; friction and flow expected there are
previewed disturbances, and their feed-forward is that of linear-quadratic theory
(`baselines.lqr.tracking_problem`). It acts through valve, flow and pressure early enough to be there at
the reversal. The usual way (Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30, 1994, sec. 4;
Merritt, Hydraulic Control Systems, 1967, ch. 5) makes up for the present friction, and divides the
current by ``sqrt(1 - sgn(u) p_l / P_s)``: a valve lag late, and blind to the pressure's swing within a
period.

The division is kept as an option, for a preview of what the orifice withholds holds to first order
only: where the load takes a good part of the supply pressure it can do worse than nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from baselines.lqr.design_states import observable_states
from baselines.lqr.preview import PreviewFeedback
from baselines.lqr.tracking_problem import TrackingProblem, weighted_outputs
from shake_env.dynamics.nonlinear import FLOW, FORCE, controlled_plant
from shake_env.errors import ParameterError
from shake_env.model.discretization import first_order_hold
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.model.parameters import FloatArray, require_positive
from shake_env.model.plant import (
    LOAD_PRESSURE,
    REFERENCE_CURRENT,
    SPOOL_POSITION,
    TABLE_VELOCITY,
    StateSpace,
)
from shake_env.scenario.scenario import Scenario

NODES = np.linspace(-3.5, 3.5, 41)  # of the velocity's error, in standard deviations
WEIGHTS = np.exp(-0.5 * NODES**2) / np.sum(np.exp(-0.5 * NODES**2))


@dataclass(frozen=True, kw_only=True)
class Compensation:
    """What is compensated, and how far ahead.

    Raises
    ------
    ParameterError
        If the horizon is not above zero, or the floor not between 0 and 1.
    """

    friction: bool = True
    orifice: Literal["preview", "present", "none"] = "preview"
    horizon: float = 0.04  # [s] four valve lags
    floor: float = 0.1  # [-] of ``1 - sgn(u) p_l / P_s`` where "present" divides by its root

    def __post_init__(self) -> None:
        require_positive(self, "horizon")
        if self.orifice not in ("preview", "present", "none"):
            raise ParameterError("orifice", self.orifice, "must be 'preview', 'present' or 'none'")
        if not 0.0 < self.floor < 1.0:
            raise ParameterError("floor", self.floor, "must lie between 0 and 1")


@dataclass(frozen=True)
class DisturbancePreview:
    """How the coming physics steps are predicted, and what a disturbance there asks for now.

    T = periods * k + 1 times, from the present on; disturbances run straight between them.
    """

    rows: FloatArray  # (3, T, n) load pressure [Pa], velocity [m/s], spool [m] over the scaled state
    velocity_spread: FloatArray  # (T,) standard deviation of the velocity's error [m/s]
    flow_row: FloatArray  # (T,) current per opening that is missing [A/m]
    force_row: FloatArray  # (T,) current per force on the table [A/N]

    @classmethod
    def from_scenario(
        cls, scenario: Scenario, periods: int, position: float | None = None
    ) -> DisturbancePreview:
        """Predict with the closed loop of LQR; `position` as for `preview_lqr`."""
        problem = TrackingProblem.from_plant(scenario.discrete, scenario.stage_cost, position)
        rows, spread = _predicted(scenario, problem, periods)
        flow, force = (_reply(scenario, problem, periods, 1 + c) for c in (FLOW, FORCE))
        return cls(rows, spread, flow, force)


def _predicted(scenario: Scenario, q: TrackingProblem, periods: int) -> tuple[FloatArray, FloatArray]:
    """Return rows (3, T, n) and standard deviations (T,)."""
    plant, lifted, k = scenario.plant, scenario.discrete, scenario.substeps
    n, first = plant.layout.order, plant.layout.actuator.start
    # The displaced table's pressure is part of what the orifice sees, whether or not the law weights it.
    moving = np.intersect1d(observable_states(plant), np.arange(n)[plant.layout.controlled])
    order = np.concatenate([np.union1d(q.indices, moving), q.exogenous])
    scale = plant.state_scale[order]
    A = lifted.model.A[np.ix_(order, order)] * scale / scale[:, None]
    B = lifted.model.B[order, 0] * REFERENCE_CURRENT / scale
    N = lifted.noise[order] / scale[:, None]
    feedback = q.row(q.L)[order]
    read = np.zeros((3, len(order)))
    for row, place in enumerate((LOAD_PRESSURE, TABLE_VELOCITY, SPOOL_POSITION)):
        read[row, np.flatnonzero(order == first + place)] = plant.state_scale[first + place]
    # State and covariance of its error together with the current, which is held over a period.
    held = len(order)
    step = np.zeros((held + 1, held + 1))
    step[:held, :held], step[:held, held], step[held, held] = A, B, 1.0
    renew = np.eye(held + 1)
    renew[held] = np.append(feedback, 0.0)
    noise = np.zeros((held + 1, held + 1))
    noise[:held, :held] = N @ N.T
    mean = renew[:, :held].copy()
    covariance = np.zeros((held + 1, held + 1))
    rows, variances = [read @ mean[:held]], [0.0]
    for t in range(1, periods * k + 1):
        mean, covariance = step @ mean, step @ covariance @ step.T + noise
        rows.append(read @ mean[:held])
        variances.append(float(read[1] @ covariance[:held, :held] @ read[1]))
        if t % k == 0:
            mean, covariance = renew @ mean, renew @ covariance @ renew.T
    full = np.zeros((3, len(rows), n))
    full[:, :, order] = np.stack(rows, axis=1)
    return full, np.sqrt(variances)


def _reply(scenario: Scenario, q: TrackingProblem, periods: int, column: int) -> FloatArray:
    """Return the current (T,) that a unit disturbance at each time asks for now.

    With its effect ``B f`` on the state and ``Z_f f`` on the errors of a period, the stage's
    square completes as in `baselines.lqr.tracking_problem`:
    ``u = -K x - (1/R_u) (G'P B f + Z_u' Z_f f + G' s)``,
    ``s_i = closed' s_i+1 + (closed' P B + Psi Z_f) f_i``.
    """
    plant, k = scenario.plant, scenario.substeps
    layout, cost = plant.layout, scenario.stage_cost
    table = controlled_plant(plant, Nonlinearity())
    force = StateSpace(table.A, table.B[:, [column]], table.C, table.D[:, [column]])
    step, following = first_order_hold(
        force, scenario.physics_step, plant.state_scale[layout.controlled]
    )
    state = np.zeros((len(step.A), k + 1))
    outputs = np.empty((k, 2, k + 1))
    for j in range(k):
        state = step.A @ state
        state[:, j] += step.B[:, 0]
        state[:, j + 1] += following[:, 0]
        outputs[j] = step.C @ state
        outputs[j][:, j + 1] += step.D[:, 0]
    moved = np.zeros((layout.order, k + 1))
    moved[layout.controlled] = state
    inside = np.isin(q.states.indices, q.indices)
    B = q.states.rows(moved)[inside] / plant.state_scale[q.indices][:, None]
    z_x, z_u, z_f = (weighted_outputs(cost, part) for part in (q.Z_x, q.Z_u, outputs))
    row = np.zeros(periods * k + 1)
    now = q.G.T @ q.P @ B + z_u.T @ z_f
    later = q.closed.T @ q.P @ B + (z_x - z_u @ q.K).T @ z_f
    co_state = q.G.T
    for i in range(periods):
        row[i * k : (i + 1) * k + 1] += (now if i == 0 else co_state @ later)[0]
        if i:
            co_state = co_state @ q.closed.T
    return -row * REFERENCE_CURRENT / q.R_u


class FeedforwardLQR:
    """LQR, with what the scenario previews, and feed-forward for its nominal friction and orifice.

    Parameters
    ----------
    scenario
        Whose `nonlinearity` is compensated; its observation must show the full state.
    compensation
        What is compensated.
    position
        [m] what an error of the table's place is worth, as for `preview_lqr`; None: nothing.
    """

    def __init__(
        self,
        scenario: Scenario,
        compensation: Compensation | None = None,
        position: float | None = None,
    ) -> None:
        c = Compensation() if compensation is None else compensation
        self.row = PreviewFeedback(scenario, position=position).row  # (size,)
        self.order = scenario.plant.layout.order  # entries of the full state
        self.limit = scenario.current_limit  # [A]
        parts, layout = scenario.nonlinearity, scenario.plant.layout
        self.friction = parts.friction if c.friction and parts.friction.active else None
        self.valve = parts.valve if c.orifice == "preview" and parts.valve.flow_active else None
        if self.friction is not None or self.valve is not None:
            periods = max(1, math.ceil(c.horizon / scenario.control_period - 1e-9))
            self.preview = DisturbancePreview.from_scenario(scenario, periods, position)
        pressure = scenario.plant.state_scale[layout.actuator][LOAD_PRESSURE]
        self._pressure = layout.actuator.start + LOAD_PRESSURE
        # Load pressure per unit of its entry, over the supply's [-]; 0: not compensated.
        self.load = pressure / parts.valve.supply_pressure if c.orifice == "present" else 0.0
        self._floor = c.floor

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the action (..., 1) for an observation (..., size), within [-1, 1]."""
        action = observation @ self.row
        if self.friction is not None:
            action = action + self.friction_current(observation) / self.limit
        if self.valve is not None:
            action = action + self.flow_current(observation) / self.limit
        if self.load:
            share = 1.0 - np.sign(action) * observation[..., self._pressure] * self.load
            action = action / np.sqrt(np.maximum(share, self._floor))
        return np.clip(action, -1.0, 1.0)[..., None].astype(np.float32), None

    def friction_current(self, observation: NDArray[np.float32]) -> FloatArray:
        """Return the current (...) [A] that makes up for the friction expected over the horizon."""
        assert self.friction is not None  # the caller asked
        p = self.preview
        velocity = observation[..., : self.order] @ p.rows[1].T
        spread = velocity[..., None] + p.velocity_spread[:, None] * NODES
        force: FloatArray = self.friction.force(spread) @ WEIGHTS
        current: FloatArray = force @ p.force_row
        return current

    def flow_current(self, observation: NDArray[np.float32]) -> FloatArray:
        """Return the current (...) [A] that makes up for the flow that the valve will withhold.

        Orifice, dead band and the spool's stop, at the predicted pressure and spool position.
        """
        assert self.valve is not None  # the caller asked
        p, x = self.preview, observation[..., : self.order]
        pressure, spool = x @ p.rows[0].T, x @ p.rows[2].T
        missing = self.valve.opening(spool, pressure) - spool
        current: FloatArray = missing @ p.flow_row
        return current
