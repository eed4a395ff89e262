"""A comparison as a report: what its page and its figures show, gathered while the controllers run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.acceptance.clauses import Acceptance, accept
from agents.acceptance.options import AcceptanceOptions
from agents.evaluation.comparison import Histories
from agents.evaluation.fidelity import spectrum
from agents.evaluation.results import Comparison, drive_column
from agents.evaluation.statistics import mean_interval
from agents.policies.policy_file import PolicyFile, load_policy
from agents.policies.registry import ORACLE, SHIPPED, policy_path
from agents.reporting.report.estimates import SampledParameters, TransferEstimate, lqr_frontier
from agents.reporting.report.traces import Channel, Curves, achieved_curves, target_curves
from agents.reporting.summary_text import Verdict, verdict
from agents.run_directory import learning_curve
from shake_env.errors import PolicyFileError
from shake_env.rollout import Earthquake
from shake_env.scenario.digest import known_name
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.trajectory import Trajectory

FloatArray = NDArray[np.float64]


class HistoryCollector:
    """What is kept of every controller's histories; its call is `compare`'s ``on_histories``.

    Parameters
    ----------
    scenario
        What is driven.
    acceptance
        What the table's acceleration is held against; None, or no spectrum named: nothing.
    """

    def __init__(self, scenario: Scenario, acceptance: AcceptanceOptions | None = None) -> None:
        self.scenario = scenario
        self.criterion = acceptance or AcceptanceOptions()
        self.required = self.criterion.required()
        # By controller and earthquake; None where the table did not move.
        self.acceptances: dict[str, list[Acceptance | None]] = {}
        self.drift = scenario.nonlinearity.yielding.active
        self.earthquakes: list[Earthquake] = []
        self.targets: list[Curves] = []  # of each earthquake, from the test that lasted longest
        self.target_spectra: list[FloatArray] = []  # likewise, (periods,) [m/s^2]
        self.runs: dict[str, list[Curves]] = {}  # by controller
        self.spectra: dict[str, list[FloatArray]] = {}
        self.transfer: dict[str, TransferEstimate] = {}

    def __call__(self, name: str, histories: Histories) -> None:
        """Keep what the report needs of a controller's histories."""
        step, (*_, factor) = self.scenario.physics_step, drive_column(self.scenario.input_unit)
        self.earthquakes = [quake for quake, _ in histories]
        self.runs[name] = [achieved_curves(t, self.drift, factor) for _, t in histories]
        self.spectra[name] = [spectrum(t.table_acceleration, step) for _, t in histories]
        if self.required is not None:
            self.acceptances[name] = [self._held(quake, t) for quake, t in histories]
        estimate = self.transfer[name] = TransferEstimate(step)
        for i, (_, trajectory) in enumerate(histories):
            estimate.add(trajectory)
            self._keep_target(i, trajectory)

    def _held(self, quake: Earthquake, trajectory: Trajectory) -> Acceptance | None:
        motion, rules = trajectory.table_acceleration, self.criterion.rules
        if self.required is None or not np.any(motion):
            return None
        return accept([motion], self.scenario.physics_step, self.required, rules, [quake.name])

    def _keep_target(self, i: int, trajectory: Trajectory) -> None:
        new = i == len(self.targets)
        if not new and len(trajectory.current) <= len(self.targets[i].values["acceleration"]):
            return
        curves = target_curves(trajectory, self.drift)
        ordinates = spectrum(trajectory.target_acceleration, self.scenario.physics_step)
        if new:
            self.targets.append(curves)
            self.target_spectra.append(ordinates)
        else:
            self.targets[i], self.target_spectra[i] = curves, ordinates


@dataclass(frozen=True)
class TradeOff:
    """One controller's errors over a group of earthquakes, as means with 95 % intervals."""

    acceleration: tuple[float, float, float]  # [-] of the target's rms
    base_shear: tuple[float, float, float]


@dataclass(frozen=True)
class Report:
    """Everything that a page and its figures show."""

    comparison: Comparison
    scenario: Scenario
    gathered: HistoryCollector
    verdict: Verdict
    labels: dict[str, str]  # of controllers, each its own
    channels: tuple[Channel, ...]
    trade_off: dict[str, TradeOff]  # by controller, on the verdict's group
    frontier: list[tuple[float, float]]
    drawn: SampledParameters
    learning: dict[str, list[tuple[int, float]]]  # by controller that has a curve
    policies: dict[str, PolicyFile]  # by controller that is one
    command: str
    robustness: dict[str, Any] | None = None  # a result of `robustness` on the same scenario

    @property
    def controllers(self) -> list[str]:
        """Names, in the order in which they ran."""
        return list(self.comparison.episodes)

    @property
    def members(self) -> list[int]:
        """Indices of the verdict's earthquakes."""
        return [i for i, g in enumerate(self.comparison.groups) if g == self.verdict.group]

    @property
    def shown(self) -> list[str]:
        """At most four controllers that curves begin with: the best, the reference, the next best."""
        rows = {s.controller: s.relative_cost for s in self.comparison.summaries
                if s.group == self.verdict.group}  # fmt: skip
        by_cost = sorted((n for n in rows if n not in ("none", ORACLE)), key=lambda n: rows[n])
        first = dict.fromkeys([self.verdict.winner, self.comparison.reference, *by_cost])
        chosen = list(first)[:4]
        return [name for name in self.controllers if name in chosen]


