"""sb3-contrib's recurrent policy, with the features beside the memory's output."""

from __future__ import annotations

from typing import Any

import torch
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from stable_baselines3.common.torch_layers import MlpExtractor

States = tuple[torch.Tensor, torch.Tensor]


class LSTMPolicy(RecurrentActorCriticPolicy):
    """Long short-term memories over the features; actor and critic see features and output.

    What needs no memory passes by it, as in `recurrent.GRUPolicy`. In sb3-contrib's own policy the
    networks see the memory alone, and a law of the state has to be learned through its gates.
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
            output, lstm_states = RecurrentActorCriticPolicy._process_sequence(
                features, lstm_states, episode_starts, lstm
            )
            return torch.cat([features, output], dim=-1), lstm_states
        keep = (1.0 - starts[:, 0]).view(1, lanes, 1)
        rows = features.reshape(lanes, -1, lstm.input_size).swapaxes(0, 1)
        output, lstm_states = lstm(rows, (keep * lstm_states[0], keep * lstm_states[1]))
        output = output.transpose(0, 1).flatten(end_dim=1)
        return torch.cat([features, output], dim=-1), lstm_states
