"""Train a policy on a scenario, with evaluation, checkpoints and exact resumption."""

from __future__ import annotations

import shlex
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from os import PathLike
from pathlib import Path

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Figure, configure
from threadpoolctl import threadpool_limits

import shake_env
from agents.learning.training_scenario import make_training_scenario, reward_scale
from agents.learning.vec_env import ShakeTableVecEnv
from agents.plain_values import typed
from agents.policies.base_law import at_own_cost, base_law
from agents.policies.policy_file import digest, load_policy
from agents.policies.symmetry import mirror_averaged
from agents.progress import Progress
from agents.provenance import code_version
from agents.run_directory import (
    BEST,
    CONFIG,
    EVALUATIONS,
    FIRST,
    POLICY,
    RESULT,
    append_row,
    contents,
    create,
    described,
    evaluations,
    file_errors,
    forget_attempt,
    locked,
    read_json,
    replacing,
    write_json,
)
from agents.seeds import EVALUATION_SEED, RUN_SEEDS
from agents.training.artificial_motions import artificial_motions
from agents.training.checkpoint import checkpoints, load_checkpoint, require_no_pickles, save_checkpoint
from agents.training.config import TrainConfig, read_config, require_same
from agents.training.model_factory import Model, new_model
from agents.training.policy_export import export_policy
from agents.training.progress import example_figure
from agents.training.warm_start import begin_with, first_file
from baselines.lqr.oracle import clairvoyant
from baselines.lqr.sampled import lqr
from shake_env.errors import RunDirectoryError
from shake_env.motion.targets import FilteredNoise, MotionSet
from shake_env.rollout import Earthquake, noise_earthquakes, rollout
from shake_env.scenario.scenario import Scenario


@dataclass(frozen=True)
class TrainResult:
    """What a finished run came to."""

    run: str
    steps: int
    seconds: float
    cost_ratio: float
    cost: float
    reference: str  # LQR, or the clairvoyant where LQR is none (see _reference)
    reference_cost: float
    best_steps: int  # at which the policy that is kept was evaluated; its are the costs above


def train(
    config: TrainConfig,
    run: str | PathLike[str],
    *,
    report: Callable[[Progress], None] = lambda progress: None,
    command: str | None = None,
) -> TrainResult:
    """Train from scratch, or from `config.start`, into a new run directory.

    Parameters
    ----------
    config, run
        What is trained, and where its files go.
    report
        Told where the run stands, every half second at most.
    command
        What the policy's card says it was made by; None: this process's own command line.

    Raises
    ------
    RunDirectoryError
        If the directory holds a run already, or anything else, or another process runs it.
    FileError
        If it cannot be written, or the disk is full.
    PolicyFileError
        If the policy to begin with cannot be read, or is of another kind than what is trained.
    """
    run = Path(run)
    require_beginnable(config, run)
    model, env, first = _new(config, first_file(config))
    create(run, lambda folder: _describe(folder, config, first))
    with locked(run), file_errors(run):
        require_beginnable(config, run)  # nor has another process begun it since
        forget_attempt(run)
        return _run(model, config, env, run, report, command)


def resume(
    run: str | PathLike[str],
    *,
    report: Callable[[Progress], None] = lambda progress: None,
    command: str | None = None,
) -> TrainResult:
    """Go on with an interrupted run, exactly as if it had not been interrupted; see :func:`train`.

    Raises
    ------
    RunDirectoryError
        If the directory holds no run, none of its checkpoints can be read, or another process runs it.
    """
    run = Path(run)
    config = read_config(run)
    with locked(run), file_errors(run):
        return _go_on(config, run, report, command)


def go_on(
    config: TrainConfig,
    run: str | PathLike[str],
    *,
    report: Callable[[Progress], None] = lambda progress: None,
    command: str | None = None,
    wait: float = 0.0,
) -> None:
    """Train a run, or go on with it, or do nothing where it is done; see :func:`train`.

    It waits up to `wait` [s] for another process that runs it to end.

    Raises
    ------
    RunDirectoryError
        If the directory holds another run, or something else.
    """
    run = Path(run)
    if not (run / CONFIG).exists():
        train(config, run, report=report, command=command)
        return
    require_same(config, run, "move it away, or name another")
    with locked(run, wait), file_errors(run):
        if not finished(run):
            _go_on(config, run, report, command)


def require_beginnable(config: TrainConfig, run: str | PathLike[str]) -> None:
    """Raise RunDirectoryError unless a run can begin in a directory.

    It can where there is none, where it is empty, and where an attempt at the same run was interrupted
    before its first checkpoint.
    """
    run = Path(run)
    present = contents(run)
    if run.exists() and not run.is_dir():
        raise RunDirectoryError("run directory", str(run), "is a file: name another")
    if not present:
        return
    if CONFIG not in present:
        remedy = (
            f"exists already and holds no run, but {described(present)}: move it away, or name another"
        )
        raise RunDirectoryError("run directory", str(run), remedy)
    if POLICY in present or checkpoints(run):
        remedy = f"exists already and holds {described(present)}: name another, or go on with --resume"
        raise RunDirectoryError("run directory", str(run), remedy)
    require_no_pickles(run)
    require_same(config, run, "name another, or move it away")


