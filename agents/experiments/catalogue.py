"""The experiments: a training configuration for each scenario and algorithm.

An experiment is the algorithm's defaults (see `config`) with as few deviations as its scenario needs,
each with its reason. Minutes are for planning: one process on one core, from the rate of its first
updates.
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
    SACOptions,
    TD3Options,
    TQCOptions,
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


def _experiment(
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
_WHOLE: dict[str, Any] = {"episode_duration": 15.0, "evaluation_earthquakes": 128}
_EARLY = ("limits.soft_share=0.7", "limits.soft_weight=0.02")
# Besides, artificial earthquakes that use the whole stroke; a soft limit covers its last fifth.
_STROKE: dict[str, Any] = {
    "episode_duration": 15.0,
    "num_artificial_motions": 24,
    "evaluation_earthquakes": 64,
}
_SOFT = ("limits.soft_share=0.8", "limits.soft_weight=0.05")
_WHOLE_NOISE = (
    "episodes as long as the test: without a displacement weight a table drifts further in them"
)
_LESS_NOISE = "four times the roll-out: the rest above the optimum is gradient noise"
_LONG = "as many steps as fit in a quarter of an hour"
_NO_SIDES = "odd symmetry: a table has no preferred direction"
_EXPLORES_LITTLE = (
    f"a residual of at most a fiftieth of the current, which bounds the exploration; {_NO_SIDES}"
)
_BIASES = "biases: friction and limits do not scale with the motion"
_BIASED = APGOptions(actor_bias=True)


_OFF_POLICY: tuple[tuple[Literal["sac", "td3", "tqc"], float], ...] = (
    ("sac", 5.0), ("td3", 3.0), ("tqc", 5.0),
)  # fmt: skip


def _correction(memory: int = 0, authority: float = 0.2) -> APGOptions:
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
_SMALL = 0.02
# A correction learns to use the stroke; a cost from its middle on teaches it in time.
_HALF = ("limits.soft_share=0.5", "limits.soft_weight=0.05")


def _paired(
    evaluation_task: str, minutes: float, usual: dict[str, Any], label: str | None = None
) -> ExperimentConfig:
    """Return the experiment of PPO for the same correction, by paired roll-outs.

    Unpaired, the earthquakes' share of a return's variance hides what an action does. Roll-outs of
    1.3 s and a lambda of 0.99 count the drift that a correction causes.
    """
    options = PPOOptions(
        base_controller="lqg-searched", residual_scale=_SMALL, actor_bias=True, direct_path=True,
        paired=True, n_envs=128, n_steps=256, batch_size=8192, n_epochs=4, learning_rate=2e-4,
        gae_lambda=0.99,
    )  # fmt: skip
    config = TrainConfig(
        ppo=options, odd_symmetry=True, discount_horizon=2.0, total_timesteps=1_507_328, **usual
    )
    why = f"paired roll-outs without a critic; {_EXPLORES_LITTLE}"
    return _experiment(evaluation_task, config, minutes, why, label, otherwise=_HALF)


def _paired_with_memory(evaluation_task: str) -> ExperimentConfig:
    """Return the experiment of PPO with a memory for the same correction of an uncertain table."""
    options = RecurrentPPOOptions(
        base_controller="lqg-searched", residual_scale=_SMALL, paired=True, n_envs=128, n_steps=256,
        batch_size=8192, n_epochs=4, gae_lambda=0.99,
    )  # fmt: skip
    config = TrainConfig(
        algorithm="recurrent-ppo",
        recurrent_ppo=options,
        discount_horizon=2.0,
        total_timesteps=1_507_328,
        **_STROKE,
    )
    why = "an LSTM for the uncertain plant; paired roll-outs without a critic"
    return _experiment(evaluation_task, config, 6.0, why, otherwise=_HALF)


def _gradients_with_memory(evaluation_task: str, minutes: float) -> ExperimentConfig:
    """Return the experiment of the analytic gradient with a memory, over drawn plants."""
    options = _correction(memory=64, authority=0.1)
    config = TrainConfig(algorithm="apg", apg=options, total_timesteps=6_144_000, **_STROKE)
    why = "a memory: the drawn plant shows in past responses, not in one observation"
    return _experiment(evaluation_task, config, minutes, why, otherwise=_SOFT)


def _distilled(
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
    return _experiment(evaluation_task, config, minutes, why, otherwise=_EARLY)


# The plan's correction is larger where the nominal model is wrong, and differs from plant to plant.
_INFORMED = DaggerOptions(teacher="nmpc-informed", gru_hidden_size=64, residual_scale=0.1, n_envs=32)


def _gradients_from_imitation(
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
    return _experiment(evaluation_task, config, minutes, why, label=label, otherwise=soft)


def _gradients_from_nothing(evaluation_task: str, learning_rate: float) -> ExperimentConfig:
    """Return the experiment of the analytic gradient for a linear table that is seen in full."""
    options = APGOptions(n_envs=64, rollout_horizon=192, learning_rate=learning_rate)
    config = TrainConfig(algorithm="apg", apg=options, episode_duration=20.0, total_timesteps=15_728_640)
    why = f"windows of a second, whose truncation costs half a percent less; {_WHOLE_NOISE}"
    return _experiment(evaluation_task, config, 3.0, why)


def _ppo_from_nothing(
    evaluation_task: str, minutes: float, horizon: float = 0.3, *, biases: bool = False
) -> ExperimentConfig:
    """Return the experiment of PPO for a table that is seen in full, which looks `horizon` [s] ahead."""
    options = PPOOptions(n_envs=256, batch_size=8192, n_epochs=6, actor_bias=biases)
    config = TrainConfig(
        ppo=options, discount_horizon=horizon, total_timesteps=24_000_000, odd_symmetry=True
    )
    reasons = [_BIASES] if biases else []
    return _experiment(evaluation_task, config, minutes, "; ".join([*reasons, _LESS_NOISE, _NO_SIDES]))


EXPERIMENTS: tuple[ExperimentConfig, ...] = (
    _gradients_from_nothing("linear", 8e-4),
    # Windows of a second truncate 0.6 % of the cost, of two seconds 0.2 %; those take twice as long for
    # an update, of which a run from random weights needs a thousand.
    _experiment(
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
    _ppo_from_nothing("linear", 7.0),
    _experiment("linear", TrainConfig(algorithm="sac", total_timesteps=700_000), 12.0, _LONG),
    _experiment(
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
        f"small residual, large exploration, large step, found by a search; {_NO_SIDES}",
    ),
    _experiment(
        "linear",
        TrainConfig(algorithm="tqc", total_timesteps=500_000, odd_symmetry=True),
        12.0,
        f"{_LONG}; {_NO_SIDES}",
    ),
    _experiment("linear", TrainConfig(algorithm="recurrent-ppo"), 6.0),
    # With the printed equations a horizon of 0.3 s costs 3.4 %, of half a second 1.4 %
    # (`agents.studies.finite_horizon`).
    _gradients_from_nothing("as-printed", 4e-4),
    _ppo_from_nothing("as-printed", 7.0, 0.5),
    _experiment("friction", TrainConfig(algorithm="apg", apg=_BIASED), 6.0, _BIASES),
    _experiment(
        "friction",
        TrainConfig(algorithm="apg", apg=_BIASED),
        6.0,
        f"force weight 2.5, which hardly changes the cost; {_BIASES}",
        label="apg-force",
        otherwise=("objective.force_weight=2.5",),
    ),
    _ppo_from_nothing("friction", 7.0, biases=True),
    # The teacher is told the friction. Its correction of LQR is 0.4 % of the current's range, and turns
    # about within a control period, which gradients from random weights do not find.
    _experiment(
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
    _experiment(
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
    _experiment(
        "friction-coarse",
        TrainConfig(algorithm="apg", apg=replace(_BIASED, learning_rate=3e-4)),
        2.0,
        f"{_BIASES}; a third of the step: gradients through coarse steps are large",
    ),
    _ppo_from_nothing("friction-coarse", 5.0, biases=True),
    _experiment(
        "laboratory",
        TrainConfig(
            algorithm="apg", apg=_correction(authority=0.3), total_timesteps=6_144_000, **_WHOLE
        ),
        4.0,
        "corrects the law of `lqg-searched`",
        otherwise=_EARLY,
    ),
    _experiment(
        "laboratory",
        TrainConfig(algorithm="apg", apg=_correction(), total_timesteps=6_144_000, **_STROKE),
        5.0,
        "force weight 30, since the specimen's response depends on the force alone; artificial motions "
        "that use the whole stroke",
        label="apg-force",
        otherwise=("objective.force_weight=30", *_SOFT),
    ),
    _paired("laboratory", 1.5, _WHOLE),
    _paired("laboratory", 2.0, _STROKE, "ppo-stroke"),
    # The plan's friction and orifice show in past signals: with a memory a third of the labels suffice.
    _distilled("laboratory", 12.0, DaggerOptions(gru_hidden_size=64, n_envs=32)),
    # The action moves by a share of the residual scale, a tenth of that of `apg`, at each step.
    _gradients_from_imitation(
        "laboratory",
        9.0,
        replace(_correction(memory=64, authority=0.03), learning_rate=5e-4),
        {**_WHOLE, "total_timesteps": 4_915_200, "evaluations": 8},
        _EARLY,
    ),
    _gradients_with_memory("unknown-specimen", 7.0),
    _paired("unknown-specimen", 3.0, _STROKE),
    _paired_with_memory("unknown-specimen"),
    _distilled("unknown-specimen", 12.0, _INFORMED),
    _gradients_from_imitation(
        "unknown-specimen",
        7.0,
        _correction(memory=64, authority=0.1),
        {**_STROKE, "total_timesteps": 4_915_200, "evaluations": 8},
        _SOFT,
    ),
    _gradients_with_memory("field", 9.0),
    _paired_with_memory("field"),
    _distilled("field", 15.0, _INFORMED),
    _gradients_from_imitation(
        "field",
        12.0,
        _correction(memory=64, authority=0.1),
        {**_STROKE, "total_timesteps": 6_144_000, "evaluations": 10},
        _SOFT,
    ),
    # Its cost was still falling: three times as long again, with a larger step.
    _gradients_from_imitation(
        "field",
        30.0,
        replace(_correction(memory=64, authority=0.1), learning_rate=5e-4),
        {**_STROKE, "total_timesteps": 18_432_000, "evaluations": 12},
        _SOFT,
        "dagger-apg",
        "dagger-apg-long",
    ),
    _experiment(
        "yielding",
        TrainConfig(
            algorithm="apg", apg=_correction(authority=0.3), total_timesteps=4_915_200, **_WHOLE
        ),
        4.0,
        "corrects the law of `lqg-searched`",
        otherwise=_EARLY,
    ),
    _paired("yielding", 2.0, _WHOLE),
    _distilled("yielding", 9.0),
    # The realistic scenario that shows the whole state. Without a base controller a critic has learned
    # nothing useful before the tables reach their limits.
    *(
        _experiment(
            "yielding",
            TrainConfig(
                algorithm=algorithm,
                sac=SACOptions(base_controller="lqg-searched", residual_scale=_SMALL),
                td3=TD3Options(base_controller="lqg-searched", residual_scale=_SMALL),
                tqc=TQCOptions(base_controller="lqg-searched", residual_scale=_SMALL),
                odd_symmetry=True,
                **_WHOLE,
            ),
            minutes,
            _EXPLORES_LITTLE,
            otherwise=_EARLY,
        )
        for algorithm, minutes in _OFF_POLICY
    ),
)
