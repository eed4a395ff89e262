"""Typed options of the learning algorithms; the defaults learn on two cores."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from agents.policies.base_names import BaseLaw

# Options that give a policy a memory, by the kind of the memory unit; one at most is above 0.
MEMORY_OPTIONS = {"gru": "gru_hidden_size", "tcn": "tcn_channels"}


@dataclass(frozen=True, kw_only=True)
class ProximalOptions:
    """What PPO takes, with a memory or without."""

    n_envs: int = 64
    """Tables stepped side by side."""
    n_steps: int = 128
    """Control periods a table runs between two updates; gradients of a memory look back no further."""
    batch_size: int = 2048
    """Samples of one gradient step; with a memory whole sequences."""
    n_epochs: int = 10
    """Passes over the data of one roll-out."""
    learning_rate: float = 3e-4
    """Initial learning rate; it falls linearly to zero."""
    gae_lambda: float = 0.9
    """Lambda of the advantage estimate [-]."""
    clip_range: float = 0.2
    """Clip range of the probability ratio [-]."""
    base_controller: BaseLaw = "none"
    """Law that the policy corrects: none (from scratch); on the full state flow (the current that the
    table's own velocity uses), lqr or preview-lqr; lqg or lqg-dac, behind an estimator whose
    estimates the policy also observes; lqg-searched, the searched design of the scenario."""
    residual_scale: float = 1.0
    """What the policy can add to that law, as a fraction of the current limit."""
    log_std_init: float = -3.0
    """Log of the initial exploration, relative to the residual scale. White action noise is expensive
    (2 % of LQR's current adds 10 % to its cost), but the update's trust region moves the policy by a
    share of it: too little noise learns slowly."""
    paired: bool = False
    """Whether the reward is the difference to a shadow of each table, on the same earthquake and driven
    by the mean action, that is put back to the table at each roll-out. There is then no critic."""


@dataclass(frozen=True, kw_only=True)
class PPOOptions(ProximalOptions):
    """Proximal policy optimisation (Schulman et al., 2017) as SB3 implements it."""

    direct_path: bool = False
    """Whether the actor is a linear law plus a network, as the analytic gradient's is."""
    actor_bias: bool = False
    """Whether the actor has biases. Without, half the motion gets half the current, which is right for a
    linear plant; friction and limits need biases."""
    asymmetric_critic: bool = False
    """Whether the critic sees the true state, the drawn plant and the ground to come, which the policy
    does not see and does not need after training. Not with paired, which has no critic."""
    reward_gain: float = 1.0
    """Factor on the rewards, which are scaled by 1 - discount at unit amplitude. With 1 a return
    of laboratory is 0.03 on average, which a critic does not learn; with 1000 it does. Advantages are
    scaled whatever it is."""
    critic_warmup_fraction: float = 0.0
    """Share of the run in which the critic alone is trained. A warm-started policy has no trained
    critic; advantages from an untrained critic degrade it."""


@dataclass(frozen=True, kw_only=True)
class RecurrentPPOOptions(ProximalOptions):
    """PPO with a long short-term memory, as sb3-contrib implements it."""

    n_epochs: int = 5
    """Passes over the data of one roll-out."""
    lstm_hidden_size: int = 64
    """Width of the memory; actor and critic have one each."""


@dataclass(frozen=True, kw_only=True)
class OffPolicyOptions:
    """What algorithms that learn from remembered transitions take."""

    n_envs: int = 64
    """Tables stepped side by side."""
    batch_size: int = 256
    """Samples of one gradient step."""
    gradient_steps: int = 16
    """Gradient steps of the critics for each control period of all the tables."""
    learning_rate: float = 3e-4
    """Initial learning rate; it falls linearly to zero."""
    buffer_size: int = 400_000
    """Transitions remembered."""
    learning_starts: int = 20_000
    """Control periods that the untrained policy runs before the first gradient step."""
    tau: float = 0.005
    """Rate at which target networks follow [-]."""
    base_controller: BaseLaw = "flow"
    """Law that the policy corrects, as PPO's; without one, episodes end at a limit before the critic has
    learned."""
    residual_scale: float = 0.2
    """What the policy can add to that law, as a fraction of the current limit."""
    paired: bool = False
    """Whether the reward is the difference to a shadow of each table, on the same earthquake and driven
    by the base controller alone."""
    asymmetric_critic: bool = False
    """Whether the critics see the true state, the drawn plant and the ground to come, as PPO's. Entries
    double the memory that a transition takes."""
    reward_gain: float = 1.0
    """Factor on the rewards, which are scaled by 1 - discount at unit amplitude. Differences are smaller
    than stage costs."""


@dataclass(frozen=True, kw_only=True)
class SACOptions(OffPolicyOptions):
    """Soft actor-critic (Haarnoja et al., 2018) as SB3 implements it."""

    target_entropy: float = -2.0
    """Entropy that exploration settles at [nats], relative to the residual scale."""
    log_std_init: float = -1.5
    """Log of the initial exploration, relative to the residual scale."""


@dataclass(frozen=True, kw_only=True)
class TD3Options(OffPolicyOptions):
    """Twin delayed deep deterministic policy gradient (Fujimoto et al., 2018) as SB3 implements it."""

    policy_delay: int = 2
    """Gradient steps of the critics for one of the actor."""
    action_noise_std: float = 0.1
    """Standard deviation of the white noise on the action, relative to the residual scale."""
    target_policy_noise: float = 0.1
    """Standard deviation of the noise that smooths the critics' targets, relative to the residual
    scale."""
    target_noise_clip: float = 0.25
    """Bound on that noise, relative to the residual scale."""


@dataclass(frozen=True, kw_only=True)
class TQCOptions(SACOptions):
    """Truncated quantile critics (Kuznetsov et al., 2020) as sb3-contrib implements it."""

    gradient_steps: int = 8
    """Gradient steps for each control period of all the tables; each costs about twice SAC's."""
    n_quantiles: int = 25
    """Quantiles of the return that a critic estimates."""
    n_critics: int = 2
    """Number of critics."""
    top_quantiles_to_drop_per_net: int = 2
    """Highest quantiles of each critic that targets leave out."""


@dataclass(frozen=True, kw_only=True)
class DaggerOptions:
    """On-policy distillation of a controller into a policy (see `agents.learning.distillation`)."""

    teacher: str = "nmpc"
    """Name of the controller that labels the observations of the scenario. Where plants are drawn,
    nmpc-informed is nmpc that is told each table's plant; no such controller exists at a table."""
    n_envs: int = 16
    """Tables run side by side, an episode each round."""
    learning_rate: float = 1e-3
    """Initial learning rate; it falls linearly to zero."""
    buffer_size: int = 400_000
    """Labels kept from the last rounds."""
    batch_size: int = 4096
    """Labels of one gradient step."""
    n_epochs: int = 8
    """Passes over the kept labels each round."""
    sequence_length: int = 50
    """Control periods that the gradient of a policy with memory looks back through."""
    gru_hidden_size: int = 0
    """Width of the policy's gated recurrent unit; 0: none."""
    tcn_channels: int = 0
    """Width of the policy's temporal convolutions over the last 43 control periods, in the place of a
    recurrent unit; 0: none."""
    actor_bias: bool = True
    """Whether the actor has biases (see PPO's); a policy with memory always has them."""
    base_controller: BaseLaw = "lqg-searched"
    """Law that the policy corrects, as PPO's."""
    residual_scale: float = 0.03
    """What the policy can add to that law, as a fraction of the current limit. A step of the optimiser
    moves the action by a share of it, so that a scale far above the teacher's own correction (0.25 % of
    the limit, rms, in laboratory) learns slowly."""


@dataclass(frozen=True, kw_only=True)
class APGOptions:
    """Analytic policy gradient: back-propagation through the plant (see `agents.learning.apg`)."""

    n_envs: int = 128
    """Tables followed side by side."""
    rollout_horizon: int = 96
    """Control periods of the window that a gradient is taken through. A short window truncates the
    specimen's free vibration, which increases the base-shear error first."""
    learning_rate: float = 1e-3
    """Highest learning rate; it rises over the warm-up and then falls linearly to zero."""
    lr_warmup_fraction: float = 0.05
    """Share of the run over which the learning rate rises. The first gradients agree in direction,
    and at full rate may make the loop unstable."""
    max_grad_norm: float = 20.0
    """Bound on the gradient's norm, in stage costs (at unit amplitude) per unit of weight, of the usual
    size: a window in which the loop oscillated then counts no more than others."""
    terminal_value: bool = False
    """Whether a learned value follows the window's end (SHAC). Useful for short windows: a long one
    covers most of the response, and a critic's slope is less accurate than its value."""
    td_lambda: float = 0.95
    """Lambda of the critic's targets [-], with a terminal value."""
    gru_hidden_size: int = 0
    """Width of the policy's gated recurrent unit; 0: none."""
    tcn_channels: int = 0
    """Width of the policy's temporal convolutions over the last 43 control periods, in the place of a
    recurrent unit; 0: none."""
    checkpoint_segment_length: int = 0
    """Gradient checkpointing: control periods of a segment that is recomputed in the backward pass; 0:
    off. Memory is least near the square root of the window."""
    actor_bias: bool = False
    """Whether the actor has biases (see PPO's); a policy with memory always has them."""
    base_controller: BaseLaw = "none"
    """Law that the policy corrects, as PPO's."""
    residual_scale: float = 1.0
    """What the policy can add to that law, as a fraction of the current limit."""
    precision: Literal["float64", "float32"] = "float64"
    """Precision of the plant's state."""
    device: str = "cpu"
    """Torch device. On a CPU a gradient takes tens of milliseconds."""
