"""A trained SB3 policy to a `PolicyFile`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm

from agents.learning.apg.algorithm import AnalyticPolicyGradient
from agents.learning.distillation import Distillation
from agents.learning.features import LinearFeatures
from agents.learning.memory_policies import MemoryPolicy
from agents.learning.networks import DIRECT_GAIN, DirectActor, LSTMPolicy
from agents.learning.vec_env import ShakeTableVecEnv
from agents.policies.policy_file import PolicyFile
from agents.policies.recurrent_cells import DILATIONS, LongShortTermUnit, MemoryUnit
from shake_env.errors import PolicyFileError

_ACTIVATIONS = {torch.nn.Tanh: "tanh", torch.nn.ReLU: "relu"}


@dataclass(frozen=True)
class Actor:
    """Where the parts of a model's actor are that a policy file holds."""

    features: LinearFeatures
    linear: tuple[torch.nn.Linear, ...]
    activation: str
    output: str
    direct: int  # how many inputs of the last layer are what enters the first one

    def input_scale(self) -> list[NDArray[np.float32]]:
        """Return what multiplies each layer's inputs beside its weights, an array (inputs,) a layer."""
        sizes, count = _numpy(self.features.sizes), len(self.features.matrix)
        scale = [np.ones(layer.in_features, np.float32) for layer in self.linear]
        scale[0][:count] = sizes
        if self.direct:
            entering = scale[-1][-self.direct :]
            entering[:] = DIRECT_GAIN
            entering[:count] *= sizes
        return scale


def export_policy(model: BaseAlgorithm, env: ShakeTableVecEnv, card: dict[str, Any]) -> PolicyFile:
    """Return the deterministic policy of a model as a `PolicyFile`.

    Parameters
    ----------
    model
        With a policy over ``LinearFeatures``, as ``shake train`` makes it.
    env
        What it was trained on: the law that it corrects, and with what authority.
    card
        How it was made; must be JSON.

    Raises
    ------
    PolicyFileError
        If the policy has another architecture.
    """
    actor = actor_of(model)
    features, linear = actor.features, actor.linear
    # What multiplies the inputs goes into the weights, so that a file needs no word for it.
    columns = actor.input_scale()
    weights = (_numpy(layer.weight) * c for layer, c in zip(linear, columns, strict=True))
    return PolicyFile(
        matrix=_numpy(features.matrix),
        feature_clip=features.clip,
        weights=tuple(weights),
        biases=tuple(_numpy(layer.bias) for layer in linear),
        activation=actor.activation,
        output=actor.output,
        base=np.asarray(env.base, dtype=np.float32),
        authority=env.authority,
        card=card,
        direct=actor.direct > 0,
        memory=_memory(model, features),
        law=env.law,
    )


def actor_of(model: BaseAlgorithm) -> Actor:
    """Return the parts of a model's actor.

    Raises
    ------
    PolicyFileError
        If it has another architecture than ``shake train`` makes.
    """
    direct = 0
    hidden: Iterable[torch.nn.Module]
    if isinstance(model, PPO | RecurrentPPO | AnalyticPolicyGradient | Distillation):
        policy, output = model.policy, "clip"
        features, last = policy.pi_features_extractor, policy.action_net
        hidden = policy.mlp_extractor.policy_net
        if isinstance(policy.mlp_extractor, DirectActor):
            direct = policy.mlp_extractor.feature_dim
    elif isinstance(model, SAC | TQC):
        features, hidden = model.actor.features_extractor, model.actor.latent_pi
        last, output = model.actor.mu, "tanh"
    elif isinstance(model, TD3):
        layers = list(model.actor.mu)
        features, hidden = model.actor.features_extractor, layers[:-2]
        last, output = layers[-2], "tanh"  # its tanh is a module of its own, behind
    else:
        known = "PPO, RecurrentPPO, SAC, TD3, TQC, AnalyticPolicyGradient, Distillation"
        raise PolicyFileError("algorithm", type(model).__name__, f"known: {known}")
    if not isinstance(features, LinearFeatures):
        raise PolicyFileError(
            "features extractor", type(features).__name__, "only LinearFeatures can be exported"
        )
    linear = tuple(module for module in (*hidden, last) if isinstance(module, torch.nn.Linear))
    kinds = {type(module) for module in hidden} - {torch.nn.Linear}
    if len(kinds) != 1 or not kinds <= set(_ACTIVATIONS):
        raise PolicyFileError("activations", sorted(str(k) for k in kinds), "must all be Tanh or ReLU")
    return Actor(features, linear, _ACTIVATIONS[kinds.pop()], output, direct)


def memory_of(model: BaseAlgorithm) -> tuple[type[MemoryUnit], dict[str, torch.Tensor]] | None:
    """Return the kind of a model's memory, and its weights by their names in a file; None without one.

    What is put in these weights stays.
    """
    policy = model.policy
    if isinstance(policy, MemoryPolicy):
        return policy.kind, policy.memory_parts()
    if isinstance(policy, LSTMPolicy):
        lstm = dict(policy.lstm_actor.named_parameters())
        return LongShortTermUnit, {
            "input_weight": lstm["weight_ih_l0"], "hidden_weight": lstm["weight_hh_l0"],
            "input_bias": lstm["bias_ih_l0"], "hidden_bias": lstm["bias_hh_l0"],
        }  # fmt: skip
    return None


def _memory(model: BaseAlgorithm, features: LinearFeatures) -> MemoryUnit | None:
    found = memory_of(model)
    if found is None:
        return None
    kind, parts = found
    parts = {**parts, kind.entry: parts[kind.entry] * features.sizes}
    return kind.read(lambda name, axes: _numpy(parts[name]), DILATIONS)


def _numpy(tensor: torch.Tensor) -> NDArray[np.float32]:
    array: NDArray[np.float32] = tensor.detach().cpu().numpy().astype(np.float32, copy=True)
    return array
