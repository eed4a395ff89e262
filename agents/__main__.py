"""The command line ``shake``: a typed command each, made by tyro from dataclasses."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

from shake_env.errors import ParameterError, ShakeError

try:
    import tyro
    from rich.console import Console
except ImportError as missing:  # the environment and LQR install without the command line's packages
    sys.exit(f"shake: {missing.name} is not installed: pip install 'shake-env[agents]'")

from agents.bench_command import Bench
from agents.broken_pipe import end_quietly
from agents.campaign_command import Results, RunCampaign
from agents.components_command import Components
from agents.config import TrainConfig
from agents.evaluate_command import Evaluate
from agents.motion_channels import MotionOptions
from agents.motion_command import Motion, motion_earthquakes
from agents.options import ScenarioOptions
from agents.policy_command import Card, Export
from agents.progress import progress_bar
from agents.recipe_search_command import SearchRecipe
from agents.robustness_command import Robustness
from agents.scenario_command import ShowScenario
from agents.tune_command import Tune
from agents.validate_command import Validate
from agents.watch_command import Watch


@dataclass(frozen=True, kw_only=True)
class Compare:
    """Run controllers on the same earthquakes and set their errors side by side.

    Try:
      shake compare
      shake compare --stories 5 --mass-ratio 0.2 --controllers lqr none
      shake compare --controllers lqr policy runs/mine --noise 100 --output out/mine
      shake compare --motion CICLC.v1 --noise 0 --no-records
      shake compare --report out/report
      shake compare --json > comparison.json
    """

    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(default_factory=ScenarioOptions)
    controllers: tuple[str, ...] = ("lqr", "none", "policy", "analytic", "off-policy")
    """Names of classical controllers, all (every one that suits the scenario), policy, analytic
    and off-policy (those that ship), or paths of policy files and run directories."""
    noise: int = 32
    """Number of filtered-noise earthquakes."""
    records: bool = True
    """Whether the six embedded records are among the earthquakes."""
    seed: int = 2_000_000
    """First seed of the filtered noise."""
    motion: tyro.conf.UseAppendAction[tuple[Path, ...]] = ()
    """File of recorded motion, each channel an earthquake; may be given again for further files."""
    scale: bool = True
    """Whether their amplitude is brought within the table, as `shake motion` reports it."""
    motion_options: Annotated[MotionOptions, tyro.conf.arg(name="motion")] = field(
        default_factory=MotionOptions
    )
    supervised: bool = False
    """Whether a supervisor keeps every controller within the scenario's hard limits."""
    output: Path | None = None
    """Folder for JSON, CSV and the figure (default: out/compare; with --json: none)."""
    report: Path | None = None
    """Folder for a report: one page to open in a browser, and its figures as SVG and PNG."""
    robustness: Path | None = None
    """Result of shake robustness on the same scenario, such as docs/results/robustness_linear.json: the
    report shows it."""
    json: bool = False
    """Print one JSON object on standard output and nothing else there."""

    def run(self, console: Console) -> dict[str, Any]:
        """Compare, print, write."""
        from agents.compare import compare
        from agents.compare_output import print_tables, write_files
        from agents.report import Gathered, make_report
        from agents.report_output import write_report
        from agents.robustness_output import read_robustness
        from shake_env.rollout import recorded_earthquakes

        if self.noise < 0:
            raise ParameterError("noise", self.noise, "must be at least 0")
        scenario = self.scenario.build()
        gathered = None if self.report is None else Gathered(scenario)
        unlike = None if self.robustness is None else read_robustness(self.robustness, scenario.name)
        if unlike is not None and gathered is None:
            raise ParameterError(
                "robustness", str(self.robustness), "is shown in a report: give --report"
            )
        motions = motion_earthquakes(
            self.motion, self.motion_options, scenario, scale=self.scale, console=console
        )
        for quake in recorded_earthquakes(scenario) if self.records else ():
            if quake.motion.amplitude != 1.0:  # scaled to the table, or by the scenario
                console.print(f"record {quake.name}: amplitude x {quake.motion.amplitude:.4g}")
        with progress_bar() as progress:
            tasks: dict[str, Any] = {}

            def on_progress(name: str, share: float) -> None:
                if name not in tasks:
                    tasks[name] = progress.add_task(name, total=1.0)
                progress.update(tasks[name], completed=share)

            result = compare(
                scenario,
                self.controllers,
                noise=self.noise,
                records=self.records,
                seed=self.seed,
                motions=motions,
                supervised=self.supervised,
                on_progress=on_progress,
                **({} if gathered is None else {"on_histories": gathered}),
            )
        settings = _plain(asdict(self))
        folder = self.output or (None if self.json else Path("out/compare"))
        print_tables(result, console)
        if folder is not None:
            for path in write_files(result, settings, folder):
                console.print(f"wrote {path}")
        if gathered is not None and self.report is not None:
            command = shlex.join(["shake", *sys.argv[1:]])
            written = write_report(make_report(result, gathered, command, unlike), self.report)
            console.print(f"wrote {written[0]} and {len(written) - 1} figures: open it in a browser")
        return result.to_json(settings)


