"""The command ``shake compare``."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from agents.acceptance.options import AcceptanceOptions
from agents.cli.command_options import FolderOptions, tuned_values
from agents.cli.output_path import output_folder
from agents.motions.channels import MotionOptions, motion_earthquakes
from agents.motions.motion_set import read_motion_set
from agents.plain_values import plain
from agents.progress import progress_by_name
from agents.scenario_options import ScenarioOptions
from agents.seeds import COMPARISON_SEED
from shake_env.errors import ParameterError
from shake_env.rollout import Earthquake
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.tables import DEFAULT_TABLE

DEFAULT_CONTROLLERS = ("none", "ppo", "apg", "sac")
CLASSICAL = ("none", "pid", "tvc")


@dataclass(frozen=True, kw_only=True)
class Compare(FolderOptions):
    """Run controllers on the same earthquakes and compare their errors.

    Try:
      shake compare
      shake compare --stories 5 --mass-ratio 0.2 --controllers lqr none
      shake compare --controllers lqr ppo runs/mine --num-noise-motions 100 --output out/mine
      shake compare --motion CICLC.v1 --num-noise-motions 0 --no-records
      shake compare --report out/report
      shake compare --report out/report --acceptance.spectrum ac156 --acceptance.s-ds 0.5
      shake compare --json > comparison.json
    """

    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(default_factory=ScenarioOptions)
    controllers: tuple[str, ...] = DEFAULT_CONTROLLERS
    """Names of classical controllers, all (every one that suits the scenario), ppo, apg and sac (the
    policies that ship), paths of policy files and run directories, or module:Class and file.py:Class
    for one of one's own. The policies that ship were trained for the default table: on another one the
    default is none, pid and tvc. The reference (LQR, or LQG where signals are measured) always runs."""
    tuned: Path | None = None
    """File of tuned values that shake tune --output wrote, for a scenario that nothing was tuned on."""
    num_noise_motions: int = 32
    """Number of filtered-noise earthquakes."""
    records: bool = True
    """Whether the six embedded records, or the scenario's own, are among the earthquakes."""
    seed: int = COMPARISON_SEED
    """First seed of the filtered noise."""
    motion: tyro.conf.UseAppendAction[tuple[Path, ...]] = ()
    """File of recorded motion, each channel an earthquake; may be given again for further files."""
    motion_set: Path | None = None
    """Folder of a named test set of one's own records, described in its motions.toml with source,
    licence, SHA-256 and event of each file; costs are given by event as well."""
    scale: bool = True
    """Whether their amplitude is brought within the table, as `shake motion` reports it."""
    motion_options: Annotated[MotionOptions, tyro.conf.arg(name="motion")] = field(
        default_factory=MotionOptions
    )
    safety_supervisor: bool = False
    """Whether a supervisor keeps every controller within the scenario's hard limits."""
    bound: bool = False
    """Whether the true bound of each earthquake is computed, the least cost over all currents: 1 s of an
    earthquake, up to 10 s of a record. What was computed is kept in the user's cache."""
    report: Path | None = None
    """Folder for a report: one page to open in a browser, and its figures as SVG and PNG."""
    acceptance: AcceptanceOptions = field(default_factory=AcceptanceOptions)
    logs: Path | None = None
    """Folder for the log of every test as HDF5: what the sensors read, as shake identify takes it. The
    tests are run again for it."""
    robustness: Path | None = None
    """Result of shake robustness on the same scenario, such as docs/results/robustness_linear.json: the
    report shows it."""

    def run(self, console: Console) -> dict[str, Any]:
        """Compare, print, write."""
        from agents.evaluation.comparison import compare
        from agents.reporting.comparison_tables import print_tables, print_verdict, write_files
        from agents.reporting.report.contents import HistoryCollector, make_report
        from agents.reporting.report.page import write_report
        from agents.reporting.robustness_tables import read_robustness
        from shake_env.rollout import recorded_earthquakes

        if self.num_noise_motions < 0:
            raise ParameterError("num_noise_motions", self.num_noise_motions, "must be at least 0")
        scenario = self.scenario.build()
        unset = self.controllers == DEFAULT_CONTROLLERS
        chosen = CLASSICAL if unset and scenario.table != DEFAULT_TABLE else self.controllers
        folder = self.results_folder("compare")
        if self.report is not None:
            output_folder(self.report, self.report, force=self.force, field="report")
        if self.logs is not None:
            output_folder(self.logs, self.logs, force=self.force, field="logs")
        if self.acceptance.spectrum is not None and self.report is None:
            remedy = "is shown in a report: give --report, or take shake accept for a file"
            raise ParameterError("acceptance.spectrum", self.acceptance.spectrum, remedy)
        gathered = None if self.report is None else HistoryCollector(scenario, self.acceptance)
        perturbed = None if self.robustness is None else read_robustness(self.robustness, scenario.name)
        if perturbed is not None and gathered is None:
            raise ParameterError(
                "robustness", str(self.robustness), "is shown in a report: give --report"
            )
        motions = motion_earthquakes(
            self.motion, self.motion_options, scenario, scale=self.scale, console=console
        )
        events: list[str] = []
        if self.motion_set is not None:
            if motions:
                raise ParameterError("motion", [*map(str, self.motion)], "is no part of --motion-set")
            motions, events = read_motion_set(self.motion_set).earthquakes(
                self.motion_options, scenario, scale=self.scale, console=console
            )
        for quake in recorded_earthquakes(scenario) if self.records else ():
            if quake.motion.amplitude != 1.0:  # scaled to the table, or by the scenario
                console.print(f"record {quake.name}: amplitude x {quake.motion.amplitude:.4g}")
        with progress_by_name() as on_progress:
            result = compare(
                scenario,
                chosen,
                noise=self.num_noise_motions,
                records=self.records,
                seed=self.seed,
                motions=motions,
                events=events,
                supervised=self.safety_supervisor,
                tuned=tuned_values(self.tuned),
                bound=self.bound,
                on_progress=on_progress,
                on_histories=gathered or (lambda controller, histories: None),
            )
        if self.logs is not None:
            self._write_logs(scenario, chosen, motions, console)
        settings = plain(asdict(self))
        print_tables(result, console)
        print_verdict(result, scenario, console)
        if folder is not None:
            for path in write_files(result, settings, folder):
                console.print(f"wrote {path}")
        if gathered is not None and self.report is not None:
            command = shlex.join(["shake", *sys.argv[1:]])
            written = write_report(make_report(result, gathered, command, perturbed), self.report)
            console.print(f"wrote {written[0]} and {len(written) - 1} figures: open it in a browser")
        return result.to_json(settings)

    def _write_logs(
        self, scenario: Scenario, names: Sequence[str], motions: list[Earthquake], console: Console
    ) -> None:
        from agents.laboratory.logs.simulated import write_logs
        from shake_env.rollout import noise_earthquakes, recorded_earthquakes

        assert self.logs is not None  # the caller asked
        recorded = recorded_earthquakes(scenario) if self.records else []
        quakes = [*motions, *recorded, *noise_earthquakes(scenario, self.num_noise_motions, self.seed)]
        with progress_by_name() as on_progress:
            written = write_logs(
                scenario,
                names,
                quakes,
                self.logs,
                tuned=tuned_values(self.tuned),
                supervised=self.safety_supervisor,
                on_progress=on_progress,
            )
        console.print(f"wrote {len(written)} logs to {self.logs}")
