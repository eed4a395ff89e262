"""A trained SB3 policy to a `PolicyFile`."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm

from agents.analytic_gradient import AnalyticPolicyGradient
from agents.direct import DIRECT_GAIN, DirectActor
from agents.features import LinearFeatures
from agents.long_short_term import LSTMPolicy
from agents.memory_units import GatedUnit, LongShortTermUnit, MemoryUnit
from agents.policy_file import PolicyFile
from agents.recurrent import GRUPolicy
from agents.sb3_vec_env import ShakeTableVecEnv
from shake_env.errors import PolicyFileError

_ACTIVATIONS = {torch.nn.Tanh: "tanh", torch.nn.ReLU: "relu"}


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
    if isinstance(model, PPO | RecurrentPPO | AnalyticPolicyGradient):
        features, hidden = model.policy.pi_features_extractor, model.policy.mlp_extractor.policy_net
        last, output = model.policy.action_net, "clip"
    elif isinstance(model, SAC | TQC):
        features, hidden = model.actor.features_extractor, model.actor.latent_pi
        last, output = model.actor.mu, "tanh"
    elif isinstance(model, TD3):
        features, hidden = model.actor.features_extractor, model.actor.mu[:-2]
        last, output = model.actor.mu[-2], "tanh"  # its tanh is a module of its own, behind
    else:
        known = "PPO, RecurrentPPO, SAC, TD3, TQC, AnalyticPolicyGradient"
        raise PolicyFileError("algorithm", type(model).__name__, f"known: {known}")
    if not isinstance(features, LinearFeatures):
        raise PolicyFileError(
            "features extractor", type(features).__name__, "only LinearFeatures can be exported"
        )
    memory, direct = None, False
    if isinstance(model, PPO | RecurrentPPO | AnalyticPolicyGradient):
        direct = isinstance(model.policy.mlp_extractor, DirectActor)
        memory = _memory(model.policy, features)
    linear = [module for module in (*hidden, last) if isinstance(module, torch.nn.Linear)]
    kinds = {type(module) for module in hidden} - {torch.nn.Linear}
    if len(kinds) != 1 or not kinds <= set(_ACTIVATIONS):
        raise PolicyFileError("activations", sorted(str(k) for k in kinds), "must all be Tanh or ReLU")
    weights = [_numpy(layer.weight) for layer in linear]
    # Sizes of features go into the weights that read them, so that a file needs no word for them.
    sizes, count = _numpy(features.sizes), len(features.matrix)
    weights[0][:, :count] *= sizes
    if direct:
        entering = model.policy.mlp_extractor.feature_dim
        weights[-1][:, -entering:] *= np.float32(DIRECT_GAIN)
        first = weights[-1].shape[1] - entering
        weights[-1][:, first : first + count] *= sizes
    return PolicyFile(
        matrix=_numpy(features.matrix),
        feature_clip=features.clip,
        weights=tuple(weights),
        biases=tuple(_numpy(layer.bias) for layer in linear),
        activation=_ACTIVATIONS[kinds.pop()],
        output=output,
        base=np.asarray(env.base, dtype=np.float32),
        authority=env.authority,
        card=card,
        direct=direct,
        memory=memory,
        law=env.law,
    )


def _memory(policy: Any, features: LinearFeatures) -> MemoryUnit | None:
    if isinstance(policy, GRUPolicy):
        gru = policy.gru
        return GatedUnit(
            _numpy(gru.weight_ih * features.sizes),
            *(_numpy(part) for part in (gru.weight_hh, gru.bias_ih, gru.bias_hh)),
        )
    if isinstance(policy, LSTMPolicy):
        lstm = policy.lstm_actor
        return LongShortTermUnit(
            _numpy(lstm.weight_ih_l0 * features.sizes),
            *(_numpy(part) for part in (lstm.weight_hh_l0, lstm.bias_ih_l0, lstm.bias_hh_l0)),
        )
    return None


def _numpy(tensor: torch.Tensor) -> NDArray[np.float32]:
    array: NDArray[np.float32] = tensor.detach().cpu().numpy().astype(np.float32, copy=True)
    return array