def make_report(
    comparison: Comparison,
    gathered: HistoryCollector,
    command: str,
    robustness: dict[str, Any] | None = None,
) -> Report:
    """Return the report of a comparison whose histories were `gathered`.

    Parameters
    ----------
    comparison
        Of the same controllers and earthquakes.
    gathered
        What the comparison's ``on_histories`` was.
    command
        The command line that made it.
    robustness
        A result of ``shake robustness`` on the same scenario, shown if it is given.
    """
    scenario = gathered.scenario
    labels = unique_labels(list(comparison.episodes))
    judgement = verdict(comparison, scenario, labels.__getitem__)
    members = [i for i, group in enumerate(comparison.groups) if group == judgement.group]
    trade_off = {}
    for name, rows in comparison.episodes.items():
        errors = np.array(
            [(rows[i].acceleration_rms_error, rows[i].base_shear_rms_error) for i in members]
        )
        trade_off[name] = TradeOff(mean_interval(errors[:, 0]), mean_interval(errors[:, 1]))
    learning = {name: learning_curve(name) for name in comparison.episodes}
    return Report(
        comparison=comparison,
        scenario=scenario,
        gathered=gathered,
        verdict=judgement,
        labels=labels,
        channels=report_channels(scenario),
        trade_off=trade_off,
        # It is of filtered noise; under other motions a law may do better, or worse.
        frontier=lqr_frontier(scenario) if judgement.group == "filtered noise" else [],
        drawn=SampledParameters.from_scenario(scenario, gathered.earthquakes),
        learning={name: curve for name, curve in learning.items() if len(curve) > 1},
        policies=policy_files_of(comparison.episodes, known_name(scenario)),
        command=command,
        robustness=robustness,
    )


def report_channels(scenario: Scenario) -> tuple[Channel, ...]:
    """Return the panels of a report's curves over time, with the scenario's limits."""
    limits, valve = scenario.limits, scenario.nonlinearity.valve
    pressure = limits.load_pressure
    if pressure is None and np.isfinite(valve.supply_pressure):
        pressure = valve.supply_pressure
    stroke = limits.table_displacement
    name, unit, factor = drive_column(scenario.input_unit)
    drive = ("valve current" if name == "current" else name, unit)

    def scaled(value: float | None, factor: float) -> float | None:
        return None if value is None else factor * value

    return (
        Channel("acceleration", "table acceleration", "m/s²", limits.table_acceleration, targeted=True),
        Channel("shear", "base shear", "kN", targeted=True),
        Channel("current", *drive, factor * scenario.current_limit),
        Channel("pressure", "load pressure", "MPa", scaled(pressure, 1e-6)),
        Channel("stroke", "stroke", "mm", scaled(stroke, 1e3)),
    )


def unique_labels(names: Sequence[str]) -> dict[str, str]:
    """Return a short label of each controller of a report: of a path, the end that tells it apart."""
    parts: dict[str, list[str]] = {}
    for name in names:
        path = Path(name)
        if "/" not in name and path.suffix == "":
            parts[name] = [name.upper() if name in ("lqr", "lqg") else name]
            continue
        own = [*path.parent.parts, path.stem if path.suffix == ".safetensors" else path.name]
        # A run's own file is called by the run.
        parts[name] = own[:-1] if own[-1] == "policy" and len(own) > 1 else own

    def end(name: str, count: int) -> str:
        return "/".join(parts[name][-count:])

    labels = {}
    for name in names:
        count = 1
        others = [other for other in names if other != name]
        while count < len(parts[name]) and any(end(o, count) == end(name, count) for o in others):
            count += 1
        labels[name] = end(name, count)
    return labels


def policy_files_of(episodes: Iterable[str], scenario_name: str) -> dict[str, PolicyFile]:
    """Return the policies among the controllers' names, those that ship as the scenario has them."""
    files = {}
    for name in episodes:
        file = policy_path(name, scenario_name)
        if name not in SHIPPED and file.suffix != ".safetensors":
            continue
        try:
            files[name] = load_policy(file)
        except PolicyFileError:
            continue  # moved since it ran: the report does without its card
    return files
