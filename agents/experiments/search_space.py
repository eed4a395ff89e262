"""What a search may change about an experiment: typed ranges and choices that always make a valid run.

A range always holds the experiment's own value. A batch is given as the number of parts of a roll-out,
so that it divides the roll-out whatever else is drawn. What an experiment claims is not searched: one
that begins from nothing still does, and none is given a law that is the optimum already.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any, get_args

from agents.evaluation.bound import optimal_cost
from agents.experiments.recipes import ExperimentConfig
from agents.policies.base_law import base_law
from agents.policies.base_names import BaseLaw
from agents.seeds import MOST_RUNS
from agents.training.config import TrainConfig, config_of
from shake_env.errors import ParameterError, ShakeError

Value = float | int | str

TRAIN_SEED = MOST_RUNS - 1  # the last of a campaign's: most experiments never report a run with it
FEWEST_EVALUATIONS = 5  # of a trial: what a pruner and the choice of the best policy go by


@dataclass(frozen=True, kw_only=True)
class Range:
    """A number between two bounds, both possible."""

    name: str
    meaning: str  # with its unit
    low: float
    high: float
    logarithmic: bool = True
    whole: bool = False

    def __post_init__(self) -> None:
        if not self.low < self.high or (self.logarithmic and self.low <= 0.0):
            remedy = "low must lie below high, and above 0 where it is logarithmic"
            raise ParameterError(self.name, (self.low, self.high), remedy)

    def holding(self, value: float) -> Range:
        """Return this range, wide enough for `value`."""
        return replace(self, low=min(self.low, value), high=max(self.high, value))

    def tidy(self, value: float) -> Value:
        """Return a number as it is used: whole, or to three digits, which no training can tell apart."""
        return round(value) if self.whole else float(f"{value:.3g}")

    def suggest(self, trial: Any) -> Value:
        """Return what an Optuna trial draws."""
        if self.whole:
            low, high = int(self.low), int(self.high)
            return int(trial.suggest_int(self.name, low, high, log=self.logarithmic))
        return self.tidy(trial.suggest_float(self.name, self.low, self.high, log=self.logarithmic))


@dataclass(frozen=True, kw_only=True)
class Choice:
    """One of some values."""

    name: str
    meaning: str
    values: tuple[Value, ...]

    def holding(self, value: Value) -> Choice:
        """Return this choice with `value` among its values, numbers in order."""
        every = {*self.values, value}
        return replace(self, values=tuple(sorted(every, key=lambda v: (isinstance(v, str), v))))

    def tidy(self, value: Value) -> Value:
        """Return the value as it is used."""
        return value

    def suggest(self, trial: Any) -> Value:
        """Return what an Optuna trial draws."""
        drawn: Value = trial.suggest_categorical(self.name, self.values)
        return drawn


Knob = Range | Choice

_RATE = Range(name="learning_rate", meaning="learning rate [-]", low=1e-4, high=3e-3)
_RESIDUAL = Range(
    name="residual_scale", meaning="residual scale [fraction of the current limit]", low=0.02, high=1.0
)
_SHORT = Range(name="discount_horizon", meaning="discount horizon [s]", low=0.05, high=2.0)
_EXPLORATION = Range(
    name="log_std_init",
    meaning="log of initial exploration [-]",
    low=-4.0,
    high=-1.0,
    logarithmic=False,
)
_ENTROPY = Range(
    name="target_entropy", meaning="target entropy [nats]", low=-6.0, high=-1.0, logarithmic=False
)
_UPDATES = Range(
    name="gradient_steps", meaning="gradient steps a period [-]", low=4, high=32, whole=True
)
_PROXIMAL: tuple[Knob, ...] = (
    replace(_RATE, low=5e-5, high=2e-3),
    _SHORT,
    _EXPLORATION,
    Range(
        name="gae_lambda", meaning="lambda of the advantage [-]", low=0.8, high=0.99, logarithmic=False
    ),
    Range(name="clip_range", meaning="clip range [-]", low=0.1, high=0.4, logarithmic=False),
    Choice(name="n_steps", meaning="roll-out [periods]", values=(64, 128, 256)),
    Choice(name="minibatches", meaning="parts of a roll-out [-]", values=(1, 2, 4, 8, 16)),
    _RESIDUAL,
)
_SOFT: tuple[Knob, ...] = (replace(_RATE, high=2e-3), _SHORT, _RESIDUAL, _UPDATES, _ENTROPY)
_SPACES: dict[str, tuple[Knob, ...]] = {
    "apg": (
        _RATE,
        replace(_SHORT, low=0.5, high=20.0),
        Range(name="rollout_horizon", meaning="rollout horizon [periods]", low=32, high=384, whole=True),
        Range(name="max_grad_norm", meaning="bound on the gradient [-]", low=2.0, high=200.0),
        Choice(name="n_envs", meaning="environments in parallel [-]", values=(32, 64, 128, 256)),
        _RESIDUAL,
        Choice(name="gru_hidden_size", meaning="width of the memory [-]", values=(32, 64, 96)),
    ),
    "dagger": (
        _RATE,
        Range(name="n_epochs", meaning="passes over the labels [-]", low=2, high=16, whole=True),
        replace(_RESIDUAL, low=0.01),
        Choice(name="gru_hidden_size", meaning="width of the memory [-]", values=(32, 64, 96)),
    ),
    "ppo": _PROXIMAL,
    "recurrent-ppo": _PROXIMAL,
    "sac": _SOFT,
    "tqc": _SOFT,
    "td3": (
        *_SOFT[:-1],
        Range(
            name="action_noise_std",
            meaning="action noise [fraction of the residual scale]",
            low=0.02,
            high=0.5,
        ),
    ),
}


def own_values(experiment: ExperimentConfig) -> dict[str, Value]:
    """Return an experiment's own value of everything that a search may change about it."""
    config, chosen = experiment.config, experiment.config.chosen
    values: dict[str, Value] = {}
    for knob in _SPACES[config.algorithm]:
        if knob.name == "discount_horizon":
            values[knob.name] = config.lookahead
        elif knob.name == "minibatches":
            samples = chosen.n_envs * chosen.n_steps  # type: ignore[union-attr]
            values[knob.name] = samples // chosen.batch_size  # type: ignore[union-attr]
        else:
            values[knob.name] = getattr(chosen, knob.name)
    if not values.get("gru_hidden_size", 1):
        del values["gru_hidden_size"]  # a policy without one is another kind of policy
    values["base_controller"] = chosen.base_controller
    if chosen.base_controller == "none":
        del values[
            "residual_scale"
        ]  # of the whole current: less than all of it only takes from the policy
    return values


