"""The command ``shake train``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from agents.cli.command_options import CommandOptions
from agents.run_directory import CONFIG
from agents.training.config import TrainConfig, read_config, require_same


@dataclass(frozen=True, kw_only=True)
class Train(CommandOptions):
    """Train a policy. --resume continues an interrupted run exactly.

    Checkpoints are numbers in safetensors and JSON: reading one runs no code, whoever made it.

    Try:
      shake train --run-dir runs/mine
      shake train --run-dir runs/five --config.scenario.stories 5 --config.total-timesteps 6000000
      shake train --run-dir runs/sac --config.algorithm sac
      shake train --run-dir runs/mine --resume
      shake train --run-dir runs/tuned --config.init-policy apg --config.algorithm ppo
      tensorboard --logdir runs
    """

    run_directory: Annotated[Path, tyro.conf.arg(name="run-dir")]
    """Directory of the run; must not exist or be empty, unless it is resumed."""
    config: TrainConfig = field(default_factory=TrainConfig)
    """Configuration of the run; with --resume no option may differ from the run's own."""
    resume: bool = False
    """Continue the run from its last checkpoint. Checkpoints hold no pickles, so that reading one runs
    no code; those of earlier versions, which do, are refused."""

    @property
    def after_interruption(self) -> str:
        """The line that goes on with the run."""
        return f"go on with: shake train --run-dir {self.run_directory} --resume"

    def check_words(self, words: Sequence[str]) -> None:
        """Raise RunDirectoryError if a run is to be resumed with an option that differs from its own.

        The options are read again with the run's own for defaults, so that what differs then was given.
        """
        if not self.resume or not (self.run_directory / CONFIG).exists():
            return
        stored = read_config(self.run_directory)
        usual = Train(run_directory=self.run_directory, config=stored)  # flags as tyro reads them
        given = tyro.cli(Train, args=list(words), default=usual).config
        # What --set gives is put behind the run's own.
        changes = self.config.scenario.set or stored.scenario.set
        given = replace(given, scenario=replace(given.scenario, set=changes))
        remedy = "leave the options away, or begin another run with them"
        require_same(given, self.run_directory, remedy)

    def run(self, console: Console) -> dict[str, Any]:
        """Train with progress on the terminal, and print the path of the policy."""
        from agents.run_directory import folder_contents
        from agents.training.progress import TrainingView
        from agents.training.run import resume, train

        begins = self.run_directory.is_dir() and not folder_contents(self.run_directory)
        if self.resume and begins:
            console.print(f"{self.run_directory} is empty: the run begins, with the options given here")
        with TrainingView(f"training {self.run_directory.name}") as view:
            if self.resume and not begins:
                result = resume(self.run_directory, report=view)
            else:
                config = replace(self.config, scenario=self.config.scenario.without_file())
                result = train(config, self.run_directory, report=view)
        console.print(
            f"cost relative to {result.reference} {result.cost_ratio:.4f} after {result.best_steps} of "
            f"{result.steps} steps, {result.seconds:.0f} s\n"
            f"wrote {self.run_directory / 'policy.safetensors'}\n"
            f"compare it: shake compare --controllers ppo {self.run_directory}"
        )
        return asdict(result)
