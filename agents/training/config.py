"""Typed configuration of a training run; the defaults learn on two cores."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, Literal

from agents.plain_values import differences, typed
from agents.run_directory import CONFIG, contents, described, read_json
from agents.scenario_options import ScenarioOptions
from agents.seeds import MOST_RUNS
from agents.training.algorithm_options import (
    AnalyticOptions,
    PPOOptions,
    RecurrentPPOOptions,
    SACOptions,
    TD3Options,
    TQCOptions,
)
from shake_env.errors import ParameterError, RunDirectoryError
from shake_env.model.parameters import require_non_negative, require_positive

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
    start: str | None = None
    """Policy to begin with instead of nothing: a policy file, a run directory or the name of one that
    ships. The actor takes its weights; a critic begins anew."""
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
    mirrored: bool = False
    """Whether what is evaluated and kept is the policy averaged with its mirror image (see `mirror`):
    what a learner's noise leaves of even is error. Not for one with a memory."""
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
            "precision", "device", "dropped", "checkpoint", "critic_first",
        )  # fmt: skip
        every = (self.ppo, self.sac, self.td3, self.tqc, self.recurrent_ppo, self.analytic)
        for options in every:
            require_positive(options, *(name for name in vars(options) if name not in not_positive))
        require_non_negative(self, "seed", "artificial")
        if self.artificial and self.seed >= MOST_RUNS:
            raise ParameterError(
                "seed",
                self.seed,
                f"artificial earthquakes from seed {MOST_RUNS} on are those that runs are judged by",
            )
        require_non_negative(self.analytic, "memory", "checkpoint")
        require_non_negative(self.tqc, "dropped")
        if self.tqc.dropped >= self.tqc.quantiles:
            raise ParameterError("dropped", self.tqc.dropped, "must leave a quantile of each critic")
        if not 0.0 <= (share := self.ppo.critic_first) < 1.0:
            raise ParameterError("critic_first", share, "is a share of the run: 0 or more, below 1")
        if self.analytic.warmup >= 1.0:
            raise ParameterError("warmup", self.analytic.warmup, "is a share of the run: below 1")
        for options in every:
            if not 0.0 < options.authority <= 1.0:
                raise ParameterError("authority", options.authority, "must lie above 0 and not above 1")
        if self.mirrored and self.remembers:
            raise ParameterError("mirrored", True, "a policy with a memory would need two: leave it out")
        if not self.hidden or min(self.hidden) < 1:
            raise ParameterError("hidden", self.hidden, "give the width of each layer, e.g. 64 64")

    @property
    def chosen(self) -> Options:
        """The options of the algorithm in use."""
        options: Options = getattr(self, self.algorithm.replace("-", "_"))
        return options

    @property
    def remembers(self) -> bool:
        """Whether the policy has a memory."""
        recurrent = self.algorithm == "recurrent-ppo"
        return recurrent or (self.algorithm == "analytic" and self.analytic.memory > 0)

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


def config_of(values: object) -> TrainConfig:
    """Return the configuration that :meth:`TrainConfig.to_json` made these values of.

    Options that an older version did not have take their defaults.

    Raises
    ------
    ValueError
        If an option is unknown, missing, of another type or outside its range.
    """
    missing = [name for name in _ALWAYS if not isinstance(values, Mapping) or name not in values]
    if missing:
        raise ValueError(f"{described(missing)} not given")
    return typed(TrainConfig, values)


# What the configurations of every version hold: without one of these a file is none.
_ALWAYS = ("algorithm", "scenario", "ppo", "sac", "seed", "total_steps", "episode", "hidden")


def read_config(run: str | PathLike[str]) -> TrainConfig:
    """Return the configuration that a run directory holds.

    Raises
    ------
    RunDirectoryError
        If there is none, or it cannot be read, with the option at fault.
    """
    run = Path(run)
    values = read_json(run / CONFIG, RunDirectoryError, "configuration", largest=2**20)
    try:
        return config_of(values)
    except ValueError as error:
        beside = described([name for name in contents(run) if name != CONFIG]) or "nothing"
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
        reason = f"holds another configuration ({described(pairs)}): {remedy}"
        raise RunDirectoryError("run directory", str(run), reason)
    return stored
