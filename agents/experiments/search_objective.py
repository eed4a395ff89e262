"""How a search judges its trials: by their own evaluations, then on validation earthquakes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from agents.evaluation.statistics import cost_ratio
from agents.experiments.controller_tuning import FAILED
from agents.experiments.evaluation_tasks import EVALUATION_TASKS
from agents.experiments.recipes import ExperimentConfig
from agents.run_directory import evaluations_of_run
from agents.seeds import VALIDATION_SEED
from agents.training.config import TrainConfig
from baselines.registry import make_baseline, reference_name
from shake_env.controller import Controller
from shake_env.rollout import noise_earthquakes, rollout


class PrunedError(Exception):
    """The trial stands behind half of those before it."""


class OutOfTimeError(Exception):
    """The search has had its minutes; the trial goes on another time."""


class ValidationSet:
    """The validation earthquakes of an experiment's evaluation_task, and the reference on them."""

    def __init__(self, experiment: ExperimentConfig, earthquakes: int) -> None:
        self.scenario = next(
            a.options for a in EVALUATION_TASKS if a.name == experiment.evaluation_task
        ).build()
        self.earthquakes = noise_earthquakes(self.scenario, earthquakes, VALIDATION_SEED)
        self.reference = reference_name(self.scenario)
        reference = make_baseline(self.reference, self.scenario)
        self._rows, _ = rollout(reference, self.scenario, self.earthquakes)

    @property
    def reference_lost(self) -> int:
        """Number of tables that the reference loses."""
        return sum(row.broken_limit is not None for row in self._rows)

    def judge(self, controller: Controller) -> dict[str, Any]:
        """Return mean cost over the reference's, its 95 % interval, and the number of tables lost."""
        rows, _ = rollout(controller, self.scenario, self.earthquakes)
        lost = sum(row.broken_limit is not None for row in rows)
        if not np.all(np.isfinite([row.cost for row in rows])):
            return {"cost": FAILED, "low": FAILED, "high": FAILED, "lost": lost}
        cost, low, high = cost_ratio(rows, self._rows)
        return {"cost": cost, "low": low, "high": high, "lost": lost}


class PruningCallback:
    """Reports a run's evaluations to Optuna, and says when the run is to end.

    The reported value is the best so far, for that is the policy that a run keeps.
    """

    def __init__(self, trial: Any, config: TrainConfig, run: Path) -> None:
        self.trial, self.config, self.run = trial, config, run
        self.best = math.inf
        self._told: set[int] = set()

    def report(self) -> None:
        """Report the evaluations that are not reported yet; raise PrunedError if the run is to end.

        Each is judged in its turn, those that a fast run made since the last report too, so that whether
        a trial is ended does not go by the clock.
        """
        self.best = math.inf
        for steps, ratio in sorted(dict(evaluations_of_run(self.run)).items()):
            self.best = min(self.best, ratio if math.isfinite(ratio) else FAILED)
            place = steps * self.config.evaluations // self.config.steps
            if place in self._told:
                continue
            self.trial.report(self.best, place)
            self._told.add(place)
            if steps < self.config.steps and self.trial.should_prune():
                raise PrunedError
