"""What a network sees of the observation: the states that matter, bounded."""

from __future__ import annotations

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from baselines.lqr import observable_states
from shake_env.parameters import FloatArray
from shake_env.plant import LOAD_PRESSURE, SPOOL_POSITION, TABLE_VELOCITY
from shake_env.scenario import Scenario


def feature_matrix(scenario: Scenario) -> FloatArray:
    """Return the fixed linear map (features, n) from observation to network input.

    An invertible map of the observable states, so that no information is added or lost, into
    coordinates in which what a controller has to act on is not a small difference of large numbers:
    the position, which drifts and feeds nothing, is left out; the load pressure becomes the
    acceleration error y_A - y~, the spool position the flow that goes into compressing the oil,
    ``x_v - A_p v_a / K_q``, and the specimen's states their difference from the reference's. Each is
    divided by the share of what it is an error in (`ERROR_SHARE`, `FLOW_SHARE`), so that it is of the
    order of 1.
    """
    plant, layout, scale = scenario.plant, scenario.plant.layout, scenario.plant.state_scale
    pressure, spool = layout.actuator.start + LOAD_PRESSURE, layout.actuator.start + SPOOL_POSITION
    velocity = layout.actuator.start + TABLE_VELOCITY
    matrix = np.eye(layout.order)
    error = (plant.coupled.C[0] - plant.coupled.C[2]) * scale
    matrix[pressure] = error / (ERROR_SHARE * np.sqrt(plant.target_variance))
    matrix[spool, spool] = 1.0 / FLOW_SHARE
    actuator = plant.actuator
    follows = actuator.piston_area / actuator.flow_gain * scale[velocity] / scale[spool]
    matrix[spool, velocity] = -follows / FLOW_SHARE
    matrix[layout.specimen, layout.specimen] /= ERROR_SHARE
    matrix[layout.specimen, layout.reference] = -np.eye(2 * layout.stories) / ERROR_SHARE
    return matrix[observable_states(plant)]


ERROR_SHARE = 0.3  # errors of a table under control are of the order of 10 to 40 % of the target
FLOW_SHARE = 0.03  # the oil is stiff: of the flow through the valve a few percent compress it


class LinearFeatures(BaseFeaturesExtractor):
    """A fixed linear map of the observation, clipped to ``+-clip``.

    Parameters
    ----------
    observation_space
        The environment's.
    matrix
        (features, n) what :func:`feature_matrix` returned.
    clip
        Bound of a feature; far outside what a working controller meets.
    """

    def __init__(
        self, observation_space: spaces.Box, matrix: list[list[float]], clip: float = 20.0
    ) -> None:
        rows: NDArray[np.float32] = np.asarray(matrix, dtype=np.float32)
        super().__init__(observation_space, features_dim=len(rows))
        self.clip = clip
        self.matrix: torch.Tensor
        self.register_buffer("matrix", torch.from_numpy(rows))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features (batch, features)."""
        return torch.clamp(observations @ self.matrix.T, -self.clip, self.clip)
