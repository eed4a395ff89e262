"""Nonlinear model predictive control: at every period a plan over a horizon on the exact model.

The state is estimated by the extended Kalman filter, target and reference over the horizon are
conditional means, and the plan is one Gauss-Newton iteration of control-limited iterative LQR from the
last period's plan (the real-time iteration of Diehl, Bock and Schloeder, SIAM J. Control Optim. 43,
2005). The loop delay is part of the model: the commands under way are states. Soft and hard limits are
those of the scenario. On a linear table without limits the law is preview LQR.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.estimation.ground_estimate import ReferenceRecursion
from baselines.planning.ekf import ExtendedKalmanFilter, TableEstimate, model_error
from baselines.planning.forecast import HorizonForecast
from baselines.planning.model import PlanningModel, compiled
from shake_env.dynamics.nonlinear import apply
from shake_env.dynamics.yielding_reference import YieldingReference
from shake_env.errors import ParameterError
from shake_env.model.parameters import FloatArray, require_positive
from shake_env.scenario.scenario import Scenario

STEP_LENGTHS = (1.0, 0.5, 0.2, 0.05)


@dataclass(frozen=True, kw_only=True)
class NMPCSettings:
    """Horizon, weight of the place and size of the model's errors.

    Raises
    ------
    ParameterError
        If a value is not above zero.
    """

    horizon: float = 0.06  # [s]
    iterations: int = 1  # Gauss-Newton iterations a period
    displacement_tolerance: float | None = 0.2  # [m] see `preview_lqr`
    model_error_scale: float = 0.1  # [-] factor on the filter's disturbances, see `model_error`

    def __post_init__(self) -> None:
        require_positive(self, "horizon", "iterations", "model_error_scale")
        if self.displacement_tolerance is not None and not self.displacement_tolerance > 0.0:
            raise ParameterError(
                "displacement_tolerance", self.displacement_tolerance, "must be above 0 m, or None"
            )


@dataclass(frozen=True)
class Design:
    """What a decision is made with: common to the tables, or with an axis (N) ahead."""

    signals: FloatArray  # (2 H k, e + p) see `HorizonForecast`
    place: FloatArray  # (H, e + p)
    linear_cost: FloatArray  # (n, e + p) of the scaled state at the horizon's end
    curvature: FloatArray  # (n, n)
    follow: FloatArray  # (2 stories, 2 stories) S, W_before and W_now of `ReferenceRecursion`
    before: FloatArray  # (2 stories, w)
    now: FloatArray  # (2 stories, w)
    weights: FloatArray  # (3) of acceleration, force and current, SI

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """The design as plain arrays, in the order of its fields."""
        return tuple(getattr(self, field.name) for field in fields(self))


@dataclass(frozen=True)
class PlanMemory:
    """What the controller knows of its N tables from one period to the next."""

    estimate: TableEstimate
    current: FloatArray  # (N,) command of the last period [A]
    plan: FloatArray  # (N, H) [A]
    ground: FloatArray  # (N, w) x_W as last shown, over its scale
    reference: FloatArray  # (N, 2 stories) x~_S over its scale; with yielding storeys (N, 3 stories) SI
    target: FloatArray  # (N, k + 1) y~ now, and as expected over the coming period [m/s^2]
    response: FloatArray  # (N, H, 2 k) of the plan: y_A [m/s^2] after each physics step, then f_s [N]
    tables: Any = None  # what an adaptive law knows of each table's parameters


class NonlinearPredictiveControl:
    """Nonlinear model predictive control as a `Controller`.

    Parameters
    ----------
    scenario
        Its nominal plant, delay, sensors, objective and limits are the model.
    settings
        Horizon and weights.

    Raises
    ------
    ScenarioError
        If the equations are not the corrected ones.
    ShakeError
        If numba is missing.
    """

    def __init__(self, scenario: Scenario, settings: NMPCSettings | None = None) -> None:
        chosen = NMPCSettings() if settings is None else settings
        if scenario.ground.highpass_frequency is None:
            chosen = replace(chosen, displacement_tolerance=None)
        self.settings = chosen
        self._scenario, self._shown = scenario, scenario.observation
        self._layout = scenario.plant.layout
        self.horizon = H = max(1, round(chosen.horizon / scenario.control_period))
        plain = PlanningModel.of(scenario)
        shown = 4 + 2 * scenario.specimen.stories
        # The full state is read as it is, if no state of the model is missing from it.
        self.filter: ExtendedKalmanFilter | None = None
        self.model = plain
        if not scenario.sensing.full_state or plain.order > shown:
            self.filter = ExtendedKalmanFilter.from_scenario(
                scenario, model_error(scenario, chosen.model_error_scale)
            )
            self.model = self.filter.model
        self.forecast = HorizonForecast.from_scenario(
            scenario, self.model, H, chosen.displacement_tolerance
        )
        recursion, cost = ReferenceRecursion.from_scenario(scenario), scenario.stage_cost
        self._common = Design(
            signals=self.forecast.signals,
            place=self.forecast.place,
            linear_cost=self.forecast.on_end @ self.forecast.end + self.forecast.beyond,
            curvature=self.forecast.curvature,
            follow=recursion.S,
            before=recursion.W_before,
            now=recursion.W_now,
            weights=np.array([cost.acceleration, cost.force, cost.current]),
        )
        self._yielding = None
        if scenario.nonlinearity.yielding.active:
            maps = YieldingReference.from_plant(
                scenario.plant, scenario.nonlinearity.yielding, scenario.physics_step
            )
            arrays = (maps.A, maps.ground, maps.ground_next, maps.level, maps.slope, maps.C)
            self._yielding = tuple(np.ascontiguousarray(array) for array in arrays)

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the action (..., 1) for an observation (..., n), and ``(PlanMemory,)``."""
        lead = observation.shape[:-1]
        shown = np.asarray(observation, dtype=float).reshape(-1, observation.shape[-1])
        lanes = len(shown)
        fresh = np.ones(lanes, dtype=bool)
        last = self._rest(lanes) if state is None else state[0]
        if state is not None:
            none = np.zeros(lanes, dtype=bool)
            fresh = none if episode_start is None else np.reshape(episode_start, lanes).astype(bool)
        memory = self._decide(shown, last, fresh)
        action = memory.current / self._scenario.current_limit
        return action.astype(np.float32).reshape(*lead, 1), (memory,)

    def expected(
        self, memory: PlanMemory, ahead: Sequence[int]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what the plan that was just made says of some periods.

        Parameters
        ----------
        memory
            What `predict` returned.
        ahead
            Periods (a), 0 the one that begins now, below `horizon`.

        Returns
        -------
        Currents (N, a) [A] held over them, and table acceleration [m/s^2] and base shear [N] expected at
        the end of each (N, a).
        """
        places, k = list(ahead), self._scenario.substeps
        signals = memory.response[:, places]
        return memory.plan[:, places], signals[:, :, k - 1], signals[:, :, 2 * k - 1]

    def _rest(self, lanes: int) -> PlanMemory:
        n, k = self._scenario.specimen.stories, self._scenario.substeps
        if self.filter is not None:
            estimate = self.filter.rest(lanes)
        else:
            none = np.zeros((lanes, 0))
            estimate = TableEstimate(np.zeros((lanes, self.model.states)), none, none, none)
        return PlanMemory(
            estimate,
            np.zeros(lanes),
            np.zeros((lanes, self.horizon)),
            np.zeros((lanes, self._layout.filter_states)),
            np.zeros((lanes, (2 if self._yielding is None else 3) * n)),
            np.zeros((lanes, k + 1)),
            np.zeros((lanes, self.horizon, 2 * k)),
        )

    def _decide(self, shown: FloatArray, last: PlanMemory, fresh: NDArray[np.bool_]) -> PlanMemory:
        layout, observed, k, H = self._layout, self._shown, self._scenario.substeps, self.horizon
        lanes, sensing = len(shown), self._scenario.sensing
        given = last.current
        if sensing.last_action:
            # What the table was given, also behind a supervisor that changes commands.
            given = shown[:, observed.last_action.start] * self._scenario.current_limit
        given = np.where(fresh, 0.0, given)
        readings = shown[:, layout.controlled if sensing.full_state else observed.readings]
        estimate, tables = self._estimate(last, given, readings, fresh)
        tables = self._noted(tables, shown[:, layout.ground], fresh)
        design = self._design(tables)
        ground, preview = shown[:, layout.ground], shown[:, observed.preview]
        reference, linear = self._reference(shown, last, ground, fresh, tables)
        z = np.concatenate([ground, linear, preview], axis=1)
        signals = apply(design.signals, z)
        target = signals[:, : H * k]
        shear, p = signals[:, H * k :], apply(design.linear_cost, z)
        now = np.where(fresh, 0.0, last.target[:, -1])
        coming = np.concatenate([now[:, None], target[:, :k]], axis=1)
        if self._yielding is not None:
            shear, p = self._yielding_reference(z, reference, now, target)
        start = np.concatenate([last.plan[:, 1:], last.plan[:, -1:]], axis=1)
        start[fresh] = 0.0
        position = self.settings.displacement_tolerance
        plan = self.model.improve(
            start, estimate.state, target.reshape(lanes, H, k), shear.reshape(lanes, H, k),
            place=apply(design.place, z),
            place_weight=0.0 if position is None else 1.0 / position**2,
            weights=np.atleast_2d(design.weights),
            tail=(np.reshape(design.curvature, (-1, *design.curvature.shape[-2:])), p),
            models=self._plan_models(tables),
            step_lengths=STEP_LENGTHS,
            iterations=self.settings.iterations,
        )  # fmt: skip
        current, response = plan.current, plan.response
        return PlanMemory(estimate, current[:, 0], current, ground, reference, coming, response, tables)

    def _design(self, tables: Any) -> Design:
        """Return what the decisions of the tables are made with."""
        return self._common

    def _noted(self, tables: Any, ground: FloatArray, fresh: NDArray[np.bool_]) -> Any:
        """Return what is known of each table, with the filter state x_W (N, w) of now noted."""
        return tables

    def _plan_models(self, tables: Any) -> tuple[Any, ...] | None:
        """Return the models that the tables are planned on; None: the nominal one."""
        return None

    def _estimate(
        self, memory: PlanMemory, given: FloatArray, readings: FloatArray, fresh: NDArray[np.bool_]
    ) -> tuple[TableEstimate, Any]:
        """Return the estimate, this observation included, and what is known of each table."""
        last = memory.estimate
        if self.filter is not None:
            return self.filter.advance(last, given, readings, fresh), None
        order, state = self.model.order, np.zeros_like(last.state)
        state[:, :order] = readings * self.model.scale[:order]
        if self.model.states > order:
            state[:, order:-1] = np.where(fresh[:, None], 0.0, last.state[:, order + 1 :])
            state[:, -1] = given
        return replace(last, state=state), None

    def _reference(
        self,
        shown: FloatArray,
        last: PlanMemory,
        ground: FloatArray,
        fresh: NDArray[np.bool_],
        tables: Any,
    ) -> tuple[FloatArray, FloatArray]:
        """Return what is remembered of the reference, and x~_S (N, 2 stories) over its scale."""
        n, sensing = self._scenario.specimen.stories, self._scenario.sensing
        scale = self._scenario.plant.state_scale[self._layout.reference]
        reference = shown[:, self._layout.reference] if sensing.full_state else None
        if self._yielding is None:
            if reference is None:
                design = self._design(tables)
                moved = apply(design.follow, last.reference) + apply(design.before, last.ground)
                moved = moved + apply(design.now, ground)
                reference = np.where(fresh[:, None], 0.0, moved)
            return reference, reference
        state = last.reference.copy()
        target = np.ascontiguousarray(last.target)
        compiled("filter_kernel").follow_targets(
            state, target, self._yielding, self.model.arrays[7], np.zeros_like(target[:, 1:])
        )
        state[fresh] = 0.0
        if reference is not None:
            state[:, : 2 * n] = reference * scale
        return state, state[:, : 2 * n] / scale

    def _yielding_reference(
        self, z: FloatArray, reference: FloatArray, now: FloatArray, target: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the shear (N, H k) [N] and the tail's linear cost (N, n) of a yielding reference."""
        n, w, ahead = self._scenario.specimen.stories, self._layout.filter_states, self.forecast
        state, shear = reference.copy(), np.zeros_like(target)
        whole = np.concatenate([now[:, None], target], axis=1)
        compiled("filter_kernel").follow_targets(
            state, whole, self._yielding, self.model.arrays[7], shear
        )
        end = z @ ahead.end.T
        # Behind the horizon it is the elastic specimen that its springs are like by then.
        released = 1.0 - self._scenario.nonlinearity.yielding.stiffness_ratio
        like = state[:, : 2 * n].copy()
        like[:, :n] -= released * np.cumsum(state[:, 2 * n :], axis=1)
        end[:, w:] = like / self._scenario.plant.state_scale[self._layout.reference]
        return shear, end @ ahead.on_end.T + z @ ahead.beyond.T
