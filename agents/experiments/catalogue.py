"""The experiments: a training configuration for each scenario and algorithm.

An experiment is the algorithm's defaults (see `config`) with as few deviations as its scenario needs,
each with its reason. Minutes are for planning: one process on one core, from the rate of its first
updates.
"""

from __future__ import annotations

from dataclasses import replace

from agents.experiments.recipes import (
    BIASED,
    BIASES,
    EARLY,
    EXPLORES_LITTLE,
    INFORMED,
    LONG,
    NO_SIDES,
    OFF_POLICY,
    SMALL,
    SOFT,
    STROKE,
    WHOLE,
    ExperimentConfig,
    correction,
    distilled,
    experiment,
    gradients_from_imitation,
    gradients_from_nothing,
    gradients_with_memory,
    paired,
    paired_with_memory,
    ppo_from_nothing,
)
from agents.training.algorithm_options import (
    APGOptions,
    DaggerOptions,
    SACOptions,
    TD3Options,
    TQCOptions,
)
from agents.training.config import TrainConfig

EXPERIMENTS: tuple[ExperimentConfig, ...] = (
    gradients_from_nothing("linear", 8e-4),
    # Windows of a second truncate 0.6 % of the cost, of two seconds 0.2 %; those take twice as long for
    # an update, of which a run from random weights needs a thousand.
    experiment(
        "linear",
        TrainConfig(
            algorithm="apg",
            apg=APGOptions(n_envs=64, rollout_horizon=384, learning_rate=3e-4),
            init_policy="apg",
            episode_duration=20.0,
            total_timesteps=7_864_320,
        ),
        1.5,
        "goes on from `apg` with windows of two seconds",
        label="apg-long",
    ),
    ppo_from_nothing("linear", 7.0),
    experiment("linear", TrainConfig(algorithm="sac", total_timesteps=700_000), 12.0, LONG),
    experiment(
        "linear",
        TrainConfig(
            algorithm="td3",
            td3=TD3Options(
                residual_scale=0.06,
                action_noise_std=0.4,
                target_policy_noise=0.2,
                target_noise_clip=0.5,
                learning_rate=1e-3,
                gradient_steps=20,
            ),
            discount_horizon=0.6,
            total_timesteps=400_000,
            odd_symmetry=True,
        ),
        7.0,
        f"small residual, large exploration, large step, found by a search; {NO_SIDES}",
    ),
    experiment(
        "linear",
        TrainConfig(algorithm="tqc", total_timesteps=500_000, odd_symmetry=True),
        12.0,
        f"{LONG}; {NO_SIDES}",
    ),
    experiment("linear", TrainConfig(algorithm="recurrent-ppo"), 6.0),
    # With the printed equations a horizon of 0.3 s costs 3.4 %, of half a second 1.4 %
    # (`agents.studies.finite_horizon`).
    gradients_from_nothing("as-printed", 4e-4),
    ppo_from_nothing("as-printed", 7.0, 0.5),
    experiment("friction", TrainConfig(algorithm="apg", apg=BIASED), 6.0, BIASES),
    experiment(
        "friction",
        TrainConfig(algorithm="apg", apg=BIASED),
        6.0,
        f"force weight 2.5, which hardly changes the cost; {BIASES}",
        label="apg-force",
        otherwise=("objective.force_weight=2.5",),
    ),
    ppo_from_nothing("friction", 7.0, biases=True),
    # The teacher is told the friction. Its correction of LQR is 0.4 % of the current's range, and turns
    # about within a control period, which gradients from random weights do not find.
    experiment(
        "friction",
        TrainConfig(
            algorithm="dagger",
            dagger=DaggerOptions(
                teacher="lqr-friction-ff",
                base_controller="lqr",
                residual_scale=0.02,
                n_envs=64,
                batch_size=2048,
            ),
            episode_duration=15.0,
            evaluations=10,
            total_timesteps=1_920_000,
        ),
        3.0,
        "imitates the law that is told the friction",
    ),
    experiment(
        "friction",
        TrainConfig(
            algorithm="apg",
            apg=APGOptions(
                base_controller="lqr",
                residual_scale=0.02,
                actor_bias=True,
                n_envs=64,
                rollout_horizon=192,
                learning_rate=1e-4,
            ),
            init_policy="dagger",
            episode_duration=20.0,
            evaluations=10,
            total_timesteps=2_457_600,
        ),
        2.0,
        "goes on from `dagger` on the cost itself; a tenth of the step: the start is near the optimum",
        label="dagger-apg",
    ),
    experiment(
        "friction-coarse",
        TrainConfig(algorithm="apg", apg=replace(BIASED, learning_rate=3e-4)),
        2.0,
        f"{BIASES}; a third of the step: gradients through coarse steps are large",
    ),
    ppo_from_nothing("friction-coarse", 5.0, biases=True),
    experiment(
        "laboratory",
        TrainConfig(algorithm="apg", apg=correction(authority=0.3), total_timesteps=6_144_000, **WHOLE),
        4.0,
        "corrects the law of `lqg-searched`",
        otherwise=EARLY,
    ),
    experiment(
        "laboratory",
        TrainConfig(algorithm="apg", apg=correction(), total_timesteps=6_144_000, **STROKE),
        5.0,
        "force weight 30, since the specimen's response depends on the force alone; artificial motions "
        "that use the whole stroke",
        label="apg-force",
        otherwise=("objective.force_weight=30", *SOFT),
    ),
    paired("laboratory", 1.5, WHOLE),
    paired("laboratory", 2.0, STROKE, "ppo-stroke"),
    # The plan's friction and orifice show in past signals: with a memory a third of the labels suffice.
    distilled("laboratory", 12.0, DaggerOptions(gru_hidden_size=64, n_envs=32)),
    # The action moves by a share of the residual scale, a tenth of that of `apg`, at each step.
    gradients_from_imitation(
        "laboratory",
        9.0,
        replace(correction(memory=64, authority=0.03), learning_rate=5e-4),
        {**WHOLE, "total_timesteps": 4_915_200, "evaluations": 8},
        EARLY,
    ),
    gradients_with_memory("unknown-specimen", 7.0),
    paired("unknown-specimen", 3.0, STROKE),
    paired_with_memory("unknown-specimen"),
    distilled("unknown-specimen", 12.0, INFORMED),
    gradients_from_imitation(
        "unknown-specimen",
        7.0,
        correction(memory=64, authority=0.1),
        {**STROKE, "total_timesteps": 4_915_200, "evaluations": 8},
        SOFT,
    ),
    gradients_with_memory("field", 9.0),
    paired_with_memory("field"),
    distilled("field", 15.0, INFORMED),
    gradients_from_imitation(
        "field",
        12.0,
        correction(memory=64, authority=0.1),
        {**STROKE, "total_timesteps": 6_144_000, "evaluations": 10},
        SOFT,
    ),
    # Its cost was still falling: three times as long again, with a larger step.
    gradients_from_imitation(
        "field",
        30.0,
        replace(correction(memory=64, authority=0.1), learning_rate=5e-4),
        {**STROKE, "total_timesteps": 18_432_000, "evaluations": 12},
        SOFT,
        "dagger-apg",
        "dagger-apg-long",
    ),
    experiment(
        "yielding",
        TrainConfig(algorithm="apg", apg=correction(authority=0.3), total_timesteps=4_915_200, **WHOLE),
        4.0,
        "corrects the law of `lqg-searched`",
        otherwise=EARLY,
    ),
    paired("yielding", 2.0, WHOLE),
    distilled("yielding", 9.0),
    # The realistic scenario that shows the whole state. Without a base controller a critic has learned
    # nothing useful before the tables reach their limits.
    *(
        experiment(
            "yielding",
            TrainConfig(
                algorithm=algorithm,
                sac=SACOptions(base_controller="lqg-searched", residual_scale=SMALL),
                td3=TD3Options(base_controller="lqg-searched", residual_scale=SMALL),
                tqc=TQCOptions(base_controller="lqg-searched", residual_scale=SMALL),
                odd_symmetry=True,
                **WHOLE,
            ),
            minutes,
            EXPLORES_LITTLE,
            otherwise=EARLY,
        )
        for algorithm, minutes in OFF_POLICY
    ),
)
