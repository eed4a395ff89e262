"""An SB3 actor-critic policy with a memory: a gated recurrent unit over the features.

An unknown specimen shows in past responses, not in one observation. Both networks receive the unit's
output beside the features.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from stable_baselines3.common.distributions import Distribution
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import MlpExtractor
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule


class GRUPolicy(ActorCriticPolicy):
    """Features, a gated recurrent unit (Cho et al., 2014) over them, then a `DirectActor` over both.

    :meth:`predict` passes the unit's output as SB3's recurrent state. Methods that SB3 gives no state to
    (``forward``, ``evaluate_actions``, ``predict_values``) see a memory at rest, as an episode begins.

    Parameters
    ----------
    observation_space, action_space, lr_schedule
        As SB3's.
    units
        Width of the memory.
    policy
        Further options of `ActorCriticPolicy`; its features extractor is shared.
    """

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        lr_schedule: Schedule,
        units: int = 64,
        **policy: Any,
    ) -> None:
        self.units = units
        super().__init__(observation_space, action_space, lr_schedule, **policy)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "units": self.units}

    def _build_mlp_extractor(self) -> None:
        self.gru = torch.nn.GRUCell(self.features_dim, self.units, device=self.device)
        self.mlp_extractor = DirectActor(
            self.features_dim + self.units,
            net_arch=self.net_arch,
            activation_fn=self.activation_fn,
            device=self.device,
        )

    def _build(self, lr_schedule: Schedule) -> None:
        super()._build(lr_schedule)
        zero_init_skip(self)

    def rest(self, lanes: int) -> torch.Tensor:
        """Return the memory (lanes, units) at the start of an episode."""
        return torch.zeros((lanes, self.units), dtype=self.gru.weight_hh.dtype, device=self.device)

    def recall(
        self, observation: torch.Tensor, memory: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return what both networks see (N, features + units), and the new memory (N, units)."""
        features = self.features_extractor(observation)
        memory = self.gru(features, memory)
        return torch.cat([features, memory], dim=-1), memory

    def extract_features(self, obs: PyTorchObs, features_extractor: Any = None) -> torch.Tensor:
        """Return what the networks see at the start of an episode, (N, features + units)."""
        assert isinstance(obs, torch.Tensor)  # a table's observation is no dictionary
        return self.recall(obs, self.rest(len(obs)))[0]

    def get_distribution(self, obs: PyTorchObs) -> Distribution:
        """Return the distribution of actions at the start of an episode."""
        latent = self.mlp_extractor.forward_actor(self.extract_features(obs))
        return self._get_action_dist_from_latent(latent)

    def predict_values(self, obs: PyTorchObs) -> torch.Tensor:
        """Return the values (N, 1) at the start of an episode."""
        latent: torch.Tensor = self.value_net(
            self.mlp_extractor.forward_critic(self.extract_features(obs))
        )
        return latent

    def predict(  # type: ignore[override]
        self,
        observation: NDArray[np.float32],
        state: tuple[NDArray[np.float32], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[np.float32], ...]]:
        """Return the action for an observation (n,) or (N, n), and the memory in a tuple."""
        self.set_training_mode(False)
        rows, vectorized = self.obs_to_tensor(observation)
        assert isinstance(rows, torch.Tensor)
        memory = self.rest(len(rows))
        if state is not None:
            memory = torch.as_tensor(np.reshape(state[0], memory.shape)).to(memory)
            if episode_start is not None:
                begun = torch.as_tensor(np.reshape(episode_start, (-1, 1)), device=self.device)
                memory = torch.where(begun, 0.0, memory)
        with torch.no_grad():
            latent_input, memory = self.recall(rows, memory)
            latent = self.mlp_extractor.forward_actor(latent_input)
            actions = self._get_action_dist_from_latent(latent).get_actions(deterministic=deterministic)
        assert isinstance(self.action_space, spaces.Box)
        clipped = np.clip(actions.cpu().numpy(), self.action_space.low, self.action_space.high)
        hidden = memory.cpu().numpy()
        return (clipped, (hidden,)) if vectorized else (clipped[0], (hidden[0],))


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
