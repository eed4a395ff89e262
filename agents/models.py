"""SB3 models as a `TrainConfig` describes them."""

from __future__ import annotations

from typing import Any

import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.policies import ActorCriticPolicy

from agents.analytic_gradient import AnalyticPolicyGradient
from agents.config import TrainConfig
from agents.direct import DirectPolicy
from agents.features import LinearFeatures, feature_matrix, feature_sizes
from agents.recurrent import GRUPolicy
from agents.sb3_vec_env import ShakeTableVecEnv
from shake_env.scenario import Scenario


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


class WarmSAC(SAC):
    """SAC that warms up with its own untrained policy.

    SB3 begins with actions uniform over the whole valve, which throw every table off within a second.
    """

    def _sample_action(self, learning_starts: int, action_noise: Any = None, n_envs: int = 1) -> Any:
        return super()._sample_action(0, action_noise, n_envs)


Model = PPO | SAC | AnalyticPolicyGradient
ALGORITHMS: dict[str, type[PPO] | type[SAC] | type[AnalyticPolicyGradient]] = {
    "ppo": PPO,
    "sac": WarmSAC,
    "analytic": AnalyticPolicyGradient,
}


class LinearDecay:
    """A learning rate that falls linearly to zero."""

    def __init__(self, initial: float) -> None:
        self.initial = initial

    def __call__(self, progress_remaining: float) -> float:
        """Return the rate when the share `progress_remaining` of the run is left."""
        return self.initial * progress_remaining


class WarmUp:
    """A learning rate that rises linearly over the first share of a run, then falls linearly to zero."""

    def __init__(self, highest: float, share: float) -> None:
        self.highest, self.share = highest, share

    def __call__(self, progress_remaining: float) -> float:
        """Return the rate when the share `progress_remaining` of the run is left."""
        return self.highest * min(progress_remaining, (1.0 - progress_remaining) / self.share)


def new_model(config: TrainConfig, scenario: Scenario, env: ShakeTableVecEnv) -> Model:
    """Return an untrained model on `env`; `scenario` is what it will be used on."""
    policy: dict[str, Any] = {
        "net_arch": list(config.hidden),
        # The linear optimum is a linear law, which rectifiers can represent exactly and tanh cannot.
        "activation_fn": torch.nn.ReLU,
        "features_extractor_class": LinearFeatures,
        "features_extractor_kwargs": {
            "matrix": feature_matrix(scenario, env.law is not None).tolist(),
            "sizes": feature_sizes(scenario, env.law is not None).tolist(),
        },
    }
    gamma = config.discount(scenario.control_period)
    if config.algorithm == "ppo":
        ppo = config.ppo
        return PPO(
            ScaleFreePolicy if ppo.scale_free else ActorCriticPolicy,
            env,
            n_steps=ppo.rollout_steps,
            batch_size=ppo.batch_size,
            n_epochs=ppo.epochs,
            learning_rate=LinearDecay(ppo.learning_rate),
            gae_lambda=ppo.gae_lambda,
            clip_range=ppo.clip_range,
            gamma=gamma,
            seed=config.seed,
            policy_kwargs={**policy, "log_std_init": ppo.initial_log_std},
            device="cpu",
        )
    if config.algorithm == "analytic":
        return _analytic(config, policy, env, gamma)
    sac = config.sac
    model = WarmSAC(
        "MlpPolicy",
        env,
        batch_size=sac.batch_size,
        gradient_steps=sac.gradient_steps,
        learning_rate=LinearDecay(sac.learning_rate),
        buffer_size=sac.buffer_size,
        tau=sac.tau,
        target_entropy=sac.target_entropy,
        ent_coef="auto_0.001",
        learning_starts=sac.warmup_steps,
        gamma=gamma,
        seed=config.seed,
        policy_kwargs=policy,
        device="cpu",
    )
    with torch.no_grad():  # for the same reason the actor starts with a small spread about zero
        model.actor.log_std.weight.mul_(0.01)
        model.actor.log_std.bias.fill_(sac.initial_log_std)
        model.actor.mu.weight.mul_(0.01)
        model.actor.mu.bias.zero_()
    return model


def _analytic(
    config: TrainConfig, policy: dict[str, Any], env: ShakeTableVecEnv, gamma: float
) -> AnalyticPolicyGradient:
    analytic = config.analytic
    kind: type[ActorCriticPolicy]
    if analytic.memory:
        kind, policy = GRUPolicy, {**policy, "units": analytic.memory}
    else:
        kind = ScaleFreeDirectPolicy if analytic.scale_free else DirectPolicy
    # Exact gradients need no long averages: short ones forget a window in which the loop rang. SB3's
    # epsilon of 1e-5 is of the size of the gradient's entries near the optimum: Adam would stop there.
    policy["optimizer_kwargs"] = {"betas": (0.7, 0.95), "eps": 1e-8}
    policy["log_std_init"] = -3.0  # for PPO to go on from
    return AnalyticPolicyGradient(
        kind,
        env,
        learning_rate=WarmUp(analytic.learning_rate, analytic.warmup),
        window=analytic.window,
        gamma=gamma,
        td_lambda=analytic.td_lambda,
        max_grad_norm=analytic.max_grad_norm * (1.0 - gamma),  # rewards are scaled by that, too
        terminal_value=analytic.terminal_value,
        plant_dtype=analytic.precision,
        seed=config.seed,
        policy_kwargs=policy,
        device=analytic.device,
    )
