"""Shake tables for a Stable-Baselines3 script of one's own, and the trained model beside LQR."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Unpack, cast

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from agents.learning.features import FeatureMap
from agents.learning.training_scenario import (
    EPISODE,
    GAMMA,
    STATE_LIMIT,
    checked_action_scale,
    find_scenario,
    horizon_of,
    make_training_scenario,
    reward_scale,
)
from agents.learning.vec_env import ShakeTableVecEnv
from agents.policies.base_law import base_law
from agents.policies.base_names import BaseLaw
from agents.policies.estimated_law import EstimatedLaw
from agents.policies.plan_law import PLANNERS, PlanLaw, Planner, PlanOptions
from agents.seeds import COMPARISON_SEED
from baselines.registry import make_baseline, reference_name
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.parameters import FloatArray
from shake_env.rollout import Earthquake, noise_earthquakes, rollout
from shake_env.scenario.overrides import Overrides, make_scenario
from shake_env.scenario.scenario import Scenario

BaseController = BaseLaw | Planner | PlanOptions


def _base(
    base: BaseController, scenario: Scenario, earthquakes: Sequence[Earthquake] | None = None
) -> FloatArray | EstimatedLaw | PlanLaw:
    """Return the law that actions correct; a planner's name alone is a plan that they correct."""
    if isinstance(base, PlanOptions):
        return PlanLaw.from_options(scenario, base, earthquakes)
    for planner in PLANNERS:
        if base == planner:
            return _base(PlanOptions(planner=planner, corrected=True), scenario, earthquakes)
    return base_law(cast(BaseLaw, base), scenario)


