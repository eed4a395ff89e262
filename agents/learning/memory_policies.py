"""SB3 actor-critic policies with a memory: recurrent, or convolutions over past features.

An unknown specimen shows in past responses, not in one observation. Both networks receive the memory
unit's output beside the features.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, cast

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.distributions import Distribution
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule

from agents.learning.networks import DirectActor, zero_init_skip
from agents.policies.recurrent_cells import DILATIONS, KERNEL, ConvolutionUnit, GatedUnit, MemoryUnit


class MemoryPolicy(ActorCriticPolicy):
    """Features, a memory unit over them, then a `DirectActor` over both.

    :meth:`predict` passes the unit's output as SB3's recurrent state. Methods that SB3 gives no state to
    (``forward``, ``evaluate_actions``, ``predict_values``) see a memory at rest, as an episode begins.

    Parameters
    ----------
    observation_space, action_space, lr_schedule
        As SB3's.
    units
        Width of the unit's output.
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

    kind: ClassVar[type[MemoryUnit]]  # the same unit in numpy
    lead = 0  # earlier control periods that an output depends on; 0: all

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "units": self.units}

    def _build_mlp_extractor(self) -> None:
        self._build_memory()
        self.mlp_extractor = DirectActor(
            self.features_dim + self.units,
            net_arch=self.net_arch,
            activation_fn=self.activation_fn,
            device=self.device,
        )

    def _build(self, lr_schedule: Schedule) -> None:
        super()._build(lr_schedule)
        zero_init_skip(self)

    @abstractmethod
    def _build_memory(self) -> None:
        """Make the memory unit, for `features_dim` inputs and `units` outputs."""

    @abstractmethod
    def memory_parts(self) -> dict[str, torch.Tensor]:
        """Return the unit's weights by their names in a policy file; what is put in them stays."""

    @property
    @abstractmethod
    def memory_width(self) -> int:
        """Numbers that the unit keeps between decisions."""

    @abstractmethod
    def remember(
        self, features: torch.Tensor, memory: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the unit's output (N, units) and new memory (N, memory) for features (N, f)."""

    def remember_sequence(
        self, features: torch.Tensor, memory: torch.Tensor, begun: torch.Tensor
    ) -> torch.Tensor:
        """Return the outputs (L, N, units) for features (L, N, f), at rest where `begun` (L, N)."""
        outputs = []
        for each, start in zip(features, begun, strict=True):
            output, memory = self.remember(each, torch.where(start[:, None], 0.0, memory))
            outputs.append(output)
        return torch.stack(outputs)

    def rest(self, lanes: int) -> torch.Tensor:
        """Return the memory (lanes, memory) at the start of an episode."""
        like = next(iter(self.memory_parts().values()))
        return torch.zeros((lanes, self.memory_width), dtype=like.dtype, device=self.device)

    def recall(
        self, observation: torch.Tensor, memory: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return what both networks see (N, features + units), and the new memory (N, memory)."""
        features = self.features_extractor(observation)
        output, memory = self.remember(features, memory)
        return torch.cat([features, output], dim=-1), memory

    def recall_sequence(
        self, observation: torch.Tensor, memory: torch.Tensor, begun: torch.Tensor
    ) -> torch.Tensor:
        """Return what both networks see (L, N, features + units) of observations (L, N, n)."""
        rows: torch.Tensor = self.features_extractor(observation.flatten(end_dim=1))
        features = rows.reshape(*observation.shape[:2], -1)
        output = self.remember_sequence(features, memory, begun)
        return torch.cat([features, output], dim=-1)

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


class GRUPolicy(MemoryPolicy):
    """A `MemoryPolicy` with a gated recurrent unit (Cho et al., 2014) of `units` units."""

    kind = GatedUnit

    def _build_memory(self) -> None:
        self.gru = torch.nn.GRUCell(self.features_dim, self.units, device=self.device)

    def memory_parts(self) -> dict[str, torch.Tensor]:
        """Return the unit's weights by their names in a policy file; what is put in them stays."""
        gru = self.gru
        return {
            "input_weight": gru.weight_ih, "hidden_weight": gru.weight_hh,
            "input_bias": gru.bias_ih, "hidden_bias": gru.bias_hh,
        }  # fmt: skip

    @property
    def memory_width(self) -> int:
        """Numbers that the unit keeps between decisions."""
        return self.units

    def remember(
        self, features: torch.Tensor, memory: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the unit's output (N, units) and new memory (N, memory) for features (N, f)."""
        memory = self.gru(features, memory)
        return memory, memory


class TCNPolicy(MemoryPolicy):
    """A `MemoryPolicy` with causal dilated convolutions of `units` channels (see `ConvolutionUnit`).

    Its memory (N, memory) is what each layer will still read, layer behind layer, the oldest first.
    """

    kind = ConvolutionUnit
    lead = (KERNEL - 1) * sum(DILATIONS)

    def _build_memory(self) -> None:
        widths = [self.features_dim, *[self.units] * (len(DILATIONS) - 1)]
        self.convolutions = torch.nn.ModuleList(
            torch.nn.Linear(KERNEL * width, self.units, device=self.device) for width in widths
        )
        self._kept = [(KERNEL - 1) * d * width for d, width in zip(DILATIONS, widths, strict=True)]

    @property
    def _layers(self) -> list[torch.nn.Linear]:
        return cast("list[torch.nn.Linear]", list(self.convolutions))

    def memory_parts(self) -> dict[str, torch.Tensor]:
        """Return the unit's weights by their names in a policy file; what is put in them stays."""
        parts: dict[str, torch.Tensor] = {}
        for i, layer in enumerate(self._layers):
            parts[f"conv_weight_{i}"] = layer.weight.view(self.units, KERNEL, -1)
            parts[f"conv_bias_{i}"] = layer.bias
        return parts

    @property
    def memory_width(self) -> int:
        """Numbers that the unit keeps between decisions."""
        return sum(self._kept)

    def remember(
        self, features: torch.Tensor, memory: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the unit's output (N, units) and new memory (N, memory) for features (N, f)."""
        output, memory = self._convolve(features[:, None], memory, None)
        return output[:, 0], memory

    def remember_sequence(
        self, features: torch.Tensor, memory: torch.Tensor, begun: torch.Tensor
    ) -> torch.Tensor:
        """Return the outputs (L, N, units) for features (L, N, f), at rest where `begun` (L, N).

        All control periods are convolved at once.
        """
        return self._convolve(features.transpose(0, 1), memory, begun.T)[0].transpose(0, 1)

    def _convolve(
        self, values: torch.Tensor, memory: torch.Tensor, begun: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return outputs (N, L, units) and the new memory for features (N, L, f); see `ConvolutionUnit`.

        What lies before an episode's start, where `begun` (N, L), counts as zero. The new memory is of
        use where none begins.
        """
        length = values.shape[1]
        episode = None if begun is None else begun.cumsum(dim=1)[..., None]  # 0: that of the memory
        kept = []
        pasts = torch.split(memory, self._kept, dim=-1)
        for number, (layer, d, past) in enumerate(zip(self._layers, DILATIONS, pasts, strict=True)):
            span, inputs = (KERNEL - 1) * d, values.shape[-1]
            known = torch.cat([past.view(-1, span, inputs), values], dim=1)
            read = [known[:, k * d : k * d + length] for k in range(KERNEL)]
            if episode is not None:
                old = torch.nn.functional.pad(episode, (0, 0, span, 0))
                read = [
                    torch.where(old[:, k * d : k * d + length] == episode, part, 0.0)
                    for k, part in enumerate(read)
                ]
            made = torch.relu(layer(torch.cat(read, dim=-1)))
            values = values + made if number else made
            kept.append(known[:, length:].flatten(start_dim=1))
        return values, torch.cat(kept, dim=-1)
