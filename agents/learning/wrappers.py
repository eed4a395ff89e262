"""Gymnasium wrappers for learners: tracking features, scaled rewards and actions."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from agents.learning.features import FeatureMap
from agents.learning.training_scenario import GAMMA, checked_action_scale, reward_scale

Observation = NDArray[np.float32]


class TrackingFeatures(
    gymnasium.ObservationWrapper[Observation, Observation, Observation],
    gymnasium.utils.RecordConstructorArgs,
):
    """Observations as `shake train` shows them to its networks: errors rather than states, bounded.

    The map is `agents.learning.features.feature_matrix`; a small difference of two large states, which
    is what tracking is about, becomes an entry of its own. Usable by name from rl-zoo3's hyperparameter
    files: ``env_wrapper: agents.learning.wrappers.TrackingFeatures``.

    Parameters
    ----------
    env
        A ``ShakeTable`` environment, one in `PlanWrapper`, or one wrapped without changing its
        observations.
    """

    def __init__(self, env: gymnasium.Env[Observation, Observation]) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        gymnasium.ObservationWrapper.__init__(self, env)
        plan = env.get_wrapper_attr("plan") if env.has_wrapper_attr("plan") else None
        planned = 0 if plan is None else plan.shown
        self._features = FeatureMap(env.get_wrapper_attr("scenario"), planned=planned)
        self.observation_space = self._features.space

    def observation(self, observation: Observation) -> Observation:
        """Return the features (features,) of an observation (n,)."""
        return self._features(observation)


class TrainingWrapper(TrackingFeatures):
    """Tracking features, scaled rewards and scaled actions: one lane of `make_sb3_env`.

    Parameters
    ----------
    env
        A ``ShakeTable`` environment; its ``scenario`` argument is best what
        `agents.learning.training_scenario.make_training_scenario` returns, so that an episode without
        hope ends early.
    gamma
        Discount that the algorithm is given [-]; it sets the scale of the rewards.
    action_scale
        Valve current of action 1, as a fraction of the current limit.

    Raises
    ------
    ParameterError
        If `gamma` or `action_scale` is outside its range.
    """

    def __init__(
        self,
        env: gymnasium.Env[Observation, Observation],
        *,
        gamma: float = GAMMA,
        action_scale: float = 1.0,
    ) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self, gamma=gamma, action_scale=action_scale)
        super().__init__(env)
        self.action_scale = checked_action_scale(action_scale)
        self.reward_scale = reward_scale(env.get_wrapper_attr("scenario"), gamma)

    def step(self, action: Observation) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold `action` (1,) times the scale for one control period; the reward is scaled."""
        scaled = np.multiply(self.action_scale, action)
        observation, reward, terminated, truncated, info = super().step(scaled)
        return observation, self.reward_scale * float(reward), terminated, truncated, info
