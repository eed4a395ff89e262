"""A model of the analytic policy gradient for tests."""

import torch

from agents.learning.apg.algorithm import AnalyticPolicyGradient
from agents.learning.features import LinearFeatures, feature_matrix, feature_sizes
from agents.learning.networks import DirectPolicy
from agents.learning.vec_env import ShakeTableVecEnv


def policy_options(scenario, believed=False, **options):
    return {
        "net_arch": [16],
        "activation_fn": torch.nn.Tanh,
        "features_extractor_class": LinearFeatures,
        "features_extractor_kwargs": {
            "matrix": feature_matrix(scenario, believed).tolist(),
            "sizes": feature_sizes(scenario, believed).tolist(),
        },
        **options,
    }


def model_on(scenario, *, lanes=3, memory=None, base=None, authority=1.0, gain=0.002, **options):
    """A small model whose actions are of the order of `gain`; `memory` is a `MemoryPolicy`'s class."""
    env = ShakeTableVecEnv(scenario, lanes, base=base, authority=authority, reward_scale=0.01)
    kind, units = (memory, {"units": 8}) if memory else (DirectPolicy, {})
    options_of_policy = policy_options(scenario, believed=env.law is not None, **units)
    model = AnalyticPolicyGradient(
        kind, env, policy_kwargs=options_of_policy, seed=1, device="cpu",
        **{"window": 12, "gamma": 0.99, "stagger": False, **options},
    )  # fmt: skip
    with torch.no_grad():
        generator = torch.Generator().manual_seed(0)
        weight = model.policy.action_net.weight
        weight.copy_(gain * torch.randn(weight.shape, generator=generator))
        weight[:, 16:] *= 1e-3  # the direct path has no bound
    model._setup_learn(10_000)
    return model
