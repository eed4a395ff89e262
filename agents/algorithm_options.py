"""Typed options of the algorithms beside PPO, SAC and the analytic gradient."""

from __future__ import annotations

from dataclasses import dataclass

from agents.base_law import BaseLaw


@dataclass(frozen=True, kw_only=True)
class TD3Options:
    """Twin delayed deep deterministic policy gradient (Fujimoto et al., 2018) as SB3 implements it."""

    tables: int = 64
    """Tables stepped side by side."""
    batch_size: int = 256
    """Samples of one gradient step."""
    gradient_steps: int = 16
    """Gradient steps of the critics for each control period of all the tables."""
    learning_rate: float = 3e-4
    """Initial learning rate; it falls linearly to zero."""
    buffer_size: int = 400_000
    """Transitions remembered."""
    warmup_steps: int = 20_000
    """Control periods that the untrained policy runs before the first gradient step."""
    tau: float = 0.005
    """Rate at which target networks follow [-]."""
    policy_delay: int = 2
    """Gradient steps of the critics for one of the actor."""
    exploration: float = 0.1
    """Standard deviation of the white noise on the action, relative to the authority."""
    target_noise: float = 0.1
    """Standard deviation of the noise that smooths the critics' targets, relative to the authority."""
    target_noise_clip: float = 0.25
    """Bound on that noise, relative to the authority."""
    base: BaseLaw = "flow"
    """Linear law that the policy corrects: none, flow or lqr (see SAC's)."""
    authority: float = 0.2
    """What the policy can add to that law, as a fraction of the current limit."""


@dataclass(frozen=True, kw_only=True)
class TQCOptions:
    """Truncated quantile critics (Kuznetsov et al., 2020) as sb3-contrib implements it."""

    tables: int = 64
    """Tables stepped side by side."""
    batch_size: int = 256
    """Samples of one gradient step."""
    gradient_steps: int = 8
    """Gradient steps for each control period of all the tables; each costs about twice SAC's."""
    learning_rate: float = 3e-4
    """Initial learning rate; it falls linearly to zero."""
    buffer_size: int = 400_000
    """Transitions remembered."""
    warmup_steps: int = 20_000
    """Control periods that the untrained policy runs before the first gradient step."""
    tau: float = 0.005
    """Rate at which target networks follow [-]."""
    quantiles: int = 25
    """Quantiles of the return that a critic estimates."""
    critics: int = 2
    """Number of critics."""
    dropped: int = 2
    """Highest quantiles of each critic that targets leave out."""
    base: BaseLaw = "flow"
    """Linear law that the policy corrects: none, flow or lqr (see SAC's)."""
    authority: float = 0.2
    """What the policy can add to that law, as a fraction of the current limit."""
    target_entropy: float = -2.0
    """Entropy that exploration settles at [nats], relative to the authority."""
    initial_log_std: float = -1.5
    """Log of the initial exploration, relative to the authority."""


@dataclass(frozen=True, kw_only=True)
class RecurrentPPOOptions:
    """PPO with a long short-term memory, as sb3-contrib implements it."""

    tables: int = 64
    """Tables stepped side by side."""
    rollout_steps: int = 128
    """Control periods a table runs between two updates; gradients look back no further."""
    batch_size: int = 2048
    """Samples of one gradient step, whole sequences."""
    epochs: int = 5
    """Passes over the data of one roll-out."""
    learning_rate: float = 3e-4
    """Initial learning rate; it falls linearly to zero."""
    gae_lambda: float = 0.9
    """Lambda of the advantage estimate [-]."""
    clip_range: float = 0.2
    """Clip range of the probability ratio [-]."""
    units: int = 64
    """Width of the memory; actor and critic have one each."""
    base: BaseLaw = "none"
    """Law that the policy corrects: none, flow, lqr, or one behind an estimator (see the analytic's)."""
    authority: float = 1.0
    """What the policy can add to that law, as a fraction of the current limit."""
    initial_log_std: float = -3.0
    """Log of the initial exploration, relative to the authority (see PPO's)."""