def search_space(experiment: ExperimentConfig) -> tuple[Knob, ...]:
    """Return the search space of an experiment: what may change, each with its own value in it."""
    own = own_values(experiment)
    knobs = [
        knob.holding(own[knob.name])  # type: ignore[arg-type]  # a range's own value is a number
        for knob in _SPACES[experiment.config.algorithm]
        if knob.name in own
    ]
    if "minibatches" in own:
        knobs = _dividing(knobs, experiment.config.chosen.n_envs, int(own["minibatches"]))
    if len(laws := suitable_laws(experiment)) > 1:
        knobs.append(Choice(name="base_controller", meaning="base controller", values=laws))
    return tuple(knobs)


def _dividing(knobs: Sequence[Knob], tables: int, parts: int) -> list[Knob]:
    """Keep the roll-out lengths that the experiment's own number of parts divides, then vice versa."""
    dividing = []
    lengths: tuple[Value, ...] = ()
    for knob in knobs:
        if isinstance(knob, Choice) and knob.name == "n_steps":
            lengths = tuple(n for n in knob.values if tables * int(n) % parts == 0)
            knob = replace(knob, values=lengths)
        elif isinstance(knob, Choice) and knob.name == "minibatches":
            fits = (p for p in knob.values if all(tables * int(n) % int(p) == 0 for n in lengths))
            knob = replace(knob, values=tuple(fits))
        dividing.append(knob)
    return dividing


