"""SB3 models as a `TrainConfig` describes them."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy

from agents.learning.apg.algorithm import AnalyticPolicyGradient
from agents.learning.asymmetric import asymmetric
from agents.learning.distillation import Distillation
from agents.learning.features import LinearFeatures, feature_matrix, feature_sizes
from agents.learning.memory_policies import GRUPolicy, MemoryPolicy, TCNPolicy
from agents.learning.networks import (
    DirectPolicy,
    LSTMPolicy,
    ScaleFreeDirectPolicy,
    ScaleFreePolicy,
)
from agents.learning.paired import PairedVecEnv
from agents.learning.vec_env import ShakeTableVecEnv
from agents.training.algorithm_options import (
    MEMORY_OPTIONS,
    APGOptions,
    DaggerOptions,
    OffPolicyOptions,
    SACOptions,
    TD3Options,
    TQCOptions,
)
from agents.training.config import TrainConfig
from agents.training.tables import TrainingTables, base_tables
from baselines.planning.informed import InformedPredictiveControl
from baselines.registry import make_baseline
from shake_env.controller import Controller
from shake_env.errors import ParameterError
from shake_env.scenario.scenario import Scenario

INFORMED = "nmpc-informed"  # teacher that is told the plant; not a controller of the registry

# By whether an actor has no biases, and whether it has a direct path.
_ACTORS: dict[tuple[bool, bool], type[ActorCriticPolicy]] = {
    (False, False): ActorCriticPolicy,
    (False, True): DirectPolicy,
    (True, False): ScaleFreePolicy,
    (True, True): ScaleFreeDirectPolicy,
}
_MEMORIES: tuple[type[MemoryPolicy], ...] = (GRUPolicy, TCNPolicy)


class _Warm:
    """Warms up with the algorithm's own untrained policy.

    SB3 begins with actions uniform over the whole valve, which drive every table to a limit within a
    second.
    """

    def _sample_action(self, learning_starts: int, action_noise: Any = None, n_envs: int = 1) -> Any:
        return super()._sample_action(0, action_noise, n_envs)  # type: ignore[misc]


class WarmSAC(_Warm, SAC):
    """SAC that warms up with its own untrained policy."""


class WarmTD3(_Warm, TD3):
    """TD3 that warms up with its own untrained policy and exploration."""


class WarmTQC(_Warm, TQC):
    """TQC that warms up with its own untrained policy."""


class CriticWarmupPPO(PPO):
    """PPO whose actor stands still for the first share `critic_warmup_fraction` of a run."""

    critic_warmup_fraction = 0.0

    def train(self) -> None:
        """Learn from a roll-out; see PPO."""
        if not hasattr(self, "_moving"):
            layers = (self.policy.mlp_extractor.policy_net, self.policy.action_net)
            actor = [parameter for layer in layers for parameter in layer.parameters()]
            # The biases of an actor without biases stay 0.
            self._moving = [p for p in (*actor, self.policy.log_std) if p.requires_grad]
        waits = 1.0 - self._current_progress_remaining < self.critic_warmup_fraction
        for parameter in self._moving:
            parameter.requires_grad_(not waits)
        super().train()

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "_moving"]


Model = PPO | SAC | TD3 | TQC | RecurrentPPO | AnalyticPolicyGradient | Distillation


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


def new_model(
    config: TrainConfig, scenario: Scenario, env: TrainingTables, *, direct: bool = False
) -> Model:
    """Return an untrained model on `env`; `scenario` is what it will be used on.

    With `direct` PPO's actor has a linear path beside its network, as the gradient's has.
    """
    model = _model(config, scenario, env, direct or config.ppo.direct_path)
    if isinstance(env, PairedVecEnv):
        env.follow(model)
    return model


def _model(config: TrainConfig, scenario: Scenario, env: TrainingTables, direct: bool) -> Model:
    tables = base_tables(env)
    believed = tables.law is not None
    policy: dict[str, Any] = {
        "net_arch": list(config.net_arch),
        # The linear optimum is a linear law, which rectifiers can represent exactly and tanh cannot.
        "activation_fn": torch.nn.ReLU,
        "features_extractor_class": LinearFeatures,
        "features_extractor_kwargs": {
            "matrix": feature_matrix(scenario, believed).tolist(),
            "sizes": feature_sizes(scenario, believed).tolist(),
        },
    }
    gamma = config.discount(scenario.control_period)
    if config.algorithm == "ppo":
        ppo = config.ppo
        kind: type[BasePolicy] = _ACTORS[not ppo.actor_bias, direct]
        proximal = CriticWarmupPPO(
            asymmetric(kind) if ppo.asymmetric_critic else kind,  # type: ignore[arg-type]
            env,
            n_steps=ppo.n_steps,
            batch_size=ppo.batch_size,
            n_epochs=ppo.n_epochs,
            learning_rate=LinearDecay(ppo.learning_rate),
            gae_lambda=ppo.gae_lambda,
            clip_range=ppo.clip_range,
            gamma=gamma,
            seed=config.seed,
            policy_kwargs={**policy, "log_std_init": ppo.log_std_init},
            device="cpu",
        )
        proximal.critic_warmup_fraction = ppo.critic_warmup_fraction
        return proximal
    if config.algorithm == "recurrent-ppo":
        return _recurrent(config, policy, env, gamma)
    if config.algorithm == "apg":
        return _analytic(config, policy, tables, gamma)
    if config.algorithm == "dagger":
        return _distillation(config, policy, tables)
    return _off_policy(config, policy, env, gamma)


def _off_policy(
    config: TrainConfig, policy: dict[str, Any], env: TrainingTables, gamma: float
) -> SAC | TD3 | TQC:
    chosen = {"sac": config.sac, "td3": config.td3, "tqc": config.tqc}[config.algorithm]
    common: dict[str, Any] = {
        "batch_size": chosen.batch_size,
        "gradient_steps": chosen.gradient_steps,
        "learning_rate": LinearDecay(chosen.learning_rate),
        "buffer_size": chosen.buffer_size,
        "learning_starts": chosen.learning_starts,
        "tau": chosen.tau,
        "gamma": gamma,
        "seed": config.seed,
        "device": "cpu",
    }
    if isinstance(chosen, TD3Options):
        model = WarmTD3(
            _policy_of(WarmTD3, chosen),
            env,
            policy_delay=chosen.policy_delay,
            action_noise=NormalActionNoise(np.zeros(1), np.full(1, chosen.action_noise_std)),
            target_policy_noise=chosen.target_policy_noise,
            target_noise_clip=chosen.target_noise_clip,
            policy_kwargs=policy,
            **common,
        )
        _shrink(model.actor.mu[-2])
        model.actor_target.load_state_dict(model.actor.state_dict())
        return model
    assert isinstance(chosen, SACOptions)
    entropy: dict[str, Any] = {"target_entropy": chosen.target_entropy, "ent_coef": "auto_0.001"}
    soft: SAC | TQC
    if isinstance(chosen, TQCOptions):
        quantiles = {"n_quantiles": chosen.n_quantiles, "n_critics": chosen.n_critics}
        soft = WarmTQC(
            _policy_of(WarmTQC, chosen),
            env,
            top_quantiles_to_drop_per_net=chosen.top_quantiles_to_drop_per_net,
            policy_kwargs={**policy, **quantiles},
            **entropy,
            **common,
        )
    else:
        soft = WarmSAC(_policy_of(WarmSAC, chosen), env, policy_kwargs=policy, **entropy, **common)
    _shrink(soft.actor.log_std, chosen.log_std_init)
    _shrink(soft.actor.mu)
    return soft


def _policy_of(algorithm: type[SAC | TD3 | TQC], chosen: OffPolicyOptions) -> Any:
    """Return the class of an algorithm's policy."""
    usual = algorithm.policy_aliases["MlpPolicy"]
    return asymmetric(usual) if chosen.asymmetric_critic else usual


