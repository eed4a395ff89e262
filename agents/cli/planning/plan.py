"""The command ``shake plan``."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.console import Console
from rich.markup import escape

from agents.cli.command_options import FolderOptions
from agents.motions.channels import MotionOptions, motion_earthquakes
from agents.progress import progress_bar
from agents.scenario_options import ScenarioOptions


@dataclass(frozen=True, kw_only=True)
class Plan(FolderOptions):
    """Plan a whole record before its test: the optimal currents on the nominal table, with feedback.

    Writes one file a channel with the currents, the signals to expect and the feedback along them, and
    its figure. The controller `planned` does the same for the earthquakes that it is given.

    Try:
      shake plan napa2014_68150_hne
      shake plan mine.csv --units g --scenario laboratory --output out/mine
    """

    record: tyro.conf.Positional[str]
    """Name of an embedded record (shake list records), or a file of recorded motion."""
    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(
        default_factory=lambda: ScenarioOptions("laboratory")
    )
    motion_options: Annotated[MotionOptions, tyro.conf.arg(name="")] = field(
        default_factory=MotionOptions
    )

    def run(self, console: Console) -> dict[str, Any]:
        """Plan, write, draw."""
        from agents.reporting.figures.bound import draw_plan
        from baselines.planning.planned import plan_records
        from shake_env.records import RECORD_NAMES
        from shake_env.rollout import recorded_earthquakes

        scenario = self.scenario.build()
        if self.record in RECORD_NAMES:
            quakes = [q for q in recorded_earthquakes(scenario) if q.name == self.record]
        else:
            quakes = motion_earthquakes(
                [Path(self.record)], self.motion_options, scenario, scale=True, console=console
            )
        folder = self.results_folder("plan")
        with progress_bar() as bar:
            task = bar.add_task(f"plan, {self.record}", total=1.0)
            plans = plan_records(scenario, quakes, lambda share: bar.update(task, completed=share))
        result: dict[str, Any] = {"scenario": scenario.name, "plans": []}
        for plan in plans:
            k = plan.target.shape[1]
            missed = plan.response - np.hstack([plan.target, plan.shear])
            errors = [
                float(np.sqrt(np.mean(part**2) / np.mean(whole**2)))
                for part, whole in ((missed[:, :k], plan.target), (missed[:, k:], plan.shear))
            ]
            described: dict[str, Any] = {
                "name": plan.name,
                "cost": plan.cost,
                "acceleration_rms_error": errors[0],
                "base_shear_rms_error": errors[1],
                "peak_current": float(np.abs(plan.current).max()),
                "peak_displacement": float(np.abs(plan.state[:, 1]).max()),
            }
            result["plans"].append(described)
            console.print(
                escape(
                    f"{plan.name}: stage cost {plan.cost:.4g}, acceleration error "
                    f"{100 * errors[0]:.2f} %, base-shear error {100 * errors[1]:.2f} %, peak "
                    f"{1e3 * described['peak_displacement']:.1f} mm"
                )
            )
            if folder is not None:
                stem = re.sub(r"[^\w.-]+", "_", plan.name).strip("._") or "plan"
                plan.write(folder / f"{stem}.npz")
                console.print(escape(f"wrote {folder / f'{stem}.npz'}"))
                title = f"{plan.name}: planned, stage cost {plan.cost:.4g}"
                steps = (scenario.physics_step, scenario.control_period)
                wanted = (plan.target, plan.shear)
                drawn = draw_plan(
                    title, wanted, plan.response, plan.current, steps, folder, stem, scenario.input_unit
                )
                for path in drawn:
                    console.print(escape(f"wrote {path}"))
        return result