class VecTrackingFeatures(VecEnvWrapper):
    """Observations of a `VecEnv` as tracking errors; see ``agents.learning.wrappers.TrackingFeatures``.

    Parameters
    ----------
    venv
        Shake tables with their own observations.
    scenario
        What they simulate.
    believed
        Whether they show an estimator's beliefs behind the observation.
    planned
        Number of entries of a plan that they show behind it.
    """

    def __init__(
        self, venv: VecEnv, scenario: Scenario, believed: bool = False, planned: int = 0
    ) -> None:
        self.features = FeatureMap(scenario, believed, planned)
        super().__init__(venv, self.features.space)

    def reset(self) -> NDArray[np.float32]:
        """Start an episode in every lane; return the features (N, features)."""
        observation: Any = self.venv.reset()
        return self.features(observation)

    def step_wait(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Advance all tables; ``terminal_observation`` in an info becomes features, too."""
        observation: Any
        observation, reward, done, infos = self.venv.step_wait()
        for lane in np.flatnonzero(done):
            info = infos[lane]
            info["terminal_observation"] = self.features(info["terminal_observation"])
        return self.features(observation), reward, done, infos


def make_sb3_env(  # type: ignore[misc]  # `duration` is the episode's, and no override here
    scenario: str | os.PathLike[str] | Scenario = "linear",
    num_envs: int = 64,
    *,
    gamma: float = GAMMA,
    action_scale: float = 1.0,
    base_controller: BaseController = "none",
    duration: float | None = EPISODE,
    state_limit: float = STATE_LIMIT,
    **overrides: Unpack[Overrides],
) -> VecTrackingFeatures:
    """Return N shake tables as one SB3 `VecEnv` that plain PPO can learn on.

    Observations are tracking errors of the order of 1 (`agents.learning.features.feature_matrix`),
    rewards are multiplied by :func:`agents.learning.training_scenario.reward_scale`, and a diverging
    episode ends early (:func:`agents.learning.training_scenario.make_training_scenario`). The
    ``episode`` record in an info, which SB3 logs as ``ep_rew_mean``, keeps the true return. Lane i of
    ``seed(s)`` repeats ``agents.learning.wrappers.TrainingWrapper`` of an environment with
    ``reset(seed=s + i)``.

    Parameters
    ----------
    scenario
        Name, Gymnasium id or scenario.
    num_envs
        Number of tables N.
    gamma
        Discount that the algorithm is given [-]; it sets the scale of the rewards.
    action_scale
        Valve current of action 1, as a fraction of the current limit.
    base_controller
        Controller that the actions correct (`agents.policies.base_law.base_law`). What one behind an
        estimator believes of the table is shown as well. ``"nmpc"`` and ``"planned"`` run a planner
        beside each table, whose plan is shown; `PlanOptions` say which periods, and whether actions
        correct it.
    duration
        Duration of an episode of filtered noise [s]; None: the scenario's own.
    state_limit
        Where an episode ends in a scenario without limits [multiples of a state's rms].
    **overrides
        As for ``gymnasium.make("shake_env:ShakeTable-v0", ...)``.

    Raises
    ------
    ScenarioError, ParameterError
        If the scenario is unknown, a number is outside its range, or a planner does not suit.
    """
    if not isinstance(num_envs, int | np.integer) or num_envs < 1:
        raise ParameterError("num_envs", num_envs, "must be a whole number of at least 1")
    made = make_scenario(find_scenario(scenario), cast(Overrides, overrides))
    horizon = horizon_of(gamma, made.control_period)
    training = make_training_scenario(made, horizon=horizon, duration=duration, state_limit=state_limit)
    tables = ShakeTableVecEnv(
        training,
        int(num_envs),
        base=_base(base_controller, made),
        authority=checked_action_scale(action_scale),
        reward_scale=reward_scale(training, gamma),
    )
    planned = 0 if tables.plan is None else tables.plan.shown
    return VecTrackingFeatures(tables, made, tables.law is not None, planned)


class PredictsLikeSB3(Protocol):
    """What an SB3 model offers; PPO, SAC and RecurrentPPO are such models."""

    def predict(
        self,
        observation: Any,
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[Any], tuple[NDArray[Any], ...] | None]:
        """Return actions (N, 1) for observations (N, n), and the memory."""


class SB3Controller:
    """An SB3 model as a controller of the bare environment, with the law that it corrects.

    Parameters
    ----------
    model
        Trained on `make_sb3_env`, or on an environment in ``agents.learning.wrappers.TrainingWrapper``.
    scenario
        What it drives; its motion may differ from training's.
    action_scale, base_controller
        As in training.
    earthquakes
        Of a roll-out on which `planned` plans, one a lane; None: the scenario's own recorded motion.
    features
        False: the model was trained on observations as they are, such as `PlanWrapper`'s.

    Raises
    ------
    ScenarioError
        If the model was trained on observations of another size.
    """

    def __init__(
        self,
        model: PredictsLikeSB3,
        scenario: str | os.PathLike[str] | Scenario = "linear",
        *,
        action_scale: float = 1.0,
        base_controller: BaseController = "none",
        earthquakes: Sequence[Earthquake] | None = None,
        features: bool = True,
    ) -> None:
        self.model = model
        self.action_scale = checked_action_scale(action_scale)
        made = make_scenario(find_scenario(scenario))
        base = _base(base_controller, made, earthquakes)
        self._law = None if isinstance(base, np.ndarray) else base
        self._row = base if isinstance(base, np.ndarray) else None
        planned = base.shown if isinstance(base, PlanLaw) else 0
        map_ = FeatureMap(made, isinstance(base, EstimatedLaw), planned)
        self._features = map_ if features else None
        entries = made.observation.size + (0 if self._law is None else self._law.shown)
        space = getattr(model, "observation_space", None)
        expected = (entries,) if self._features is None else self._features.space.shape
        if space is not None and space.shape != expected:
            raise ScenarioError(
                "observation of the model",
                space.shape,
                f"the features of this scenario are {expected}: train on make_sb3_env or on "
                "agents.learning.wrappers.TrainingWrapper of the same scenario",
            )

    def predict(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Return actions (..., 1) for observations (..., n) of the bare environment, and the memory."""
        observation = np.asarray(observation, dtype=np.float32)
        own = state
        if self._law is not None:
            own, past = (None, None) if state is None else (state[:-2] or None, state[-2:])
            age, known, shown = self._law.show_to(observation, past, episode_start)
            observation = np.concatenate([observation, shown.astype(np.float32)], axis=-1)
        seen = observation if self._features is None else self._features(observation)
        correction, own = self.model.predict(seen, own, episode_start, deterministic)
        base = self._own_action(observation)
        action = np.clip(base + self.action_scale * correction, -1.0, 1.0)
        if self._law is None:
            return action.astype(np.float32), own
        law_memory = self._law.keep(known, action[..., 0].astype(float))
        return action.astype(np.float32), (*(own or ()), law_memory, age + 1)

    def _own_action(self, observation: NDArray[np.float32]) -> NDArray[np.floating[Any]]:
        """Return the base controller's own action (..., 1) of what is shown."""
        if self._row is not None:
            return (observation @ self._row)[..., None]
        if isinstance(self._law, PlanLaw):  # first of what it shows
            place = -self._law.shown
            return observation[..., place : place + 1] * np.float32(self._law.corrected)
        return observation[..., -1:]


@dataclass(frozen=True)
class CostComparison:
    """Mean stage costs of a controller and of the scenario's reference on the same earthquakes."""

    cost: float  # [-]
    reference_cost: float  # [-]
    reference: str  # its name: "lqr" where the full state is observed
    broken_limits: int  # episodes of the controller that a limit ended

    @property
    def ratio(self) -> float:
        """Cost relative to the reference's [-]; 1 is LQR."""
        return self.cost / self.reference_cost

    def __str__(self) -> str:
        """Return one line of text."""
        return (
            f"cost {self.cost:.4f}, {self.reference} {self.reference_cost:.4f}: ratio {self.ratio:.3f}, "
            f"{self.broken_limits} episodes ended by a limit"
        )


def compare_with_reference(
    model: PredictsLikeSB3,
    scenario: str | os.PathLike[str] | Scenario = "linear",
    *,
    action_scale: float = 1.0,
    base_controller: BaseController = "none",
    earthquakes: int = 32,
    seed: int = COMPARISON_SEED,
    **overrides: Unpack[Overrides],
) -> CostComparison:
    """Return the cost of a trained SB3 model beside that of the scenario's reference, LQR in ``linear``.

    Both run the same filtered-noise earthquakes with the scenario's own limits and duration, without
    exploration.

    Parameters
    ----------
    model
        Trained on `make_sb3_env`, or on an environment in ``agents.learning.wrappers.TrainingWrapper``.
    scenario, overrides
        What both drive, as for :func:`make_sb3_env`.
    action_scale, base_controller
        As in training.
    earthquakes
        Number of earthquakes.
    seed
        Of the first; the others follow.
    """
    made = make_scenario(find_scenario(scenario), overrides)
    motions = noise_earthquakes(made, earthquakes, seed)
    name = reference_name(made)
    controller = SB3Controller(
        model,
        made,
        action_scale=action_scale,
        base_controller=base_controller,
        earthquakes=motions,
    )
    rows, _ = rollout(controller, made, motions)
    reference, _ = rollout(make_baseline(name, made), made, motions)
    return CostComparison(
        cost=float(np.mean([row.cost for row in rows])),
        reference_cost=float(np.mean([row.cost for row in reference])),
        reference=name,
        broken_limits=sum(row.broken_limit is not None for row in rows),
    )