@lru_cache(maxsize=32)  # a law behind an estimator takes a second to design
def suitable_laws(experiment: ExperimentConfig) -> tuple[BaseLaw, ...]:
    """Return the laws that an experiment's policy could correct, its own among them.

    Only its own where it begins from nothing, which is a claim about the algorithm. Where there is an
    analytic optimum the laws that reach it are left out: nothing would be learned.
    """
    chosen, scenario = experiment.config.chosen, experiment.config.scenario.build()
    if chosen.base_controller == "none":
        return ("none",)
    optimal = optimal_cost(scenario) is not None
    laws: list[BaseLaw] = []
    for law in get_args(BaseLaw):
        if law == "none" or (optimal and law != "flow" and law != chosen.base_controller):
            continue
        try:
            base_law(law, scenario)
        except ShakeError:
            continue  # it needs what the scenario does not show
        laws.append(law)
    return tuple(laws)


def trial_config(experiment: ExperimentConfig, values: Mapping[str, Value], share: float) -> TrainConfig:
    """Return the run of one trial: the experiment with these values, for a share of its steps.

    The learning rate's decay and warm-up, which go by shares of a run, shrink with it.

    Raises
    ------
    ParameterError
        If the share is not within (0, 1], or leaves no step after the algorithm's warm-up.
    """
    if not 0.0 < share <= 1.0:
        raise ParameterError("share", share, "is a share of the experiment's steps: above 0, at most 1")
    config, own = experiment.with_seed(TRAIN_SEED), dict(values)
    steps = math.ceil(share * config.steps)
    warmup = getattr(config.chosen, "learning_starts", 0)
    if steps <= warmup:
        remedy = f"a trial of {steps} steps ends within the {warmup} that run before the first gradient:"
        raise ParameterError("share", share, f"{remedy} above {warmup / config.steps:.2g}")
    horizon = float(own.pop("discount_horizon", config.lookahead))
    if parts := own.pop("minibatches", None):
        tables = own.get("n_envs", config.chosen.n_envs)
        rollout = own.get("n_steps", getattr(config.chosen, "n_steps", 1))
        own["batch_size"] = int(tables) * int(rollout) // int(parts)
    options = replace(config.chosen, **own)  # type: ignore[arg-type]
    changed: dict[str, Any] = {
        config.algorithm.replace("-", "_"): options,
        "discount_horizon": horizon,
        "total_timesteps": steps,
        "evaluations": max(FEWEST_EVALUATIONS, round(share * config.evaluations)),
    }
    return replace(config, **changed)


def search_space_json(knobs: Sequence[Knob]) -> list[dict[str, Any]]:
    """Return a search space as plain JSON values."""
    return [
        {**asdict(k), "values": list(k.values)} if isinstance(k, Choice) else asdict(k) for k in knobs
    ]


def search_space_of(rows: Sequence[Mapping[str, Any]]) -> tuple[Knob, ...]:
    """Return the search space that :func:`search_space_json` made these values of."""
    return tuple(
        Choice(**{**row, "values": tuple(row["values"])}) if "values" in row else Range(**row)
        for row in rows
    )


@dataclass(frozen=True, kw_only=True)
class Search:
    """What decides a search.

    Raises
    ------
    ParameterError
        If a number is outside its range.
    """

    experiment: ExperimentConfig
    share: float = 0.3
    """Share of the experiment's steps that a trial trains for."""
    seed: int = 0
    """Of what is drawn."""
    earthquakes: int = 64
    """Validation earthquakes that a trial is judged on."""

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ParameterError("seed", self.seed, "must be at least 0")
        if self.earthquakes < 1:
            raise ParameterError("earthquakes", self.earthquakes, "must be at least 1")
        trial_config(self.experiment, {}, self.share)

    @property
    def name(self) -> str:
        """Name of the study, and of the folder of its runs."""
        return f"{self.experiment.name}/share{self.share:g}-seed{self.seed}-tests{self.earthquakes}"

    def identity(self) -> str:
        """Return everything that decides a trial, so that no search mixes two kinds of them."""
        config = trial_config(self.experiment, {}, self.share).to_json()
        return json.dumps([config, search_space_json(search_space(self.experiment))])

    def same(self, identity: str) -> bool:
        """Return whether that is this search's; options that it does not know have their defaults."""
        try:
            (one, space_one), (two, space_two) = json.loads(identity), json.loads(self.identity())
            return space_one == space_two and config_of(one) == config_of(two)
        except ValueError:  # a configuration of another version
            return False