def _shrink(layer: object, bias: float = 0.0) -> None:
    """Let an actor's output begin, for PPO's reason, with a small spread about `bias`."""
    assert isinstance(layer, torch.nn.Linear)
    with torch.no_grad():
        layer.weight.mul_(0.01)
        layer.bias.fill_(bias)


def _recurrent(
    config: TrainConfig, policy: dict[str, Any], env: TrainingTables, gamma: float
) -> RecurrentPPO:
    chosen = config.recurrent_ppo
    return RecurrentPPO(
        LSTMPolicy,
        env,
        n_steps=chosen.n_steps,
        batch_size=chosen.batch_size,
        n_epochs=chosen.n_epochs,
        learning_rate=LinearDecay(chosen.learning_rate),
        gae_lambda=chosen.gae_lambda,
        clip_range=chosen.clip_range,
        gamma=gamma,
        seed=config.seed,
        policy_kwargs={
            **policy, "log_std_init": chosen.log_std_init, "lstm_hidden_size": chosen.lstm_hidden_size
        },
        device="cpu",
    )  # fmt: skip


def _direct_or_memory(
    options: APGOptions | DaggerOptions, policy: dict[str, Any]
) -> tuple[type[ActorCriticPolicy], dict[str, Any]]:
    """Return the policy class with a direct path that the options name, and its keywords."""
    for kind in _MEMORIES:
        if units := getattr(options, MEMORY_OPTIONS[kind.kind.kind]):
            return kind, {**policy, "units": units}
    return _ACTORS[not options.actor_bias, True], policy


