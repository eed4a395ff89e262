"""Networks of SB3 policies: a direct path beside the actor's, no biases, a long short-term memory."""

from __future__ import annotations

from typing import Any

import torch
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
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
        zero_init_skip(self)


def zero_init_skip(policy: ActorCriticPolicy) -> None:
    """Initialise the direct path at zero: a random law drives the table, a new network hardly."""
    assert isinstance(policy.mlp_extractor, DirectActor)
    assert isinstance(policy.action_net, torch.nn.Linear)  # as for any Gaussian action
    with torch.no_grad():
        policy.action_net.weight[:, -policy.mlp_extractor.feature_dim :] = 0.0


States = tuple[torch.Tensor, torch.Tensor]


class LSTMPolicy(RecurrentActorCriticPolicy):
    """Long short-term memories over the features; actor and critic see features and output.

    As in `GRUPolicy`, both receive the features, too. In sb3-contrib's own policy the networks see the
    memory alone, and a law of the state has to be learned through its gates.
    """

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = MlpExtractor(
            self.features_dim + self.lstm_output_dim,
            net_arch=self.net_arch,
            activation_fn=self.activation_fn,
            device=self.device,
        )

    @staticmethod
    def _process_sequence(
        features: torch.Tensor, lstm_states: States, episode_starts: torch.Tensor, lstm: torch.nn.LSTM
    ) -> tuple[torch.Tensor, Any]:
        """Return features and output (batch, features + units), and the states after the sequences.

        sb3-contrib's buffer cuts sequences at each start of an episode. A start is therefore always a
        sequence's first row, and one call of the LSTM does what otherwise is a loop over its rows.
        """
        lanes = lstm_states[0].shape[1]
        starts = episode_starts.reshape(lanes, -1)
        if torch.any(starts[:, 1:]):
            output, states = RecurrentActorCriticPolicy._process_sequence(
                features, lstm_states, episode_starts, lstm
            )
            return torch.cat([features, output], dim=-1), states
        keep = (1.0 - starts[:, 0]).view(1, lanes, 1)
        rows = features.reshape(lanes, -1, lstm.input_size).swapaxes(0, 1)
        output, lstm_states = lstm(rows, (keep * lstm_states[0], keep * lstm_states[1]))
        output = output.transpose(0, 1).flatten(end_dim=1)
        return torch.cat([features, output], dim=-1), lstm_states


def _without_biases(policy: ActorCriticPolicy) -> None:
    for layer in (*policy.mlp_extractor.policy_net, policy.action_net):
        if isinstance(layer, torch.nn.Linear):
            torch.nn.init.zeros_(layer.bias)
            layer.bias.requires_grad_(False)


class ScaleFreePolicy(ActorCriticPolicy):
    """SB3's actor-critic policy with an actor that has no biases.

    Rectifiers without biases make a positively homogeneous function: a motion of a tenth of the size
    gets a tenth of the current, and the relative cost of a linear plant is the same at any amplitude.
    With biases, a policy trained at unit intensity drifts away under a weak record.
    """

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        _without_biases(self)


class ScaleFreeDirectPolicy(DirectPolicy):
    """A `DirectPolicy` whose actor has no biases, as `ScaleFreePolicy`'s."""

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        _without_biases(self)
