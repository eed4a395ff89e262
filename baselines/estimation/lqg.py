"""LQG: a full-state law fed by a Kalman filter, with the loop delay predicted away.

`EstimatedState` turns what a scenario shows into the observation of the same table fully seen and
without delay (`full_state`), as it will be when the present command begins to act, and hands that to
any controller designed there. For a linear table this is optimal for a linear-quadratic law: with a
delay of whole physics steps the law's problem is the same, shifted in time, and its state is replaced
by its conditional mean (certainty equivalence and separation: Wonham, SIAM J. Control 6, 1968; Astrom
and Wittenmark, Computer-Controlled Systems, 1997, ch. 11).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.estimation.estimator_model import EstimatorModel, ModelError
from baselines.estimation.ground_estimate import ReferenceRecursion, predicted_ground
from baselines.estimation.kalman import KalmanFilter
from baselines.lqr.sampled import lqr
from shake_env.controller import Controller, decide
from shake_env.model.parameters import FloatArray
from shake_env.scenario.observation import Sensing
from shake_env.scenario.scenario import Scenario


def full_state(scenario: Scenario) -> Scenario:
    """Return the scenario as a full-state law is designed on it: all seen, no delay, no last action.

    The preview keeps its length. Where the loop delay is no whole number of the preview's spacings, its
    samples become those of the physics step, so that what is known on the present grid is not lost
    between the samples of the shifted one; what is not known is filled in by its conditional mean.
    """
    shown = scenario.observation
    spacing = shown.preview_spacing
    if scenario.delay % spacing:
        spacing = 1
    preview = Sensing(
        preview=scenario.sensing.preview,
        preview_spacing=spacing * scenario.physics_step if shown.preview_samples else None,
    )
    uncertainty = replace(scenario.uncertainty, delay=None)
    return replace(scenario, sensing=preview, delay=0.0, uncertainty=uncertainty)


@dataclass(frozen=True)
class EstimateMemory:
    """What an `EstimatedState` knows of its tables from one period to the next; observation units."""

    table: FloatArray  # (..., n) the filter's estimate
    actions: FloatArray  # (..., commands + 1) own actions, oldest first
    ground: FloatArray  # (..., w) x_W as last shown
    reference: FloatArray  # (..., 2 stories) x~_S
    age: NDArray[np.intp]  # (...) periods since the episode's start
    inner: tuple[Any, ...] | None  # the law's own memory
    nonlinear: Any = None  # what a nonlinear filter knows


class EstimatedState:
    """A full-state law on measured signals, or on a delayed table: a `Controller`.

    Parameters
    ----------
    scenario
        What is shown: sensors or the full state, a preview, the last action. Where the last action is
        shown it is taken for what the table was given, so that the estimate stays right behind a
        supervisor that changes commands.
    law
        A controller designed on ``full_state(scenario)``.
    estimator
        The filter; None: that of the scenario (`KalmanFilter.from_model`) with the default `ModelError`.

    Raises
    ------
    ScenarioError
        If the equations are not the corrected ones.
    NumericalError
        If the filter's Riccati equation has no solution.
    """

    def __init__(
        self, scenario: Scenario, law: Controller, estimator: KalmanFilter | None = None
    ) -> None:
        if estimator is None:
            estimator = KalmanFilter.from_model(
                EstimatorModel.from_scenario(scenario, ModelError.from_scenario(scenario))
            )
        self.estimator = estimator
        self._prepare(scenario, law, estimator.model)

    def _prepare(self, scenario: Scenario, law: Controller, model: EstimatorModel) -> None:
        self.law, self._model = law, model
        self._shown = scenario.observation
        self._layout = scenario.plant.layout
        self.recursion = ReferenceRecursion.from_scenario(scenario)
        self.predicted_ground = predicted_ground(scenario, full_state(scenario))[0]

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the action (..., 1) for an observation (..., n), and ``(EstimateMemory,)``."""
        values = np.array(observation, dtype=float)  # parts of it are remembered
        memory = self._present(values, None if state is None else state[0], episode_start)
        believed = self._look_ahead(values, memory).astype(np.float32)
        action, inner = decide(self.law, believed, memory.inner, episode_start, deterministic)
        given = np.clip(np.asarray(action, dtype=float), -1.0, 1.0)
        actions = np.concatenate([memory.actions[..., 1:], given], axis=-1)
        return action, (replace(memory, actions=actions, inner=inner),)

    def _present(
        self,
        observation: FloatArray,
        last: EstimateMemory | None,
        episode_start: NDArray[np.bool_] | None,
    ) -> EstimateMemory:
        """Return what is known at this instant, this observation included; actions as before it."""
        model, lead, layout = self._model, observation.shape[:-1], self._layout
        ground = observation[..., layout.ground]
        full = self._shown.sensing.full_state
        readings = observation[..., layout.controlled if full else self._shown.readings]
        fresh = np.zeros(lead, dtype=bool)
        if last is None:
            fresh |= True
            reference, age, inner = np.zeros((*lead, 2 * layout.stories)), np.zeros(lead, np.intp), None
            actions = np.zeros((*lead, model.commands + 1))
        else:
            actions, inner = last.actions, last.inner
            if self._shown.sensing.last_action:
                shown = observation[..., self._shown.last_action]
                actions = np.concatenate([actions[..., :-1], shown], axis=-1)
            reference = self.recursion.advance(last.reference, last.ground, ground)
            age = last.age + 1
            if episode_start is not None:
                fresh |= np.reshape(np.asarray(episode_start, dtype=bool), lead)
                reference, actions = (
                    np.where(fresh[..., None], 0.0, part) for part in (reference, actions)
                )
                age = np.where(fresh, 0, age)
        table, nonlinear = self._estimate(last, actions, readings, age, fresh)
        if full:
            reference = observation[..., layout.reference]
        return EstimateMemory(table, actions, ground, reference, age, inner, nonlinear)

    def _estimate(
        self,
        last: EstimateMemory | None,
        actions: FloatArray,
        readings: FloatArray,
        age: NDArray[np.intp],
        fresh: NDArray[np.bool_],
    ) -> tuple[FloatArray, Any]:
        """Return the table's state (..., n), these readings included, and what else is remembered."""
        if last is None:
            table = np.zeros((*fresh.shape, self._model.order))
        else:
            table = np.where(fresh[..., None], 0.0, self.estimator.predict(last.table, actions))
        return self.estimator.correct(table, readings, age), None

    def _look_ahead(self, observation: FloatArray, memory: EstimateMemory) -> FloatArray:
        """Return the full-state observation (..., m) of the instant at which this action acts."""
        model, w = self._model, self._layout.filter_states
        preview = observation[..., self._shown.preview]
        known = np.concatenate([memory.ground, memory.reference, preview], axis=-1)
        exogenous = known @ self.predicted_ground.T
        under_way = np.concatenate([memory.table, memory.actions[..., 1:]], axis=-1)
        table = under_way @ model.ahead.T
        believed: FloatArray = np.concatenate([exogenous[..., :w], table, exogenous[..., w:]], axis=-1)
        return believed


