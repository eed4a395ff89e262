"""Names of version 0.1 and what they are called now. The old ones work, with a warning, until 0.3.

One table for each kind of name; nothing else in the packages knows an old name.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping

LAST = "0.3"  # version that no longer knows the old names

CONTROLLERS = {
    "policy": "ppo",
    "analytic": "apg",
    "off-policy": "sac",
    "free": "lqg-searched",
    "free-force": "lqg-searched-force",
    "lqr-published": "lqr-continuous",
    "lqg-accommodating": "lqg-dac",
    "feedforward": "lqr-friction-ff",
    "robust": "h-infinity",
    "tvc-observer": "tvc-dob",
    "inverse": "inverse-ff",
    "inverse-feedback": "inverse-ff-tvc",
    "iteration": "tf-iteration",
    "learning": "ilc",
    "clairvoyant": "oracle",
}

_LAW = {"position": "displacement_tolerance", "doubt": "model_error_scale"}
# Free parameters, by the controller's present name.
TUNABLES: dict[str, dict[str, str]] = {
    "lqr-integral": {"position": "displacement_weight", "integral": "integral_weight"},
    "lqg-searched": {
        "acceleration": "acceleration_weight_scale",
        "effort": "current_weight_scale",
        "mass": "mass_scale",
        "frequency": "frequency_scale",
        "damping": "damping_scale",
        "position": "displacement_tolerance",
        "force": "force_error_scale",
        "flow": "flow_error_scale",
        "time": "error_time_scale",
        "accommodation": "disturbance_gain",
        "lateness": "delay_offset",
    },
    **dict.fromkeys(
        (
            "preview-lqr", "lqg", "lqg-dac", "lqr-friction-ff", "mpc", "multi-model", "h-infinity",
            "adaptive",
        ),
        _LAW,
    ),
}  # fmt: skip
TUNABLES["lqg-searched-force"] = TUNABLES["lqg-searched"]

# Training configuration: the fields of `TrainConfig`, and those of every algorithm's options.
CONFIG = {
    "analytic": "apg",
    "start": "init_policy",
    "total_steps": "total_timesteps",
    "horizon": "discount_horizon",
    "episode": "episode_duration",
    "artificial": "num_artificial_motions",
    "mirrored": "odd_symmetry",
    "hidden": "net_arch",
}
ALGORITHM = {
    "tables": "n_envs",
    "rollout_steps": "n_steps",
    "epochs": "n_epochs",
    "base": "base_controller",
    "authority": "residual_scale",
    "initial_log_std": "log_std_init",
    "scale_free": "actor_bias",
    "critic_first": "critic_warmup_fraction",
    "units": "lstm_hidden_size",
    "warmup_steps": "learning_starts",
    "exploration": "action_noise_std",
    "target_noise": "target_policy_noise",
    "quantiles": "n_quantiles",
    "critics": "n_critics",
    "dropped": "top_quantiles_to_drop_per_net",
    "window": "rollout_horizon",
    "warmup": "lr_warmup_fraction",
    "memory": "gru_hidden_size",
    "checkpoint": "checkpoint_segment_length",
}
INVERTED = "scale_free"  # its present name says the opposite
EXPERIMENTS = {"analytic": "apg", "analytic-force": "apg-force"}  # behind a scenario and a slash

COMMANDS = {
    "bench": "benchmark",
    "campaign": "run-experiments",
    "recipe-search": "tune-training",
    "card": "model-card",
    "components": "plot-components",
    "results": "update-docs",
    "scenario": "show-scenario",
    "watch": "play",
    "validate": "validate-transients",
}
# Options, by the command's present name.
OPTIONS = {
    "benchmark": {"again": "rerun"},
    "compare": {"noise": "num-noise-motions", "supervised": "safety-supervisor"},
    "robustness": {"again": "rerun", "quantities": "perturb"},
    "run-experiments": {"again": "rerun", "only": "experiments"},
    "train": {"run": "run-dir"},
    "tune": {"keep": "output"},
    "tune-training": {"keep": "output", "share": "step-fraction"},
    "validate-transients": {"noise": "num-noise-motions"},
}

RESULT_KEYS = {"arena": "evaluation_task", "yardstick": "normaliser"}  # of result files
# What packages of 0.1 handed on, by package.
PYTHON = {
    "agents.evaluation": {
        "Contestant": "Entry",
        "bench": "run_benchmark",
        "contestant": "find_entry",
        "controllers_of": "controllers_with_sources",
        "difference": "difference_of_result",
    },
    "agents.experiments": {"keep": "keep_tuned_values", "plan": "plan_runs"},
    "agents.policies": {
        "digest": "file_digest",
        "file_of": "policy_path",
        "named_controller": "get_controller",
        "require_controller": "find_controller",
    },
    "agents.reporting": {
        "Gathered": "HistoryCollector",
        "film": "write_video",
        "put": "put_block",
        "section": "robustness_section",
    },
    "agents.training": {
        "AnalyticOptions": "APGOptions",
        "finished": "is_finished",
        "go_on": "train_or_resume",
    },
    "baselines.analysis": {"ClosedLoop": "ContinuousClosedLoop", "respond": "forced_response"},
}


class RenamedWarning(FutureWarning):
    """A name of an earlier version was used."""


def renamed(kind: str, name: str, table: Mapping[str, str]) -> str:
    """Return the present name, with a warning where `name` is an old one; other names as they are.

    Parameters
    ----------
    kind
        What is named, for the warning.
    name
        Of any version.
    table
        Present name by old name.
    """
    if name not in table:
        return name
    text = f"{kind} {name!r} is now called {table[name]!r}; the old name works until version {LAST}"
    warnings.warn(text, RenamedWarning, stacklevel=3)
    return table[name]


def renamed_keys(kind: str, values: Mapping[str, float], table: Mapping[str, str]) -> dict[str, float]:
    """Return values by the present names of their keys; see `renamed`."""
    return {renamed(kind, name, table): value for name, value in values.items()}
