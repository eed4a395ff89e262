"""One decision of a shipped policy in numpy beside the same network in SB3's own ``predict``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from agents.learning.networks import DIRECT_GAIN
from agents.learning.vec_env import ShakeTableVecEnv
from agents.policies.base_law import base_law
from agents.policies.policy_file import PolicyFile, load_policy
from agents.policies.registry import shipped_policy
from agents.training.config import config_of
from agents.training.model_factory import new_model
from benchmarks.timing import seconds_each

SHIPPED = {
    "linear, 64 x 64": ("apg", "linear"),
    "linear, 128 x 128, one and its mirror image": ("ppo", "linear"),
    "laboratory, behind an estimator": ("apg", "laboratory"),
    "unknown-specimen, estimator and memory": ("apg", "unknown-specimen"),
}
PERIODS = 50  # of the table from which observations are taken
# Single precision, and features of up to 20 through weights of order 1: 1e-7 of sums of some tens.
TOLERANCE = 1e-6


def sb3_model(policy: PolicyFile) -> tuple[Any, ShakeTableVecEnv]:
    """Return an SB3 model that holds a policy file's weights, and a table that it drives.

    The inverse of `export_policy`: sizes of features and the direct path's gain leave the weights.
    """
    config = config_of(policy.card["config"])
    # SB3 warns of minibatches that a single table's roll-out does not fill; none is taken here. A file's
    # layers are wider than its run's where it is averaged with its mirror image.
    ppo = replace(config.ppo, batch_size=config.ppo.n_steps)
    config = replace(config, ppo=ppo, net_arch=tuple(len(bias) for bias in policy.biases[:-1]))
    scenario = config.scenario.build()
    if policy.observation_size != scenario.observation.size:  # trained on one sample a control period
        sensing = replace(scenario.sensing, preview_spacing=scenario.control_period)
        scenario = replace(scenario, sensing=sensing)
    env = ShakeTableVecEnv(
        scenario,
        1,
        base=policy.law if policy.law is not None else base_law(config.chosen.base_controller, scenario),
        authority=policy.authority,
    )
    model = new_model(config, scenario, env)
    features, hidden = model.policy.pi_features_extractor, model.policy.mlp_extractor.policy_net
    sizes, count = features.sizes, len(features.matrix)
    layers = [m for m in (*hidden, model.policy.action_net) if isinstance(m, torch.nn.Linear)]
    with torch.no_grad():
        features.matrix.copy_(torch.from_numpy(policy.matrix))
        for layer, weight, bias in zip(layers, policy.weights, policy.biases, strict=True):
            layer.weight.copy_(torch.from_numpy(weight))
            layer.bias.copy_(torch.from_numpy(bias))
        layers[0].weight[:, :count] /= sizes
        if policy.direct:
            first = layers[-1].weight.shape[1] - model.policy.mlp_extractor.feature_dim
            layers[-1].weight[:, first:] /= DIRECT_GAIN
            layers[-1].weight[:, first : first + count] /= sizes
        if policy.memory is not None:
            tensors = model.policy.memory_parts()
            for part, array in policy.memory.parts.items():
                tensors[part].copy_(torch.from_numpy(array))
            tensors[policy.memory.entry] /= sizes
    return model, env


def largest_difference(policy: PolicyFile, model: Any, env: ShakeTableVecEnv) -> float:
    """Return by how much the two differ while the numpy policy drives the table."""
    env.seed(0)
    shown, apart = env.reset(), 0.0
    past: Any = None
    recalled: Any = None
    begins = np.ones(1, dtype=bool)
    for _ in range(PERIODS):
        action, past = policy.predict(env.observation[0], past)
        correction, recalled = model.predict(shown, recalled, begins, deterministic=True)
        begins[:] = False
        other = np.clip(shown @ env.base + env.authority * correction[0], -1.0, 1.0)
        apart = max(apart, float(np.abs(other - action).max()))
        shown = env.step(correction)[0]
    return apart


def decisions(spell: float, spells: int) -> dict[str, dict[str, float]]:
    """Return seconds of a decision of each shipped policy by both, and how far their actions differ.

    SB3 is given what the estimator believes: the file's decision contains the estimator, its is only
    the network's. Both carry their memory on.
    """
    torch.set_num_threads(1)
    seconds = {}
    for title, name in SHIPPED.items():
        policy = load_policy(shipped_policy(*name))
        model, env = sb3_model(policy)
        apart = largest_difference(policy, model, env)
        if not apart <= TOLERANCE:
            raise AssertionError(f"{title}: SB3's model differs by {apart:.1e}")
        work = {"numpy": _decision(policy, env.observation[0]), "SB3": _decision(model, env._look())}
        times = seconds_each(work, spell, spells)
        seconds[title] = {**times, "largest difference": apart}
    return seconds


def _decision(policy: Any, observation: Any) -> Callable[[], None]:
    observation, past = observation.copy(), None

    def call() -> None:
        nonlocal past
        past = policy.predict(observation, past, deterministic=True)[1]

    return call