def estimated(
    scenario: Scenario,
    make: Callable[[Scenario], Controller],
    error: ModelError | None = None,
    *,
    accommodate: float = 0.0,
) -> EstimatedState:
    """Return the controller that `make` designs on the full state, fed by an estimator.

    Parameters
    ----------
    scenario
        What the controller is shown.
    make
        Designs a full-state law: `baselines.lqr.sampled.lqr`, or any other.
    error
        What the filter believes of the model; None: `ModelError.from_scenario`.
    accommodate
        Share of the estimated disturbances that is taken out of what the law is shown: 0 none, 1 all.
        Against friction this helps a law that holds the table's place, and takes from one that does
        not what kept it there.
    """
    chosen = ModelError.from_scenario(scenario) if error is None else error
    estimator = KalmanFilter.from_model(
        EstimatorModel.from_scenario(scenario, chosen, accommodate=accommodate)
    )
    return EstimatedState(scenario, make(full_state(scenario)), estimator)


def lqg(scenario: Scenario, model_error: float = 0.02) -> EstimatedState:
    """Return the sampled LQR of a scenario's nominal model, fed by its Kalman filter.

    Parameters
    ----------
    scenario
        What the controller is shown.
    model_error
        [-] share of force and flow that the model is taken to miss, beside friction; see
        `ModelError.from_scenario`.
    """
    return estimated(scenario, lqr, ModelError.from_scenario(scenario, model_error))
