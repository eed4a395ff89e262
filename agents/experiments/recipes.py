"""Recipes: what an experiment is, and how the experiments of one kind are configured.

A recipe gives the options that its kind of training needs in every scenario, each with its reason; the
catalogue names the scenarios.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

from agents.experiments.evaluation_tasks import EVALUATION_TASKS
from agents.seeds import MOST_RUNS
from agents.training.algorithm_options import (
    APGOptions,
    DaggerOptions,
    PPOOptions,
    RecurrentPPOOptions,
)
from agents.training.config import TrainConfig
from shake_env.errors import ParameterError


@dataclass(frozen=True, kw_only=True)
class ExperimentConfig:
    """One configuration of a campaign, to be run with several seeds."""

    evaluation_task: str
    config: TrainConfig
    minutes: float  # expected, of one run
    seeds: int = 5
    label: str | None = None  # where an algorithm has several experiments in one evaluation task
    why: str = "the algorithm's defaults"

    @property
    def name(self) -> str:
        """``SCENARIO/ALGORITHM``."""
        return f"{self.evaluation_task}/{self.label or self.config.algorithm}"

    def with_seed(self, seed: int) -> TrainConfig:
        """Return the configuration of one run.

        Raises
        ------
        ParameterError
            If the seed's earthquakes would reach those that policies are evaluated on.
        """
        if not 0 <= seed < MOST_RUNS:
            raise ParameterError("seed", seed, f"a campaign has seeds 0 to {MOST_RUNS - 1}")
        return replace(self.config, seed=seed)


def experiment(
    evaluation_task: str,
    config: TrainConfig,
    minutes: float,
    why: str = "",
    label: str | None = None,
    otherwise: tuple[str, ...] = (),
) -> ExperimentConfig:
    """Return an experiment; `otherwise` are fields in which training differs from the test."""
    options = next(each.options for each in EVALUATION_TASKS if each.name == evaluation_task)
    config = replace(config, scenario=replace(options, set=(*options.set, *otherwise)))
    default = "the algorithm's defaults"
    return ExperimentConfig(
        evaluation_task=evaluation_task, config=config, minutes=minutes, why=why or default, label=label
    )


# The whole of a laboratory's envelope: rise, strong part and decay. The kept policy is chosen on many
# earthquakes, since failures are rare; a soft limit covers the last part of the stroke.
WHOLE: dict[str, Any] = {"episode_duration": 15.0, "evaluation_earthquakes": 128}
EARLY = ("limits.soft_share=0.7", "limits.soft_weight=0.02")
# Besides, artificial earthquakes that use the whole stroke; a soft limit covers its last fifth.
STROKE: dict[str, Any] = {
    "episode_duration": 15.0,
    "num_artificial_motions": 24,
    "evaluation_earthquakes": 64,
}
SOFT = ("limits.soft_share=0.8", "limits.soft_weight=0.05")
WHOLE_NOISE = (
    "episodes as long as the test: without a displacement weight a table drifts further in them"
)
LESS_NOISE = "four times the roll-out: the rest above the optimum is gradient noise"
LONG = "as many steps as fit in a quarter of an hour"
NO_SIDES = "odd symmetry: a table has no preferred direction"
EXPLORES_LITTLE = (
    f"a residual of at most a fiftieth of the current, which bounds the exploration; {NO_SIDES}"
)
BIASES = "biases: friction and limits do not scale with the motion"
BIASED = APGOptions(actor_bias=True)


OFF_POLICY: tuple[tuple[Literal["sac", "td3", "tqc"], float], ...] = (
    ("sac", 5.0), ("td3", 3.0), ("tqc", 5.0),
)  # fmt: skip


def correction(memory: int = 0, authority: float = 0.2) -> APGOptions:
    """Return the analytic gradient's options to correct `lqg-searched` on a table with a stroke.

    Windows of 1.3 s outlast the drift that a correction causes; a larger step, or windows of half a
    second, drive tables to the stroke's end.
    """
    return APGOptions(
        base_controller="lqg-searched", residual_scale=authority, learning_rate=2e-4,
        rollout_horizon=256, n_envs=64, gru_hidden_size=memory, actor_bias=True,
    )  # fmt: skip


# What gradients correct is 0.15 to 0.6 % of the current's range (rms). Exploration is a share of the
# authority, and with a tenth of the range it alone would be more than that.
SMALL = 0.02
# A correction learns to use the stroke; a cost from its middle on teaches it in time.
HALF = ("limits.soft_share=0.5", "limits.soft_weight=0.05")


def paired(
    evaluation_task: str, minutes: float, usual: dict[str, Any], label: str | None = None
) -> ExperimentConfig:
    """Return the experiment of PPO for the same correction, by paired roll-outs.

    Unpaired, the earthquakes' share of a return's variance hides what an action does. Roll-outs of
    1.3 s and a lambda of 0.99 count the drift that a correction causes.
    """
    options = PPOOptions(
        base_controller="lqg-searched", residual_scale=SMALL, actor_bias=True, direct_path=True,
        paired=True, n_envs=128, n_steps=256, batch_size=8192, n_epochs=4, learning_rate=2e-4,
        gae_lambda=0.99,
    )  # fmt: skip
    config = TrainConfig(
        ppo=options, odd_symmetry=True, discount_horizon=2.0, total_timesteps=1_507_328, **usual
    )
    why = f"paired roll-outs without a critic; {EXPLORES_LITTLE}"
    return experiment(evaluation_task, config, minutes, why, label, otherwise=HALF)


def paired_with_memory(evaluation_task: str) -> ExperimentConfig:
    """Return the experiment of PPO with a memory for the same correction of an uncertain table."""
    options = RecurrentPPOOptions(
        base_controller="lqg-searched", residual_scale=SMALL, paired=True, n_envs=128, n_steps=256,
        batch_size=8192, n_epochs=4, gae_lambda=0.99,
    )  # fmt: skip
    config = TrainConfig(
        algorithm="recurrent-ppo",
        recurrent_ppo=options,
        discount_horizon=2.0,
        total_timesteps=1_507_328,
        **STROKE,
    )
    why = "an LSTM for the uncertain plant; paired roll-outs without a critic"
    return experiment(evaluation_task, config, 6.0, why, otherwise=HALF)


def gradients_with_memory(evaluation_task: str, minutes: float) -> ExperimentConfig:
    """Return the experiment of the analytic gradient with a memory, over drawn plants."""
    options = correction(memory=64, authority=0.1)
    config = TrainConfig(algorithm="apg", apg=options, total_timesteps=6_144_000, **STROKE)
    why = "a memory: the drawn plant shows in past responses, not in one observation"
    return experiment(evaluation_task, config, minutes, why, otherwise=SOFT)


def distilled(
    evaluation_task: str, minutes: float, options: DaggerOptions | None = None
) -> ExperimentConfig:
    """Return the experiment of a policy that imitates the nonlinear plan."""
    config = TrainConfig(
        algorithm="dagger",
        dagger=options or DaggerOptions(),
        episode_duration=15.0,
        evaluation_earthquakes=64,
        evaluations=10,
        total_timesteps=960_000,
    )
    why = "imitates the plan at a seventh of its time; can start the analytic gradient"
    return experiment(evaluation_task, config, minutes, why, otherwise=EARLY)


# The plan's correction is larger where the nominal model is wrong, and differs from plant to plant.
INFORMED = DaggerOptions(teacher="nmpc-informed", gru_hidden_size=64, residual_scale=0.1, n_envs=32)


def gradients_from_imitation(
    evaluation_task: str,
    minutes: float,
    options: APGOptions,
    usual: dict[str, Any],
    soft: tuple[str, ...],
    first: str = "dagger",
    label: str = "dagger-apg",
) -> ExperimentConfig:
    """Return the experiment of the analytic gradient that goes on from an imitation."""
    config = TrainConfig(algorithm="apg", apg=options, init_policy=first, **usual)
    why = f"goes on from `{first}` on the cost itself"
    return experiment(evaluation_task, config, minutes, why, label=label, otherwise=soft)


def gradients_from_nothing(evaluation_task: str, learning_rate: float) -> ExperimentConfig:
    """Return the experiment of the analytic gradient for a linear table that is seen in full."""
    options = APGOptions(n_envs=64, rollout_horizon=192, learning_rate=learning_rate)
    config = TrainConfig(algorithm="apg", apg=options, episode_duration=20.0, total_timesteps=15_728_640)
    why = f"windows of a second, whose truncation costs half a percent less; {WHOLE_NOISE}"
    return experiment(evaluation_task, config, 3.0, why)


def ppo_from_nothing(
    evaluation_task: str, minutes: float, horizon: float = 0.3, *, biases: bool = False
) -> ExperimentConfig:
    """Return the experiment of PPO for a table that is seen in full, which looks `horizon` [s] ahead."""
    options = PPOOptions(n_envs=256, batch_size=8192, n_epochs=6, actor_bias=biases)
    config = TrainConfig(
        ppo=options, discount_horizon=horizon, total_timesteps=24_000_000, odd_symmetry=True
    )
    reasons = [BIASES] if biases else []
    return experiment(evaluation_task, config, minutes, "; ".join([*reasons, LESS_NOISE, NO_SIDES]))