def _analytic(
    config: TrainConfig, policy: dict[str, Any], env: TrainingTables, gamma: float
) -> AnalyticPolicyGradient:
    analytic = config.apg
    kind, policy = _direct_or_memory(analytic, policy)
    # Exact gradients need no long averages: short ones forget a window in which the loop rang. SB3's
    # epsilon of 1e-5 is of the size of the gradient's entries near the optimum: Adam would stop there.
    policy["optimizer_kwargs"] = {"betas": (0.7, 0.95), "eps": 1e-8}
    policy["log_std_init"] = -3.0  # for PPO to go on from
    return AnalyticPolicyGradient(
        kind,
        env,
        learning_rate=WarmUp(analytic.learning_rate, analytic.lr_warmup_fraction),
        window=analytic.rollout_horizon,
        gamma=gamma,
        td_lambda=analytic.td_lambda,
        max_grad_norm=analytic.max_grad_norm * (1.0 - gamma),  # rewards are scaled by that, too
        terminal_value=analytic.terminal_value,
        plant_dtype=analytic.precision,
        checkpoint=analytic.checkpoint_segment_length,
        seed=config.seed,
        policy_kwargs=policy,
        device=analytic.device,
    )


def _teacher(name: str, env: ShakeTableVecEnv) -> Controller:
    """Return the controller that labels what the tables of an environment show."""
    if name != INFORMED:
        return make_baseline(name, env.scenario)
    plants = env.simulation.plant_batch
    if plants is None:
        raise ParameterError("teacher", name, "the scenario draws no plant to be told: nmpc")
    return InformedPredictiveControl(env.scenario, plants.plant)


def _distillation(config: TrainConfig, policy: dict[str, Any], env: ShakeTableVecEnv) -> Distillation:
    chosen = config.dagger
    kind, policy = _direct_or_memory(chosen, policy)
    policy["log_std_init"] = -3.0  # for PPO to go on from
    policy["optimizer_kwargs"] = {"eps": 1e-8}  # as for gradients through the plant
    return Distillation(
        kind,
        env,
        _teacher(chosen.teacher, env),
        learning_rate=LinearDecay(chosen.learning_rate),
        buffer_size=chosen.buffer_size,
        batch_size=chosen.batch_size,
        n_epochs=chosen.n_epochs,
        sequence_length=chosen.sequence_length,
        seed=config.seed,
        policy_kwargs=policy,
        device="cpu",
    )