@dataclass(frozen=True, kw_only=True)
class Design:
    """Design the sampled-data LQR of a specimen and print the fidelity to expect of it.

    Try:
      shake design
      shake design --stories 4 --mass-ratio 0.3 --control-rate 200 --json
      shake design --acceleration-weight 1 --force-weight 0
    """

    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(default_factory=ScenarioOptions)
    json: bool = False
    """Print one JSON object on standard output and nothing else there."""

    def run(self, console: Console) -> dict[str, Any]:
        """Design and print."""
        from agents.design import design, print_design

        scenario = self.scenario.build()
        found = design(scenario)
        print_design(found, scenario, console)
        return found


@dataclass(frozen=True, kw_only=True)
class Reproduce:
    """Write the tables and figures of Gavin and Hoagg (2009): published, as printed, corrected.

    Try:
      shake reproduce
      shake reproduce --output out/paper
    """

    output: Path = Path("out/reproduction")
    """Folder for tables (CSV, JSON, Markdown) and figures (PNG, SVG)."""
    json: bool = False
    """Print one JSON object on standard output and nothing else there."""

    def run(self, console: Console) -> dict[str, Any]:
        """Reproduce, and say what is being done."""
        from agents.reproduce import reproduce

        found = reproduce(self.output, progress=Console(stderr=True).print)
        console.print(f"wrote {self.output}")
        return found


@dataclass(frozen=True, kw_only=True)
class Train:
    """Train a policy. An interrupted run goes on exactly with --resume.

    Try:
      shake train --run runs/mine
      shake train --run runs/five --config.scenario.stories 5 --config.total-steps 6000000
      shake train --run runs/sac --config.algorithm sac
      shake train --run runs/mine --resume
      shake train --run runs/tuned --config.start analytic --config.ppo.critic-first 0.25
      tensorboard --logdir runs
    """

    run_directory: Annotated[Path, tyro.conf.arg(name="run")]
    """Directory of the run; must not exist, unless it is resumed."""
    config: TrainConfig = field(default_factory=TrainConfig)
    """What decides the result; a resumed run takes its own."""
    resume: bool = False
    """Go on with the run from its last checkpoint."""
    json: bool = False
    """Print one JSON object on standard output and nothing else there."""

    def run(self, console: Console) -> dict[str, Any]:
        """Train in sight of a person, and say where the policy lies."""
        from agents.train import resume, train
        from agents.training_view import TrainingView

        with TrainingView(f"training {self.run_directory.name}") as view:
            if self.resume:
                result = resume(self.run_directory, report=view)
            else:
                result = train(self.config, self.run_directory, report=view)
        console.print(
            f"cost relative to {result.reference} {result.cost_ratio:.4f} after {result.best_steps} of "
            f"{result.steps} steps, {result.seconds:.0f} s\n"
            f"wrote {self.run_directory / 'policy.safetensors'}\n"
            f"compare it: shake compare --controllers lqr policy {self.run_directory}"
        )
        return asdict(result)


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    plain: dict[str, Any] = json.loads(json.dumps(values, default=str))
    return plain


COMMANDS: dict[str, Callable[..., Any]] = {
    "bench": Bench,
    "campaign": RunCampaign,
    "card": Card,
    "compare": Compare,
    "components": Components,
    "design": Design,
    "evaluate": Evaluate,
    "export": Export,
    "motion": Motion,
    "recipe-search": SearchRecipe,
    "reproduce": Reproduce,
    "results": Results,
    "robustness": Robustness,
    "scenario": ShowScenario,
    "train": Train,
    "tune": Tune,
    "validate": Validate,
    "watch": Watch,
}


def main(arguments: list[str] | None = None) -> int:
    """Run a command; return 0, 1 if runs failed, 2 for a mistake in what was asked, 130 interrupted."""
    return end_quietly(lambda: _main(arguments))


def _main(arguments: list[str] | None) -> int:
    command = tyro.extras.subcommand_cli_from_dict(
        COMMANDS,
        prog="shake",
        description="Shake tables under learned and classical control.",
        args=arguments,
    )
    # Tables piped into a file or a pager need no narrower a page than a terminal's usual one.
    console = Console(quiet=command.json, width=None if sys.stdout.isatty() else 100)
    try:
        found = command.run(console)
    except ShakeError as error:
        print(f"shake: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("shake: interrupted", file=sys.stderr)
        if isinstance(command, Train):
            print(f"go on with: shake train --run {command.run_directory} --resume", file=sys.stderr)
        return 130
    if command.json:
        print(json.dumps(found))
    return 1 if isinstance(command, RunCampaign) and found.get("failures") else 0


if __name__ == "__main__":
    sys.exit(main())