def read_result(run: str | PathLike[str]) -> TrainResult:
    """Return what a finished run came to.

    Raises
    ------
    RunDirectoryError
        If there is no result, or it is not complete.
    """
    run = Path(run)
    file = run / RESULT
    try:
        return typed(TrainResult, read_json(file, RunDirectoryError, "result", largest=2**20))
    except RunDirectoryError:
        raise
    except ValueError as error:
        raise RunDirectoryError("result", str(file), f"is no result of a run ({error})") from error


def finished(run: str | PathLike[str]) -> bool:
    """Return whether a run has a complete result and the policy that it is of."""
    run = Path(run)
    try:
        read_result(run)
    except RunDirectoryError:
        return False
    return (run / POLICY).is_file()


def _new(config: TrainConfig, file: Path | None) -> tuple[Model, ShakeTableVecEnv, Path | None]:
    """Return a new model on its tables, and the file of the policy that it begins with."""
    scenario = config.scenario.build()
    first = None if file is None else load_policy(file)
    env = training_tables(config, scenario)
    torch.set_num_threads(config.threads)
    model = new_model(config, scenario, env, direct=first is not None and first.direct)
    if first is not None:
        begin_with(model, env, first)
    # After the model: SB3 seeds the environment with the run's own seed, so that the tables of run 1
    # would repeat those of run 0 but for one.
    env.seed(config.seed * RUN_SEEDS)
    return model, env, file


def _describe(folder: Path, config: TrainConfig, first: Path | None) -> None:
    """Put into a run directory what decides the run: the policy that it begins with, its options."""
    if first is not None and first != folder / FIRST:
        with replacing(folder / FIRST) as partial:
            shutil.copyfile(first, partial)
    write_json(folder / CONFIG, config.to_json())


def _go_on(
    config: TrainConfig, run: Path, report: Callable[[Progress], None], command: str | None
) -> TrainResult:
    """Go on with a run whose directory is locked; begin it where it was cut before a checkpoint."""
    if not checkpoints(run) and not (run / POLICY).exists():
        require_no_pickles(run)
        first = run / FIRST
        model, env, _ = _new(config, first if first.exists() else first_file(config))
        forget_attempt(run)
    else:
        env = training_tables(config, config.scenario.build())
        torch.set_num_threads(config.threads)
        model = load_checkpoint(run, config, env)
    return _run(model, config, env, run, report, command)


def training_scenario(config: TrainConfig, scenario: Scenario) -> Scenario:
    """Return the training scenario: shortened episodes and a tighter bound on the scaled state."""
    made = make_training_scenario(
        scenario,
        horizon=config.lookahead,
        duration=config.episode,
        state_limit=config.state_limit,
    )
    if isinstance(made.motion, FilteredNoise) and config.artificial:
        others = artificial_motions(scenario, config.artificial, config.seed * RUN_SEEDS)
        made = replace(made, motion=MotionSet((*[made.motion] * config.artificial, *others)))
    return made


def training_tables(config: TrainConfig, scenario: Scenario) -> ShakeTableVecEnv:
    """Return the tables that a run trains on, with the law that its policy corrects."""
    chosen = config.chosen
    return ShakeTableVecEnv(
        training_scenario(config, scenario),
        chosen.tables,
        base=base_law(chosen.base, scenario, at_own_cost(scenario, config.scenario.scenario)),
        authority=chosen.authority,
        reward_scale=reward_scale(scenario, config.discount(scenario.control_period)),
    )


