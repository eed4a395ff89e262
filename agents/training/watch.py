"""What a training run does between its roll-outs: evaluation, checkpoints, report."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Figure

from agents.policies.symmetry import mirror_averaged
from agents.progress import Progress
from agents.run_directory import BEST, EVALUATIONS, append_row, evaluations_of_run
from agents.seeds import EVALUATION_SEED
from agents.training.artificial_motions import artificial_motions
from agents.training.checkpoint import save_checkpoint
from agents.training.config import TrainConfig
from agents.training.policy_export import export_policy
from agents.training.progress import example_figure
from agents.training.tables import TrainingTables, base_tables, training_scenario
from baselines.lqr.oracle import oracle_controller
from baselines.lqr.sampled import lqr
from shake_env.rollout import Earthquake, noise_earthquakes, rollout
from shake_env.scenario.scenario import Scenario

REPORT_PERIOD = 0.5  # [s] between two reports of the progress, at least


class TrainingWatch(BaseCallback):
    """Evaluates and checkpoints between roll-outs; changes nothing about the training.

    Evaluations go by steps, so that a run that was interrupted keeps the same policy for its best as one
    that was not; checkpoints go by wall time.
    """

    def __init__(
        self,
        config: TrainConfig,
        env: TrainingTables,
        run: Path,
        report: Callable[[Progress], None],
    ) -> None:
        super().__init__()
        self.config, self.tables, self.run, self.report = config, env, run, report
        scenario = config.scenario.build()
        of_training = training_scenario(replace(config, num_artificial_motions=0), scenario)
        self.scenario = replace(scenario, motion=of_training.motion)
        self.earthquakes = noise_earthquakes(
            self.scenario, config.evaluation_earthquakes, EVALUATION_SEED
        )
        if config.num_artificial_motions:
            others = artificial_motions(scenario, config.num_artificial_motions, EVALUATION_SEED)
            self.earthquakes += [Earthquake(m.source.name, m) for m in others]
        self.reference = "LQR" if lqr_suits(self.scenario) else "oracle"
        self.earthquakes, self.reference_cost = _reference(self.scenario, self.earthquakes)
        self.started = time.monotonic()
        self.saved = self.reported = -np.inf
        self.passed = -1  # number of the last evaluation that was due
        self.cost_ratio: float | None = None
        self.evaluations = [ratio for _, ratio in evaluations_of_run(run)]
        self.card = {
            "table": scenario.table,
            "control_rate": scenario.control_rate,
            "config": config.to_json(),
        }
        self.errors: tuple[float, float] | None = None

    def _due(self, steps: int) -> int:
        return steps * self.config.evaluations // self.config.steps

    def _on_training_start(self) -> None:
        behind = [
            steps for steps, _ in evaluations_of_run(self.run) if steps <= self.model.num_timesteps
        ]
        self.passed = max(map(self._due, behind), default=-1)

    def _on_rollout_start(self) -> None:
        now = time.monotonic()
        if self._due(self.model.num_timesteps) > self.passed:
            self.passed = self._due(self.model.num_timesteps)
            self.evaluate()
        if now - self.saved >= self.config.checkpoint_interval:
            save_checkpoint(self.run, self.model, self.tables)  # type: ignore[arg-type]  # one of `Model`
            self.saved = now
        if now - self.reported >= REPORT_PERIOD:
            self.tell()
            self.reported = now

    def _on_step(self) -> bool:
        return True

    def tell(self) -> None:
        """Report where the run stands."""
        self.report(
            Progress(
                self.model.num_timesteps,
                self.config.steps,
                time.monotonic() - self.started,
                self.cost_ratio,
                tuple(self.evaluations),
                self.errors,
                self.reference,
            )
        )

    def evaluate(self) -> None:
        """Write the policy's mean cost on the fixed earthquakes down, and keep it if it is the best."""
        policy = export_policy(self.model, base_tables(self.tables), self.card)
        if self.config.odd_symmetry:
            policy = mirror_averaged(policy)
        metrics, trajectories = rollout(policy, self.scenario, self.earthquakes, record=(0,))
        cost = float(np.mean([m.cost for m in metrics]))
        self.cost_ratio = cost / self.reference_cost
        self.evaluations.append(self.cost_ratio)
        acceleration = float(np.mean([m.acceleration_rms_error for m in metrics]))
        shear = float(np.mean([m.base_shear_rms_error for m in metrics]))
        self.errors = (acceleration, shear)
        self.logger.record("evaluation/cost_ratio", self.cost_ratio)
        self.logger.record("evaluation/acceleration_rms_error", acceleration)
        self.logger.record("evaluation/base_shear_rms_error", shear)
        title = f"{metrics[0].earthquake} after {self.model.num_timesteps} control periods"
        figure = Figure(example_figure(trajectories[0], title), close=False)
        self.logger.record("evaluation/example", figure)
        self.logger.dump(self.model.num_timesteps)
        row = {
            "steps": self.model.num_timesteps,
            "seconds": round(time.monotonic() - self.started, 1),
            "cost_ratio": self.cost_ratio,
            "acceleration_rms_error": acceleration,
            "base_shear_rms_error": shear,
        }
        append_row(self.run / EVALUATIONS, row)
        if self.cost_ratio <= min(ratio for _, ratio in evaluations_of_run(self.run)):
            policy.save(self.run / BEST)


def lqr_suits(scenario: Scenario) -> bool:
    """Return whether a run's costs are relative to LQR's, and not to the oracle's (see `_reference`)."""
    suits = scenario.sensing.full_state and not scenario.delay and not scenario.uncertainty.active
    return suits and scenario.limits.table_displacement is None


def _reference(scenario: Scenario, earthquakes: Sequence[Earthquake]) -> tuple[list[Earthquake], float]:
    """Return the earthquakes that the reference lasts through, and its mean cost on them.

    The reference is LQR, or where that cannot be used as it stands, the oracle: LQR needs the full
    state of a table that it knows, answers at once and may drift as far as it likes. An earthquake that
    takes the reference to a limit costs so much that it would be the whole of a mean.
    """
    if lqr_suits(scenario):
        metrics, _ = rollout(lqr(scenario), scenario, earthquakes)
    else:
        shown, controller = oracle_controller(scenario, earthquakes)
        metrics, _ = rollout(controller, shown, earthquakes)
    lasting = [i for i, m in enumerate(metrics) if m.broken_limit is None] or range(len(metrics))
    return [earthquakes[i] for i in lasting], float(np.mean([metrics[i].cost for i in lasting]))


def evaluation_curve(run: str | PathLike[str]) -> list[list[float]]:
    """Return a run's learning curve so far: steps and cost ratio of each evaluation."""
    # A run that was interrupted evaluates again what its last checkpoint had not seen yet.
    curve = dict(evaluations_of_run(Path(run)))
    return [[steps, curve[steps]] for steps in sorted(curve)]
