"""The command ``shake gradient-noise``."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from agents.cli.command_options import CommandOptions
from agents.cli.output_path import require_writable_file
from agents.policies.base_names import BaseLaw
from agents.progress import progress_bar
from agents.reporting.terminal import print_table
from agents.scenario_options import ScenarioOptions


@dataclass(frozen=True, kw_only=True)
class GradientNoiseCommand(CommandOptions):
    """Measure the signal-to-noise ratio of policy-gradient estimators, paired and unpaired.

    A policy explores around a base controller. Each estimator of the gradient is compared with the exact
    gradient: the share of an advantage that one action explains, the cosine of the two directions, and
    the samples after which signal and noise along the exact gradient are equal.

    Try:
      shake gradient-noise --scenario laboratory
      shake gradient-noise --scenario yielding --rollouts 4 --json
    """

    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(default_factory=ScenarioOptions)
    base_controller: BaseLaw = "lqg-searched"
    """Controller that the policy corrects."""
    residual_scale: float = 0.02
    """What an action of 1 adds to it, as a fraction of the current limit."""
    log_std: float = -3.0
    """Log of the exploration's standard deviation, relative to that."""
    n_envs: int = 64
    """Tables side by side."""
    rollouts: int = 12
    """Roll-outs of 256 control periods of each."""
    output: Path | None = None
    """File for the result, as JSON."""

    def run(self, console: Console) -> dict[str, Any]:
        """Measure and print."""
        from agents.studies.gradient_noise import NoiseSettings, gradient_noise
        from shake_env.files import write_json

        if self.output is not None:
            require_writable_file(self.output, "output")
        scenario = self.scenario.build()
        settings = NoiseSettings(
            base_controller=self.base_controller,
            residual_scale=self.residual_scale,
            log_std=self.log_std,
            n_envs=self.n_envs,
            rollouts=self.rollouts,
        )
        with progress_bar() as bar:
            task = bar.add_task(f"gradients, {scenario.name}", total=1.0)
            result = gradient_noise(scenario, settings, lambda share: bar.update(task, completed=share))
        heading = ("advantage", "one action's share", "cosine", "of the exact", "samples for S/N 1")
        cells = [
            (
                each.estimator,
                f"{100 * each.action_share:.2g} %",
                f"{each.cosine:.2f}",
                f"{each.along:.2f} +- {each.along_error:.2f}",
                f"{each.samples:,}",
            )
            for each in result.estimators
        ]
        print_table(console, heading, cells)
        console.print(
            f"a quadratic critic explains {100 * result.explained_by_critic:.0f} % of the returns, one "
            f"that is told state, plant and coming ground {100 * result.explained_by_asymmetric:.0f} %"
        )
        plain = asdict(result)
        if self.output is not None:
            write_json(self.output, plain)
            console.print(f"wrote {self.output}")
        return plain