class _Watch(BaseCallback):
    """Evaluates and checkpoints between roll-outs; changes nothing about the training.

    Evaluations go by steps, so that a run that was interrupted keeps the same policy for its best as one
    that was not; checkpoints go by wall time.
    """

    def __init__(
        self,
        config: TrainConfig,
        env: ShakeTableVecEnv,
        run: Path,
        report: Callable[[Progress], None],
    ) -> None:
        super().__init__()
        self.config, self.tables, self.run, self.report = config, env, run, report
        scenario = config.scenario.build()
        of_training = training_scenario(replace(config, artificial=0), scenario)
        self.scenario = replace(scenario, motion=of_training.motion)
        self.earthquakes = noise_earthquakes(
            self.scenario, config.evaluation_earthquakes, EVALUATION_SEED
        )
        if config.artificial:
            others = artificial_motions(scenario, config.artificial, EVALUATION_SEED)
            self.earthquakes += [Earthquake(m.source.name, m) for m in others]
        self.reference = "LQR" if lqr_suits(self.scenario) else "clairvoyant"
        self.earthquakes, self.reference_cost = _reference(self.scenario, self.earthquakes)
        self.started = time.monotonic()
        self.saved = self.told = -np.inf
        self.passed = -1  # number of the last evaluation that was due
        self.cost_ratio: float | None = None
        self.evaluations = [ratio for _, ratio in evaluations(run)]
        self.card = {
            "table": scenario.table,
            "control_rate": scenario.control_rate,
            "config": config.to_json(),
        }
        self.errors: tuple[float, float] | None = None

    def _due(self, steps: int) -> int:
        return steps * self.config.evaluations // self.config.steps

    def _on_training_start(self) -> None:
        behind = [steps for steps, _ in evaluations(self.run) if steps <= self.model.num_timesteps]
        self.passed = max(map(self._due, behind), default=-1)

    def _on_rollout_start(self) -> None:
        now = time.monotonic()
        if self._due(self.model.num_timesteps) > self.passed:
            self.passed = self._due(self.model.num_timesteps)
            self.evaluate()
        if now - self.saved >= self.config.checkpoint_interval:
            save_checkpoint(self.run, self.model, self.tables)  # type: ignore[arg-type]  # one of `Model`
            self.saved = now
        if now - self.told >= 0.5:
            self.tell()
            self.told = now

    def _on_step(self) -> bool:
        return True

    def tell(self) -> None:
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
        policy = export_policy(self.model, self.tables, self.card)
        if self.config.mirrored:
            policy = mirror_averaged(policy)
        metrics, found = rollout(policy, self.scenario, self.earthquakes, record=(0,))
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
        figure = Figure(example_figure(found[0], title), close=False)
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
        if self.cost_ratio <= min(ratio for _, ratio in evaluations(self.run)):
            policy.save(self.run / BEST)


def lqr_suits(scenario: Scenario) -> bool:
    """Return whether costs are relative to LQR's, and not to the clairvoyant's (see `_reference`)."""
    suits = scenario.sensing.full_state and not scenario.delay and not scenario.uncertainty.active
    return suits and scenario.limits.table_displacement is None


def _reference(scenario: Scenario, earthquakes: Sequence[Earthquake]) -> tuple[list[Earthquake], float]:
    """Return the earthquakes that the reference lasts through, and its mean cost on them.

    The reference is LQR, or where that cannot be used as it stands, the clairvoyant: LQR needs the full
    state of a table that it knows, answers at once and may drift as far as it likes. An earthquake that
    takes the reference to a limit costs so much that it would be the whole of a mean.
    """
    if lqr_suits(scenario):
        metrics, _ = rollout(lqr(scenario), scenario, earthquakes)
    else:
        seen, controller = clairvoyant(scenario, earthquakes)
        metrics, _ = rollout(controller, seen, earthquakes)
    lasting = [i for i, m in enumerate(metrics) if m.broken_limit is None] or range(len(metrics))
    return [earthquakes[i] for i in lasting], float(np.mean([metrics[i].cost for i in lasting]))


def _curve(run: Path) -> list[list[float]]:
    """Return the learning curve so far: steps and cost ratio of each evaluation."""
    # A run that was interrupted evaluates again what its last checkpoint had not seen yet.
    curve = dict(evaluations(run))
    return [[steps, curve[steps]] for steps in sorted(curve)]


def _run(
    model: Model,
    config: TrainConfig,
    env: ShakeTableVecEnv,
    run: Path,
    report: Callable[[Progress], None],
    command: str | None,
) -> TrainResult:
    code = code_version()  # that runs, not that ends
    model.set_logger(configure(str(run / "tensorboard"), ["tensorboard"]))
    with threadpool_limits(config.threads):
        watch = _Watch(config, env, run, report)
        remaining = config.steps - model.num_timesteps
        if remaining > 0:
            # SB3 counts what is added to the steps done, and its learning rate from the sum.
            model.learn(remaining, callback=watch, reset_num_timesteps=False, log_interval=10)
        watch.init_callback(model)
        watch.evaluate()
        save_checkpoint(run, model, env)
        watch.tell()
    best_steps, best = min(_curve(run), key=lambda point: point[1])
    result = TrainResult(
        run=str(run),
        steps=model.num_timesteps,
        seconds=time.monotonic() - watch.started,
        cost_ratio=best,
        cost=best * watch.reference_cost,
        reference=watch.reference,
        reference_cost=watch.reference_cost,
        best_steps=int(best_steps),
    )
    card = {
        **watch.card,
        "command": command or shlex.join(["shake", *sys.argv[1:]]),
        "version": shake_env.__version__,
        "code": code,
        "evaluation": {key: value for key, value in asdict(result).items() if key != "run"},
        "curve": _curve(run),
    }
    if (run / FIRST).exists():
        made = load_policy(run / FIRST).card
        card["first"] = {"sha256": digest(run / FIRST), "command": made.get("command")}
    replace(load_policy(run / BEST), card=card).save(run / POLICY)
    write_json(run / RESULT, asdict(result))
    return result
