"""The command ``shake plan``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
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
from shake_env.errors import ParameterError, RecordError, unknown
from shake_env.motion.targets import FilteredNoise, MotionSet, control_steps
from shake_env.records import RECORD_NAMES
from shake_env.rollout import Earthquake, recorded_earthquakes
from shake_env.scenario.scenario import Scenario

SEARCH_TIME = 0.5  # [s] of processor time that a second of motion takes, about, with friction
LONG, LONGEST = 300.0, 1200.0  # [s] of motion: the expected time is told, a plan is refused


@dataclass(frozen=True, kw_only=True)
class Plan(FolderOptions):
    """Plan a whole record before its test: the optimal currents on the nominal table, with feedback.

    Writes one file a channel with the currents, the signals to expect and the feedback along them, and
    its figure. The controller `planned` does the same for the earthquakes that it is given. A file is
    played from Python: PlannedControl(scenario, [RecordPlan.read(file)]), both of
    baselines.planning.planned, is a controller; docs/planning.md has an example.

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

    def earthquakes(self, scenario: Scenario, console: Console) -> list[Earthquake]:
        """Return what is planned: the embedded record, or every channel of the file.

        Raises
        ------
        ParameterError
            If an option of files is given with the name of an embedded record.
        RecordError
            If there is neither a record nor a file of that name, or the file cannot be read.
        """
        if self.record not in RECORD_NAMES:
            file = Path(self.record)
            if not file.suffix and not file.exists():
                known = unknown(RecordError, "record", self.record, RECORD_NAMES)
                raise RecordError("record", self.record, f"is no file; {known.remedy}")
            return motion_earthquakes([file], self.motion_options, scenario, scale=True, console=console)
        for option in fields(MotionOptions):
            value = getattr(self.motion_options, option.name)
            if value != option.default:
                remedy = f"applies to files; {self.record} is embedded, prepared as the scenario says"
                raise ParameterError(f"--{option.name.replace('_', '-')}", value, remedy)
        own = [quake for quake in recorded_earthquakes(scenario) if quake.name == self.record]
        # The motions of a scenario can be others: then it is taken as by one of filtered noise.
        plain = replace(scenario, motion=FilteredNoise())
        return own or [quake for quake in recorded_earthquakes(plain) if quake.name == self.record]

    def run(self, console: Console) -> dict[str, Any]:
        """Plan, write, draw."""
        from agents.reporting.figures.bound import draw_plan
        from baselines.planning.planned import plan_records

        scenario = self.scenario.build()
        quakes = self.earthquakes(scenario, console)
        check_durations(quakes, scenario, console)
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


def check_durations(quakes: Sequence[Earthquake], scenario: Scenario, console: Console) -> None:
    """Print how long planning takes if that is long.

    Raises
    ------
    ParameterError
        If an earthquake is longer than `LONGEST`.
    """
    durations = {
        quake.name: control_steps(quake.motion, scenario.control_period, scenario.physics_step)
        * scenario.control_period
        for quake in quakes
        if not isinstance(quake.motion, MotionSet)
    }
    name = max(durations, key=lambda each: durations[each])
    minutes = SEARCH_TIME * sum(durations.values()) / 60.0
    expected = f"planning takes about {minutes:.0f} min of processor time"
    if durations[name] > LONGEST:
        remedy = f"lasts {durations[name]:.0f} s ({expected}): cut it to {LONGEST:.0f} s at most"
        raise ParameterError("record", name, remedy)
    if sum(durations.values()) > LONG:
        console.print(f"{sum(durations.values()):.0f} s of motion: {expected}", highlight=False)
