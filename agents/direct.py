"""A linear path from the features to the action beside an actor's network."""

from __future__ import annotations

from typing import Any

import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import MlpExtractor
from stable_baselines3.common.type_aliases import Schedule

# Adam moves every weight alike; few weights read a feature directly, thousands through the network.
DIRECT_GAIN = 10.0


class DirectActor(MlpExtractor):
    """SB3's two networks, with what the actor sees beside its last hidden layer.

    The actor is then a linear law plus a network. The best law of a table is nearly linear, its gain
    bounded by stability in one direction of the state and with far to go in others. Gradients through
    the plant find it along this path several times sooner than through layers of rectifiers.
    """

    def __init__(self, feature_dim: int, **options: Any) -> None:
        super().__init__(feature_dim, **options)
        self.feature_dim = feature_dim
        self.latent_dim_pi += feature_dim

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """Return what the action is a linear function of, (batch, hidden + features)."""
        return torch.cat([super().forward_actor(features), DIRECT_GAIN * features], dim=-1)


class DirectPolicy(ActorCriticPolicy):
    """SB3's actor-critic policy with a `DirectActor`."""

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = DirectActor(
            self.features_dim,
            net_arch=self.net_arch,
            activation_fn=self.activation_fn,
            device=self.device,
        )

    def _build(self, lr_schedule: Schedule) -> None:
        super()._build(lr_schedule)
        begin_still(self)


def begin_still(policy: ActorCriticPolicy) -> None:
    """Let the direct path begin at zero: a random law moves the table, a fresh network hardly does."""
    assert isinstance(policy.mlp_extractor, DirectActor)
    with torch.no_grad():
        policy.action_net.weight[:, -policy.mlp_extractor.feature_dim :] = 0.0
