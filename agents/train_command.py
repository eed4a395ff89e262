"""The command ``shake train``."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from agents.command_options import CommandOptions
from agents.config import TrainConfig


@dataclass(frozen=True, kw_only=True)
class Train(CommandOptions):
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

    @property
    def after_interruption(self) -> str:
        """The line that goes on with the run."""
        return f"go on with: shake train --run {self.run_directory} --resume"

    def run(self, console: Console) -> dict[str, Any]:
        """Train in sight of a person, and say where the policy lies."""
        from agents.train import resume, train
        from agents.training_view import TrainingView

        with TrainingView(f"training {self.run_directory.name}") as view:
            if self.resume:
                result = resume(self.run_directory, report=view)
            else:
                config = replace(self.config, scenario=self.config.scenario.without_file())
                result = train(config, self.run_directory, report=view)
        console.print(
            f"cost relative to {result.reference} {result.cost_ratio:.4f} after {result.best_steps} of "
            f"{result.steps} steps, {result.seconds:.0f} s\n"
            f"wrote {self.run_directory / 'policy.safetensors'}\n"
            f"compare it: shake compare --controllers policy {self.run_directory}"
        )
        return asdict(result)
