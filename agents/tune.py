"""Search a classical controller's free parameters on validation earthquakes, within a stated budget.

The search is Optuna's tree-structured Parzen estimator (Bergstra et al., 2011), seeded, its trace kept
in SQLite: a search that was interrupted goes on where it stopped. The first trial is the default.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import shake_env
from baselines.catalogue import BASELINES
from baselines.registry import make_baseline
from shake_env.errors import NumericalError, ParameterError, ScenarioError, ShakeError, unknown
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.scenario import Scenario

VALIDATION_SEED = 3_000_000  # neither training's, nor its evaluation's, nor the tests'
FAILED = 1e6  # cost of a trial whose design fails


@dataclass(frozen=True)
class Tuning:
    """What a search came to."""

    controller: str
    scenario: str
    parameters: dict[str, float]
    cost: float  # mean stage cost on the validation earthquakes
    default_cost: float
    trials: int
    table_steps: int  # control periods of all tables in all trials
    earthquakes: int
    seed: int

    def to_json(self) -> dict[str, Any]:
        """Return the result as plain JSON values, with the version that made it."""
        return {"version": shake_env.__version__, **vars(self)}


def tune(
    name: str,
    scenario: Scenario,
    storage: Path,
    *,
    budget: int = 4_000_000,
    earthquakes: int = 16,
    seed: int = 0,
    on_trial: Callable[[int, int, float], None] = lambda done, total, best: None,
) -> Tuning:
    """Search, or go on with a search.

    Parameters
    ----------
    name
        Of `baselines.registry.BASELINES`.
    scenario
        Its motion is that of the validation earthquakes.
    storage
        SQLite file that keeps the trace of every search; made if need be.
    budget
        Control periods that may be simulated in all: what a policy is trained with by default.
    earthquakes
        Validation earthquakes of a trial.
    seed
        Of the search.
    on_trial
        Told the trials done, those in all, and the best cost, after each.

    Raises
    ------
    ScenarioError
        If the controller is unknown or does not suit the scenario.
    ParameterError
        If it has nothing to tune, or the budget is below one trial.
    """
    try:
        import optuna
    except ImportError:
        raise ShakeError("optuna", "missing", "pip install 'shake-env[agents]'") from None
    if name not in BASELINES:
        raise unknown(ScenarioError, "controller", name, BASELINES)
    tunable = BASELINES[name].tunable
    repeats = BASELINES[name].repeats_tests
    if not tunable:
        raise ParameterError("controller", name, "has no free parameter: its design decides everything")
    motions = noise_earthquakes(scenario, earthquakes, VALIDATION_SEED)
    steps = round(motions[0].motion.duration / scenario.control_period) * earthquakes  # type: ignore[union-attr]
    total = budget // steps
    if total < 1:
        raise ParameterError("budget", budget, f"one trial takes {steps} control periods")
    quakes = motions if repeats else None
    if not repeats:
        make_baseline(name, scenario, {})  # says at once if the scenario does not suit it

    def cost(values: dict[str, float]) -> float:
        try:
            controller = make_baseline(name, scenario, values, quakes)
            rows, _ = rollout(controller, scenario, motions)
        except NumericalError:
            return FAILED
        mean = float(np.mean([row.cost for row in rows]))
        return mean if math.isfinite(mean) else FAILED

    def objective(trial: Any) -> float:
        return cost(
            {
                each: trial.suggest_float(each, t.low, t.high, log=t.logarithmic)
                for each, t in tunable.items()
            }
        )

    storage.parent.mkdir(parents=True, exist_ok=True)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(
        study_name=f"{scenario.name}/{name}/{seed}/{earthquakes}",
        storage=f"sqlite:///{storage}",
        load_if_exists=True,
        # A resumed search draws from a seed of its own, or it would repeat its first trials.
        sampler=optuna.samplers.TPESampler(seed=seed, multivariate=True),
    )
    done = _finished(study)
    study.sampler = optuna.samplers.TPESampler(seed=seed + 1000 * done, multivariate=True)
    if done == 0:
        study.enqueue_trial({each: t.default for each, t in tunable.items()})
    while done < total:
        study.optimize(objective, n_trials=1)
        done = _finished(study)
        on_trial(done, total, study.best_value)
    default = next(t.value for t in study.trials if t.value is not None)
    return Tuning(
        name, scenario.name, dict(study.best_params), float(study.best_value), float(default),
        done, done * steps, earthquakes, seed,
    )  # fmt: skip


def _finished(study: Any) -> int:
    return sum(trial.value is not None for trial in study.trials)


def keep(tuning: Tuning, file: Path) -> None:
    """Put a result among those that `baselines.registry` reads."""
    known = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    known.setdefault(tuning.scenario, {})[tuning.controller] = tuning.to_json()
    text = json.dumps(known, indent=1, sort_keys=True) + "\n"
    partial = file.with_suffix(".partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(file)
