"""Typed configuration of a training run; the defaults learn on two cores."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, Literal

from agents.earlier_names import present_config, warn_of_old_names
from agents.plain_values import differences, typed
from agents.run_directory import CONFIG, folder_contents, names_in_words, read_json
from agents.scenario_options import ScenarioOptions
from agents.seeds import MOST_RUNS
from agents.training.algorithm_options import (
    MEMORY_OPTIONS,
    APGOptions,
    DaggerOptions,
    PPOOptions,
    RecurrentPPOOptions,
    SACOptions,
    TD3Options,
    TQCOptions,
)
from shake_env.errors import ParameterError, RunDirectoryError
from shake_env.model.parameters import require_non_negative, require_positive

Options = (
    PPOOptions | SACOptions | TD3Options | TQCOptions | RecurrentPPOOptions | APGOptions | DaggerOptions
)


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """One training run. Everything that decides its result is in here, and in the run's config.json.

    Raises
    ------
    ParameterError
        If a number is outside its range.
    """

    algorithm: Literal["ppo", "sac", "td3", "tqc", "recurrent-ppo", "apg", "dagger"] = "ppo"
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
    apg: APGOptions = field(default_factory=APGOptions)
    """Options of the analytic policy gradient, used with --algorithm apg."""
    dagger: DaggerOptions = field(default_factory=DaggerOptions)
    """Options of the distillation of a controller, used with --algorithm dagger."""
    init_policy: str | None = None
    """Policy to initialise the actor with: a policy file, a run directory or the name of one that ships
    (default: random). A critic is always initialised at random."""
    seed: int = 0
    """Seed of networks, exploration and earthquakes."""
    total_timesteps: int | None = None
    """Control periods of all tables together (unset: 4 million for PPO, 3 million with a memory, 250
    thousand for SAC, TD3 and TQC, 12 million for the analytic gradient, a million for DAgger; 2 to 10
    minutes)."""
    discount_horizon: float | None = None
    """Time over which the discount looks ahead [s] (unset: 0.25, 5 for analytic gradient and DAgger);
    discount = exp(-control period / discount_horizon)."""
    episode_duration: float = 10.0
    """Length of a training earthquake [s]."""
    num_artificial_motions: int = 0
    """Artificial earthquakes of other spectra, scaled to all of the table's stroke, that every other
    training episode is drawn from (see `artificial_motions`)."""
    state_limit: float = 12.0
    """A training episode ends when a scaled state leaves this bound [multiples of its rms]."""
    odd_symmetry: bool = False
    """Whether the policy that is evaluated and exported is averaged with its mirror image, so that it is
    odd: -pi(-x) = pi(x), as the plant is (see `symmetry`). Not for a policy with a memory."""
    net_arch: tuple[int, ...] = (64, 64)
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
            self, "episode_duration", "state_limit", "evaluations",
            "evaluation_earthquakes", "checkpoint_interval", "threads",
        )  # fmt: skip
        for name in ("total_timesteps", "discount_horizon"):
            if getattr(self, name) is not None:
                require_positive(self, name)
        for ppo in (self.ppo, self.recurrent_ppo):
            if (samples := ppo.n_envs * ppo.n_steps) % ppo.batch_size:
                raise ParameterError(
                    "batch_size", ppo.batch_size, f"must divide the {samples} samples of a roll-out"
                )
        not_positive = (
            "log_std_init", "target_entropy", "base_controller", "actor_bias", "terminal_value",
            *MEMORY_OPTIONS.values(), "precision", "device", "top_quantiles_to_drop_per_net",
            "checkpoint_segment_length", "critic_warmup_fraction", "paired", "direct_path", "teacher",
            "asymmetric_critic",
        )  # fmt: skip
        every = (
            self.ppo, self.sac, self.td3, self.tqc, self.recurrent_ppo, self.apg, self.dagger,
        )  # fmt: skip
        for options in every:
            require_positive(options, *(name for name in vars(options) if name not in not_positive))
        require_non_negative(self, "seed", "num_artificial_motions")
        require_non_negative(self.apg, "checkpoint_segment_length")
        if self.num_artificial_motions and self.seed >= MOST_RUNS:
            raise ParameterError(
                "seed",
                self.seed,
                f"artificial earthquakes from seed {MOST_RUNS} on are those that runs are judged by",
            )
        require_non_negative(self.apg, "checkpoint_segment_length")
        for remembering in (self.apg, self.dagger):
            require_non_negative(remembering, *MEMORY_OPTIONS.values())
            if remembering.gru_hidden_size and (channels := remembering.tcn_channels):
                remedy = "a policy has one memory: give this or gru_hidden_size as 0"
                raise ParameterError("tcn_channels", channels, remedy)
        require_non_negative(self.tqc, dropped := "top_quantiles_to_drop_per_net")
        if (number := self.tqc.top_quantiles_to_drop_per_net) >= self.tqc.n_quantiles:
            raise ParameterError(dropped, number, "must leave a quantile of each critic")
        if self.ppo.asymmetric_critic and self.ppo.paired:
            remedy = "paired roll-outs have no critic: leave out one of the two options"
            raise ParameterError("asymmetric_critic", True, remedy)
        if not 0.0 <= (fraction := self.ppo.critic_warmup_fraction) < 1.0:
            remedy = "is a fraction of the run: 0 or more, below 1"
            raise ParameterError("critic_warmup_fraction", fraction, remedy)
        if (fraction := self.apg.lr_warmup_fraction) >= 1.0:
            raise ParameterError("lr_warmup_fraction", fraction, "is a fraction of the run: below 1")
        for options in every:
            if not 0.0 < (scale := options.residual_scale) <= 1.0:
                raise ParameterError("residual_scale", scale, "must lie above 0 and not above 1")
        if self.odd_symmetry and self.remembers:
            remedy = "a policy with a memory would need two: leave it out"
            raise ParameterError("odd_symmetry", True, remedy)
        if not self.net_arch or min(self.net_arch) < 1:
            raise ParameterError("net_arch", self.net_arch, "give the width of each layer, e.g. 64 64")

    @property
    def chosen(self) -> Options:
        """The options of the algorithm in use."""
        options: Options = getattr(self, self.algorithm.replace("-", "_"))
        return options

    @property
    def remembers(self) -> bool:
        """Whether the policy has a memory."""
        recurrent = self.algorithm == "recurrent-ppo"
        return recurrent or any(getattr(self.chosen, name, 0) for name in MEMORY_OPTIONS.values())

    @property
    def steps(self) -> int:
        """Control periods to train for."""
        usual = {"ppo": 4_000_000, "recurrent-ppo": 3_000_000, "apg": 12_288_000, "dagger": 1_000_000}
        return self.total_timesteps or usual.get(self.algorithm, 250_000)

    @property
    def lookahead(self) -> float:
        """Horizon of the discount [s]."""
        return self.discount_horizon or (5.0 if self.algorithm in ("apg", "dagger") else 0.25)

    def discount(self, control_period: float) -> float:
        """Return gamma for a control period [s]."""
        return math.exp(-control_period / self.lookahead)

    def to_json(self) -> dict[str, Any]:
        """Return the configuration as plain JSON values."""
        plain: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return plain


def config_of(values: object) -> TrainConfig:
    """Return the configuration that :meth:`TrainConfig.to_json` made these values of.

    Options that an older version did not have take their defaults; old names are understood.

    Raises
    ------
    ValueError
        If an option is unknown, missing, of another type or outside its range.
    """
    values = present_config(values)
    missing = [name for name in _ALWAYS if not isinstance(values, Mapping) or name not in values]
    if missing:
        raise ValueError(f"{names_in_words(missing)} not given")
    return typed(TrainConfig, values)


# What the configurations of every version hold: without one of these a file is none.
_ALWAYS = (
    "algorithm", "scenario", "ppo", "sac", "seed", "total_timesteps", "episode_duration", "net_arch",
)  # fmt: skip


def read_config(run: str | PathLike[str]) -> TrainConfig:
    """Return the configuration that a run directory holds.

    Raises
    ------
    RunDirectoryError
        If there is none, or it cannot be read, with the option at fault.
    """
    run = Path(run)
    values = read_json(run / CONFIG, RunDirectoryError, "configuration", largest=2**20)
    warn_of_old_names(values, str(run / CONFIG))
    try:
        return config_of(values)
    except ValueError as error:
        beside = names_in_words([name for name in folder_contents(run) if name != CONFIG]) or "nothing"
        reason = (
            f"describes no run of this version ({error}); beside it lies: {beside}. Move the directory "
            "away, or name another"
        )
        raise RunDirectoryError("configuration", str(run / CONFIG), reason) from error


def require_same(given: TrainConfig, run: str | PathLike[str], remedy: str) -> TrainConfig:
    """Return the configuration of a run.

    Raises
    ------
    RunDirectoryError
        If an option differs from the one given, with both values of each that does.
    """
    run = Path(run)
    stored = read_config(run)
    if changed := differences(given, stored):
        pairs = [f"{path} is {there!r}, given {here!r}" for path, (here, there) in changed.items()]
        reason = f"holds another configuration ({names_in_words(pairs)}): {remedy}"
        raise RunDirectoryError("run directory", str(run), reason)
    return stored
