"""The parts of an SB3 actor-critic policy that the analytic policy gradient trains one by one."""

from __future__ import annotations

import torch
from stable_baselines3.common.policies import ActorCriticPolicy

from agents.learning.memory_policies import MemoryPolicy

Features = tuple[torch.Tensor, torch.Tensor]  # what actor and critic are given of an observation


def trained_parameters(
    policy: ActorCriticPolicy,
) -> tuple[list[torch.nn.Parameter], list[torch.nn.Parameter]]:
    """Return the parameters of the mean action and those of the value that are trained.

    ``log_std`` is in neither. Parameters that both use are the actor's.
    """
    critic = {
        id(p)
        for module in (policy.mlp_extractor.value_net, policy.value_net)
        for p in module.parameters()
    }
    if not policy.share_features_extractor:
        critic |= {id(p) for p in policy.vf_features_extractor.parameters()}
    trained = [p for p in policy.parameters() if p.requires_grad]
    actor = [p for p in trained if id(p) not in critic and p is not policy.log_std]
    return actor, [p for p in trained if id(p) in critic]


def latent(
    policy: ActorCriticPolicy, observation: torch.Tensor, memory: torch.Tensor | None
) -> tuple[Features, torch.Tensor | None]:
    """Return the features (N, f) of actor and critic, and the policy's new memory (N, memory).

    Parameters
    ----------
    observation
        (N, n).
    memory
        (N, memory) of a policy with one; None of another.
    """
    if isinstance(policy, MemoryPolicy):
        assert memory is not None  # the caller begins with `rest`
        recalled, memory = policy.recall(observation, memory)
        return (recalled, recalled), memory
    # The extractors themselves: SB3's preprocessing of a Box is a cast to single precision.
    actor: torch.Tensor = policy.pi_features_extractor(observation)
    if policy.share_features_extractor:
        return (actor, actor), None
    return (actor, policy.vf_features_extractor(observation)), None


def state_value(policy: ActorCriticPolicy, critic_features: torch.Tensor) -> torch.Tensor:
    """Return the critic's value (...) of features (..., f)."""
    values: torch.Tensor = policy.value_net(policy.mlp_extractor.forward_critic(critic_features))[..., 0]
    return values


def set_gradient(
    policy: ActorCriticPolicy, loss: torch.Tensor, parameters: list[torch.nn.Parameter], bound: float
) -> float:
    """Set the gradient of some parameters alone, its norm at most `bound`; return the norm before."""
    gradients = torch.autograd.grad(loss, parameters, allow_unused=True)
    policy.optimizer.zero_grad(set_to_none=True)
    for parameter, gradient in zip(parameters, gradients, strict=True):
        parameter.grad = gradient
    return float(torch.nn.utils.clip_grad_norm_(parameters, bound))
