"""A full-state law fed by the extended Kalman filter, in place of a linear one.

Friction and what an orifice withholds are in this filter's model. A linear filter takes them for slow
disturbances, and learns of a reversal only after it: with friction feed-forward from its velocity the
laboratory's table does worse than without (`docs/controllers.md`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.estimation.estimator_model import EstimatorModel, ModelError
from baselines.estimation.lqg import EstimatedState, EstimateMemory
from baselines.planning.ekf import ExtendedKalmanFilter, TableEstimate, model_error
from shake_env.controller import Controller
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import LOAD_PRESSURE, SPOOL_POSITION, TABLE_VELOCITY
from shake_env.scenario.scenario import Scenario


class NonlinearEstimate(EstimatedState):
    """A full-state law on measured signals behind an extended Kalman filter: a `Controller`.

    The delay is predicted away on the linear table, with the friction and the missing flow of the
    estimated state, held over the delay, as its disturbances.

    Parameters
    ----------
    scenario, law
        As for `EstimatedState`.
    model_error_scale
        See `baselines.planning.ekf.model_error`.

    Raises
    ------
    ScenarioError
        If the equations are not the corrected ones.
    ShakeError
        If numba is missing.
    """

    def __init__(self, scenario: Scenario, law: Controller, model_error_scale: float = 1.0) -> None:
        linear = EstimatorModel.from_scenario(scenario, ModelError.from_scenario(scenario))
        self._prepare(scenario, law, linear)
        self.filter = ExtendedKalmanFilter.from_scenario(
            scenario, model_error(scenario, model_error_scale)
        )
        self._parts, self._limit = scenario.nonlinearity, scenario.current_limit
        self._size = scenario.plant.state_scale[scenario.plant.layout.controlled]
        self._force = float(self._size[LOAD_PRESSURE] * scenario.actuator.piston_area)

    def _estimate(
        self,
        last: EstimateMemory | None,
        actions: FloatArray,
        readings: FloatArray,
        age: NDArray[np.intp],
        fresh: NDArray[np.bool_],
    ) -> tuple[FloatArray, Any]:
        """Return the linear model's state (..., n) at the estimate, and the estimate."""
        before = self.filter.rest(fresh.size) if last is None else last.nonlinear
        current = self._limit * actions[..., -1].reshape(-1)
        rows = readings.reshape(fresh.size, -1)
        now: TableEstimate = self.filter.advance(before, current, rows, fresh.reshape(-1))
        return self._linear(now.state).reshape(*fresh.shape, -1), now

    def _linear(self, state: FloatArray) -> FloatArray:
        """Return ``[x_A, x_S, force, flow, ...]`` (N, n) of the linear model at states (N, .) [SI]."""
        shown, parts, model = len(self._size), self._parts, self.filter.model
        table = np.zeros((len(state), self._model.order))
        table[:, :shown] = state[:, :shown] / self._size
        disturbances = slice(model.order - model.disturbances, model.order)
        table[:, shown : shown + 2] = state[:, disturbances] / model.scale[disturbances]
        if parts.friction.active:
            table[:, shown] += parts.friction.force(state[:, TABLE_VELOCITY]) / self._force
        if parts.valve.flow_active:
            spool = state[:, SPOOL_POSITION]
            missing = parts.valve.opening(spool, state[:, LOAD_PRESSURE]) - spool
            table[:, shown + 1] += missing / self._size[SPOOL_POSITION]
        return table
