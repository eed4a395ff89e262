"""What a network should see, as a Gymnasium wrapper: for learners that take plain environments."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from agents.features import CLIP, feature_matrix, feature_sizes

Observation = NDArray[np.float32]


class TrackingFeatures(
    gymnasium.ObservationWrapper[Observation, Observation, Observation],
    gymnasium.utils.RecordConstructorArgs,
):
    """Observations as `shake train` shows them to its networks: errors rather than states, bounded.

    The map is `agents.features.feature_matrix`; a small difference of two large states, which is what
    tracking is about, becomes an entry of its own. Usable by name from rl-zoo3's hyperparameter files:
    ``env_wrapper: agents.wrappers.TrackingFeatures``.

    Parameters
    ----------
    env
        A ``ShakeTable`` environment, or one wrapped without changing its observations.
    """

    def __init__(self, env: gymnasium.Env[Observation, Observation]) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        gymnasium.ObservationWrapper.__init__(self, env)
        scenario: Any = env.get_wrapper_attr("scenario")
        self._matrix = feature_matrix(scenario).astype(np.float32)
        self._sizes = feature_sizes(scenario).astype(np.float32)
        bound = CLIP * self._sizes
        self.observation_space = spaces.Box(-bound, bound, dtype=np.float32)

    def observation(self, observation: Observation) -> Observation:
        """Return the features (features,) of an observation (n,)."""
        features: Observation = np.clip(self._matrix @ observation, -CLIP, CLIP) * self._sizes
        return features
