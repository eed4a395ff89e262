"""The tables that a run trains on, and the scenario that they follow."""

from __future__ import annotations

from dataclasses import replace

from agents.learning.training_scenario import make_training_scenario, reward_scale
from agents.learning.vec_env import ShakeTableVecEnv
from agents.policies.base_law import at_own_cost, base_law
from agents.seeds import RUN_SEEDS
from agents.training.artificial_motions import artificial_motions
from agents.training.config import TrainConfig
from shake_env.motion.targets import FilteredNoise, MotionSet
from shake_env.scenario.scenario import Scenario


def training_scenario(config: TrainConfig, scenario: Scenario) -> Scenario:
    """Return the training scenario: shortened episodes and a tighter bound on the scaled state."""
    made = make_training_scenario(
        scenario,
        horizon=config.lookahead,
        duration=config.episode_duration,
        state_limit=config.state_limit,
    )
    if isinstance(made.motion, FilteredNoise) and config.num_artificial_motions:
        others = artificial_motions(scenario, config.num_artificial_motions, config.seed * RUN_SEEDS)
        made = replace(made, motion=MotionSet((*[made.motion] * config.num_artificial_motions, *others)))
    return made


def training_tables(config: TrainConfig, scenario: Scenario) -> ShakeTableVecEnv:
    """Return the tables that a run trains on, with the law that its policy corrects."""
    chosen = config.chosen
    return ShakeTableVecEnv(
        training_scenario(config, scenario),
        chosen.n_envs,
        base=base_law(chosen.base_controller, scenario, at_own_cost(scenario, config.scenario.scenario)),
        authority=chosen.residual_scale,
        reward_scale=reward_scale(scenario, config.discount(scenario.control_period)),
    )
