"""The tables that a run trains on, and the scenario that they follow."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from agents.learning.asymmetric import AsymmetricVecEnv
from agents.learning.paired import PairedVecEnv
from agents.learning.training_scenario import make_training_scenario, reward_scale
from agents.learning.vec_env import ShakeTableVecEnv
from agents.policies.base_law import at_own_cost, base_law
from agents.policies.estimated_law import EstimatedLaw
from agents.policies.policy_file import LAW, PolicyFile
from agents.seeds import RUN_SEEDS
from agents.training.algorithm_options import ProximalOptions
from agents.training.artificial_motions import artificial_motions
from agents.training.config import TrainConfig
from shake_env.motion.targets import FilteredNoise, MotionSet, whole_periods
from shake_env.scenario.scenario import Scenario

TrainingTables = ShakeTableVecEnv | PairedVecEnv


def training_scenario(config: TrainConfig, scenario: Scenario) -> Scenario:
    """Return the training scenario: shortened episodes and a tighter bound on the scaled state.

    Raises
    ------
    ParameterError
        If an episode is shorter than one control period.
    """
    made = make_training_scenario(
        scenario,
        horizon=config.lookahead,
        duration=config.episode_duration,
        state_limit=config.state_limit,
    )
    if isinstance(made.motion, FilteredNoise):
        whole_periods(config.episode_duration, made.control_period, "episode_duration")
    if isinstance(made.motion, FilteredNoise) and config.num_artificial_motions:
        others = artificial_motions(scenario, config.num_artificial_motions, config.seed * RUN_SEEDS)
        made = replace(made, motion=MotionSet((*[made.motion] * config.num_artificial_motions, *others)))
    return made


def training_tables(
    config: TrainConfig, scenario: Scenario, first: PolicyFile | None = None
) -> TrainingTables:
    """Return the tables that a run trains on, with the law that its policy corrects.

    A run that goes on from the policy `first`, which corrects the law of the same name, corrects that
    policy's own law: the values that are tuned for it may have changed since.
    """
    chosen = config.chosen
    paired, gain = getattr(chosen, "paired", False), getattr(chosen, "reward_gain", 1.0)
    kind = AsymmetricVecEnv if getattr(chosen, "asymmetric_critic", False) else ShakeTableVecEnv
    tables = kind(
        training_scenario(config, scenario),
        chosen.n_envs * (2 if paired else 1),
        base=_kept_law(config, scenario, first)
        or base_law(chosen.base_controller, scenario, at_own_cost(scenario, config.scenario.scenario)),
        authority=chosen.residual_scale,
        reward_scale=gain * reward_scale(scenario, config.discount(scenario.control_period)),
    )
    if not paired:
        return tables
    if isinstance(chosen, ProximalOptions):
        return PairedVecEnv(tables, interval=chosen.n_steps)
    return PairedVecEnv(tables, against="base")


def _kept_law(config: TrainConfig, scenario: Scenario, first: PolicyFile | None) -> EstimatedLaw | None:
    """Return the law behind an estimator of a policy, if it has one of the configuration's name."""
    if first is None or first.law is None or first.observation_size != scenario.observation.size:
        return None
    trained = first.card.get("config", {})
    options = trained.get(str(trained.get("algorithm")).replace("-", "_"), {})
    if options.get("base_controller") != config.chosen.base_controller:
        return None
    arrays: dict[str, Any] = {name: np.asarray(getattr(first.law, name), float) for name in LAW}
    return replace(first.law, **arrays)


def base_tables(env: TrainingTables) -> ShakeTableVecEnv:
    """Return the tables themselves, and behind them their shadows where they are paired."""
    return env.tables if isinstance(env, PairedVecEnv) else env
