"""Typed configuration of a training run; the defaults learn on two cores."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from agents.algorithm_options import RecurrentPPOOptions, TD3Options, TQCOptions
from agents.base_law import BaseLaw
from agents.options import ScenarioOptions
from shake_env.errors import ParameterError, RunDirectoryError
from shake_env.parameters import require_non_negative, require_positive


@dataclass(frozen=True, kw_only=True)
class PPOOptions:
    """Proximal policy optimisation (Schulman et al., 2017) as SB3 implements it."""

    tables: int = 64
    """Tables stepped side by side."""
    rollout_steps: int = 128
    """Control periods a table runs between two updates."""
    batch_size: int = 2048
    """Samples of one gradient step."""
    epochs: int = 10
    """Passes over the data of one roll-out."""
    learning_rate: float = 3e-4
    """Initial learning rate; it falls linearly to zero."""
    gae_lambda: float = 0.9
    """Lambda of the advantage estimate [-]."""
    clip_range: float = 0.2
    """Clip range of the probability ratio [-]."""
    scale_free: bool = True
    """Whether the actor has no biases, so that half the motion gets half the current. Right for a linear
    plant; friction and limits need biases."""
    base: BaseLaw = "none"
    """Linear law that the policy corrects: none (from scratch), flow (the current that the table's own
    velocity uses), lqr (residual on top of LQR)."""
    authority: float = 1.0
    """What the policy can add to that law, as a fraction of the current limit."""
    initial_log_std: float = -3.0
    """Log of the initial exploration, relative to the current limit. White action noise is expensive
    (2 % of LQR's current adds 10 % to its cost), but the update's trust region moves the policy by a
    share of it, so that too little of it learns slowly."""


@dataclass(frozen=True, kw_only=True)
class SACOptions:
    """Soft actor-critic (Haarnoja et al., 2018) as SB3 implements it."""

    tables: int = 64
    """Tables stepped side by side."""
    batch_size: int = 256
    """Samples of one gradient step."""
    gradient_steps: int = 16
    """Gradient steps for each control period of all the tables."""
    learning_rate: float = 3e-4
    """Initial learning rate; it falls linearly to zero."""
    buffer_size: int = 400_000
    """Transitions remembered."""
    warmup_steps: int = 20_000
    """Control periods that the untrained policy runs before the first gradient step."""
    tau: float = 0.005
    """Rate at which target networks follow [-]."""
    base: BaseLaw = "flow"
    """Linear law that the policy corrects: none, flow (the current that the table's own velocity uses)
    or lqr. From nothing, the critic cannot tell good currents from bad before the tables are lost."""
    authority: float = 0.2
    """What the policy can add to that law, as a fraction of the current limit."""
    target_entropy: float = -2.0
    """Entropy that exploration settles at [nats], relative to the authority."""
    initial_log_std: float = -1.5
    """Log of the initial exploration, relative to the authority."""


@dataclass(frozen=True, kw_only=True)
class AnalyticOptions:
    """Analytic policy gradient: back-propagation through the plant (see `analytic_gradient`)."""

    tables: int = 128
    """Tables followed side by side."""
    window: int = 96
    """Control periods that a gradient looks back through. What they leave out is the specimen's ringing:
    a shorter window costs base shear first."""
    learning_rate: float = 1e-3
    """Highest learning rate; it rises over the warm-up and then falls linearly to zero."""
    warmup: float = 0.05
    """Share of the run over which the learning rate rises. The first gradients all point one way, and at
    full rate may carry the loop's gain past what is stable."""
    max_grad_norm: float = 20.0
    """Bound on the gradient's norm, in stage costs (at unit amplitude) per unit of weight: of the size
    of what is usual, so that a window in which a loop rang counts no more than others."""
    terminal_value: bool = False
    """Whether a learned value stands at the window's end (SHAC). A window outlasts most of what a table
    remembers, and a critic's slope is less certain than its value: for short windows."""
    td_lambda: float = 0.95
    """Lambda of the critic's targets [-], with a terminal value."""
    memory: int = 0
    """Width of the policy's gated recurrent unit; 0: a policy without memory."""
    checkpoint: int = 0
    """Control periods of a segment that is run again when the gradient is taken instead of being kept,
    for windows too long to be kept whole; 0: none is. Memory is least near the window's square root."""
    scale_free: bool = True
    """Whether the actor has no biases (see PPO's); without effect on a policy with memory."""
    base: BaseLaw = "none"
    """Law that the policy corrects: none; on the full state flow, lqr or preview-lqr; lqg or
    lqg-accommodating, whose estimate the policy is then shown as well."""
    authority: float = 1.0
    """What the policy can add to that law, as a fraction of the current limit."""
    precision: Literal["float64", "float32"] = "float64"
    """Precision of the plant's state."""
    device: str = "cpu"
    """Torch device. On a CPU a gradient takes tens of milliseconds."""


Options = PPOOptions | SACOptions | TD3Options | TQCOptions | RecurrentPPOOptions | AnalyticOptions


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """One training run. Everything that decides its result is in here, and in the run's config.json.

    Raises
    ------
    ParameterError
        If a number is outside its range.
    """

    algorithm: Literal["ppo", "sac", "td3", "tqc", "recurrent-ppo", "analytic"] = "ppo"
    """Learning algorithm."""
    scenario: ScenarioOptions = field(default_factory=ScenarioOptions)
    """What is learned on."""
    ppo: PPOOptions = field(default_factory=PPOOptions)
    """Options of PPO, used with --algorithm ppo."""
    sac: SACOptions = field(default_factory=SACOptions)
    """Options of SAC, used with --algorithm sac."""
    td3: TD3Options = field(default_factory=TD3Options)
    """Options of TD3, used with --algorithm td3."""
    tqc: TQCOptions = field(default_factory=TQCOptions)
    """Options of TQC, used with --algorithm tqc."""
    recurrent_ppo: RecurrentPPOOptions = field(default_factory=RecurrentPPOOptions)
    """Options of PPO with a memory, used with --algorithm recurrent-ppo."""
    analytic: AnalyticOptions = field(default_factory=AnalyticOptions)
    """Options of the analytic policy gradient, used with --algorithm analytic."""
    seed: int = 0
    """Seed of networks, exploration and earthquakes."""
    total_steps: int | None = None
    """Control periods of all tables together (unset: 4 million for PPO, 3 million with a memory, 250
    thousand for SAC, TD3 and TQC, 12 million for the analytic gradient; 2 to 10 minutes)."""
    horizon: float | None = None
    """Time over which the discount looks ahead [s] (unset: 0.25, for the analytic gradient 5);
    discount = exp(-control period / horizon)."""
    episode: float = 10.0
    """Length of a training earthquake [s]."""
    artificial: int = 0
    """Artificial earthquakes of other spectra, scaled to all of the table's stroke, that every other
    training episode is drawn from (see `artificial`)."""
    state_limit: float = 12.0
    """A training episode ends when a scaled state leaves this bound [multiples of its rms]."""
    hidden: tuple[int, ...] = (64, 64)
    """Width of each hidden layer."""
    evaluations: int = 20
    """Evaluations over the run, the first before it, and one after it; the best one's policy is kept."""
    evaluation_earthquakes: int = 32
    """Fixed earthquakes of an evaluation."""
    checkpoint_interval: float = 60.0
    """Wall time between checkpoints [s]."""
    threads: int = 1
    """Threads of torch and BLAS; one is fastest for networks of this size."""

    def __post_init__(self) -> None:
        require_positive(
            self, "episode", "state_limit", "evaluations",
            "evaluation_earthquakes", "checkpoint_interval", "threads",
        )  # fmt: skip
        for name in ("total_steps", "horizon"):
            if getattr(self, name) is not None:
                require_positive(self, name)
        for ppo in (self.ppo, self.recurrent_ppo):
            if (samples := ppo.tables * ppo.rollout_steps) % ppo.batch_size:
                raise ParameterError(
                    "batch_size", ppo.batch_size, f"must divide the {samples} samples of a roll-out"
                )
        not_positive = (
            "initial_log_std", "target_entropy", "base", "scale_free", "terminal_value", "memory",
            "precision", "device", "dropped", "checkpoint",
        )  # fmt: skip
        every = (self.ppo, self.sac, self.td3, self.tqc, self.recurrent_ppo, self.analytic)
        for options in every:
            require_positive(options, *(name for name in vars(options) if name not in not_positive))
        require_non_negative(self, "seed", "artificial")
        require_non_negative(self.analytic, "memory", "checkpoint")
        require_non_negative(self.tqc, "dropped")
        if self.tqc.dropped >= self.tqc.quantiles:
            raise ParameterError("dropped", self.tqc.dropped, "must leave a quantile of each critic")
        if self.analytic.warmup >= 1.0:
            raise ParameterError("warmup", self.analytic.warmup, "is a share of the run: below 1")
        for options in every:
            if not 0.0 < options.authority <= 1.0:
                raise ParameterError("authority", options.authority, "must lie above 0 and not above 1")
        if not self.hidden or min(self.hidden) < 1:
            raise ParameterError("hidden", self.hidden, "give the width of each layer, e.g. 64 64")

    @property
    def chosen(self) -> Options:
        """The options of the algorithm in use."""
        options: Options = getattr(self, self.algorithm.replace("-", "_"))
        return options

    @property
    def steps(self) -> int:
        """Control periods to train for."""
        usual = {"ppo": 4_000_000, "recurrent-ppo": 3_000_000, "analytic": 12_288_000}
        return self.total_steps or usual.get(self.algorithm, 250_000)

    @property
    def lookahead(self) -> float:
        """Horizon of the discount [s]."""
        return self.horizon or (5.0 if self.algorithm == "analytic" else 0.25)

    def discount(self, control_period: float) -> float:
        """Return gamma for a control period [s]."""
        return math.exp(-control_period / self.lookahead)

    def to_json(self) -> dict[str, Any]:
        """Return the configuration as plain JSON values."""
        plain: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return plain


# Options that configurations of before there were these algorithms do not hold.
_LATER = {
    "td3": TD3Options, "tqc": TQCOptions, "recurrent_ppo": RecurrentPPOOptions,
    "analytic": AnalyticOptions,
}  # fmt: skip


def config_of(values: dict[str, Any]) -> TrainConfig:
    """Return the configuration that :meth:`TrainConfig.to_json` made these values of."""
    options = values["scenario"]
    return TrainConfig(
        **{
            **values,
            "scenario": ScenarioOptions(**{**options, "set": tuple(options.get("set", ()))}),
            "ppo": PPOOptions(**values["ppo"]),
            "sac": SACOptions(**values["sac"]),
            **{name: kind(**values.get(name, {})) for name, kind in _LATER.items()},
            "hidden": tuple(values["hidden"]),
        }
    )


def read_config(run: Path) -> TrainConfig:
    """Return the configuration that a run directory holds.

    Raises
    ------
    RunDirectoryError
        If there is none, or it cannot be read.
    """
    try:
        return config_of(json.loads((run / "config.json").read_text(encoding="utf-8")))
    except (OSError, KeyError, TypeError, json.JSONDecodeError) as error:
        raise RunDirectoryError(
            "run directory", str(run), f"holds no readable config.json ({error}): start a new run"
        ) from error
