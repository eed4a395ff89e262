"""Controllers on the same earthquakes: figures with intervals, as data. Printing is `compare_output`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap

import shake_env
from agents.controller_set import (
    CLAIRVOYANT,
    describe_values,
    named_controllers,
    require_names,
    values_to_json,
)
from agents.fidelity import Fidelity, fidelity
from agents.frames import Rows, to_frame
from baselines.catalogue import BASELINES
from baselines.clairvoyant import clairvoyant
from baselines.drive_file import DriveFile
from baselines.registry import ParameterValues
from baselines.tuned_values import TunedValues
from shake_env.controller import Controller, decide
from shake_env.errors import ParameterError
from shake_env.metrics import EpisodeMetrics
from shake_env.rollout import Earthquake, noise_earthquakes, recorded_earthquakes, rollout
from shake_env.scenario import Scenario
from shake_env.simulation import Simulation
from shake_env.supervisor import Supervised
from shake_env.trajectory import Trajectory

if TYPE_CHECKING:
    from pandas import DataFrame

FIGURES = (
    "acceleration_rms_error",
    "acceleration_peak_error",
    "base_shear_rms_error",
    "base_shear_peak_error",
)
PEAKS = ("peak_current", "peak_velocity", "peak_displacement")
Histories = Sequence[tuple[Earthquake, Trajectory]]


@dataclass(frozen=True)
class GroupSummary:
    """One controller over one group of earthquakes."""

    controller: str
    group: str  # "motions", "records" or "filtered noise"
    earthquakes: int
    relative_cost: float  # summed cost over the reference's summed cost on the same earthquakes [-]
    relative_cost_low: float  # 95 % bootstrap interval over earthquakes, paired; NaN: of one earthquake
    relative_cost_high: float
    mean_cost: float
    acceleration_rms_error: float  # mean over earthquakes, relative to the target's rms [-]
    acceleration_peak_error: float
    base_shear_rms_error: float
    base_shear_peak_error: float
    peak_current: float  # largest over earthquakes [A]
    peak_velocity: float  # [m/s]
    peak_displacement: float  # [m]
    broken_limits: int  # episodes that a limit ended
    delay: float  # means over earthquakes of `fidelity.Fidelity`; [s]
    spectral_error: float
    arias_ratio: float
    drift_ratio: float
    energy_ratio: float
    decision_time: float  # [s] of the processor, median of one decision for one table; NaN: prepared
    tests: int  # of each earthquake that it takes, the one that counts included
    damage: float  # median energy of the tests before that over one perfect test's [-]; NaN: none

    def cost_text(self) -> str:
        """Return the relative cost with its interval; of one earthquake without."""
        return cost_text(self.relative_cost, self.relative_cost_low, self.relative_cost_high)


@dataclass(frozen=True)
class Comparison:
    """All controllers on all earthquakes."""

    summaries: list[GroupSummary]
    episodes: dict[str, list[EpisodeMetrics]]  # by controller, in the order of the earthquakes
    fidelities: dict[str, list[Fidelity]]  # likewise
    traces: dict[str, Trajectory]  # by controller, on `traced`
    reference: str  # controller that costs are relative to
    traced: str  # name of the earthquake that was traced
    skipped: list[str]  # what was left out, and why
    interventions: dict[str, float]  # by controller: share of commands that a supervisor changed
    groups: list[str]  # of each earthquake, in their order
    values: dict[str, ParameterValues] = field(default_factory=dict)  # by controller, with their source
    warnings: list[str] = field(default_factory=list)  # policies far from what they were trained on

    def to_json(self, settings: dict[str, Any]) -> dict[str, Any]:
        """Return everything but the traces as plain JSON values."""
        return {
            "version": shake_env.__version__,
            "settings": settings,
            "summaries": [plain_row(asdict(summary)) for summary in self.summaries],
            "episodes": {
                name: [
                    plain_row(asdict(m) | asdict(f))
                    for m, f in zip(rows, self.fidelities[name], strict=True)
                ]
                for name, rows in self.episodes.items()
            },
            "reference": self.reference,
            "traced": self.traced,
            "skipped": self.skipped,
            "interventions": self.interventions,
            "values": values_to_json(self.values),
            "warnings": self.warnings,
        }

    def notes(self) -> list[str]:
        """Return what a reader has to know of the controllers, in sentences."""
        values = describe_values(values_to_json(self.values))
        return ([values] if values else []) + [f"Warning: {text}." for text in self.warnings]

    def to_frame(self, rows: Rows = "episodes") -> DataFrame:
        """Return episodes, summaries or traces as a pandas frame; see `agents.frames`."""
        return to_frame(self, rows)


def decision_time(controller: Controller, scenario: Scenario, decisions: int = 200) -> float:
    """Return the median processor time [s] of one decision for one table, in its episode.

    Processor time, so that other work on the machine is not counted as the controller's.
    """
    simulation = Simulation(scenario, 1)
    observation = simulation.start([0], [np.random.default_rng(0)])
    memory, start, times = None, np.ones(1, dtype=bool), []
    for _ in range(min(decisions, int(simulation.episode_steps[0]))):
        began = time.process_time()
        action, memory = decide(controller, observation[0], memory, start)
        times.append(time.process_time() - began)
        start = np.zeros(1, dtype=bool)
        observation = simulation.step(np.asarray(action, dtype=float)).observation
    return float(np.median(times))


def compare(
    scenario: Scenario,
    names: Sequence[str],
    *,
    noise: int = 32,
    records: bool = True,
    seed: int = 2_000_000,
    motions: Sequence[Earthquake] = (),
    supervised: bool = False,
    tuned: TunedValues | None = None,
    on_progress: Callable[[str, float], None] = lambda controller, share: None,
    on_histories: Callable[[str, Histories], None] = lambda controller, histories: None,
) -> Comparison:
    """Run every controller on the same earthquakes.

    Parameters
    ----------
    scenario
        What is driven.
    names
        See :func:`named_controllers`.
    noise
        Number of seeded filtered-noise earthquakes.
    records
        Whether the embedded records are among the earthquakes.
    seed
        First seed of the noise; far from those of training and its evaluation.
    motions
        Further earthquakes, a group of their own; the first of them is traced.
    supervised
        Whether a `Supervised` keeps every controller within the hard limits.
    tuned
        Tuned values of a file that was named; see `baselines.registry.parameter_values`.
    on_progress
        Told the controller that runs and its share done, 0 to 1.
    on_histories
        Shown each controller's (earthquake, trajectory) pairs when it has run. They are not kept: those
        of all controllers would fill a machine's memory.

    Raises
    ------
    ParameterError
        If no earthquake is asked for, or no controller.
    """
    require_names(names)
    recorded = recorded_earthquakes(scenario) if records else []
    earthquakes = [*motions, *recorded, *noise_earthquakes(scenario, noise, seed)]
    if not earthquakes:
        raise ParameterError("noise", noise, "ask for at least one earthquake, or for the records")
    noisy = len(motions) + len(recorded)
    groups = {
        "motions": range(len(motions)),
        "records": range(len(motions), noisy),
        "filtered noise": range(noisy, len(earthquakes)),
    }
    traced = _strongest(recorded) if recorded and not motions else 0
    chosen = named_controllers(names, scenario, earthquakes, tuned)
    controllers = dict(chosen.controllers)
    reference = next(iter(controllers))
    damage = {
        name: each.damage
        for name, each in controllers.items()
        if isinstance(each, DriveFile) and each.damage is not None
    }
    driven = dict.fromkeys(controllers, scenario)
    if CLAIRVOYANT in names:
        driven[CLAIRVOYANT], controllers[CLAIRVOYANT] = clairvoyant(scenario, earthquakes)
    episodes: dict[str, list[EpisodeMetrics]] = {}
    fidelities: dict[str, list[Fidelity]] = {}
    latency: dict[str, float] = {}
    shares: dict[str, float] = {}
    traces: dict[str, Trajectory] = {}
    if supervised:
        controllers = {name: Supervised(c, driven[name]) for name, c in controllers.items()}
    for name, controller in controllers.items():

        def told(share: float, name: str = name) -> None:
            on_progress(name, share)

        episodes[name], found = rollout(
            controller, driven[name], earthquakes, record=range(len(earthquakes)), on_step=told
        )
        traces[name] = found[traced]
        if isinstance(controller, Supervised):
            shares[name] = controller.interventions().share
        step, stories = scenario.physics_step, scenario.specimen.stories
        on_histories(name, [(quake, found[i]) for i, quake in enumerate(earthquakes)])
        fidelities[name] = [fidelity(found[i], step, stories) for i in range(len(earthquakes))]
        # What is made for each lane's own earthquake or plant has no decision for one table to time.
        own = name == CLAIRVOYANT or (name in BASELINES and BASELINES[name].repeats_tests)
        latency[name] = float("nan") if own else decision_time(controller, scenario)
    summaries = [
        summarise(
            name,
            group,
            [rows[i] for i in members],
            [episodes[reference][i] for i in members],
            [fidelities[name][i] for i in members],
            latency[name],
            BASELINES[name].tests if name in BASELINES else 1,
            damage[name][list(members)] if name in damage else None,
        )
        for group, members in groups.items()
        if len(members)
        for name, rows in episodes.items()
    ]
    name = earthquakes[traced].name
    of_each = [group for group, members in groups.items() for _ in members]
    return Comparison(
        summaries, episodes, fidelities, traces, reference, name, chosen.skipped, shares, of_each,
        chosen.values, chosen.warnings,
    )  # fmt: skip


def _strongest(recorded: Sequence[Earthquake]) -> int:
    names = [quake.name for quake in recorded]
    strongest = "ridgecrest2019_clc_360"
    return names.index(strongest) if strongest in names else 0


def summarise(
    name: str,
    group: str,
    rows: Sequence[EpisodeMetrics],
    reference: Sequence[EpisodeMetrics],
    repeated: Sequence[Fidelity],
    latency: float,
    tests: int = 1,
    damage: NDArray[np.float64] | None = None,
) -> GroupSummary:
    """Return one controller's figures over a group, its cost relative to `reference`'s, paired.

    `tests` of each earthquake, the one that counts included, and the `damage` (earthquakes,) of those
    before it, are what a controller took that repeats its tests.
    """
    cost = np.asarray([row.cost for row in rows])
    base = np.asarray([row.cost for row in reference])
    low, high = _interval(cost, base)
    means = {figure: float(np.mean([getattr(row, figure) for row in rows])) for figure in FIGURES}
    measures = {each.name: _mean([getattr(f, each.name) for f in repeated]) for each in fields(Fidelity)}
    peaks = {peak: float(np.max([getattr(row, peak) for row in rows])) for peak in PEAKS}
    return GroupSummary(
        controller=name,
        group=group,
        earthquakes=len(rows),
        relative_cost=_ratio(cost, base),
        relative_cost_low=low,
        relative_cost_high=high,
        mean_cost=float(cost.mean()),
        broken_limits=sum(row.broken_limit is not None for row in rows),
        decision_time=latency,
        tests=tests,
        damage=float("nan") if damage is None else float(np.median(damage)),
        **measures,
        **means,
        **peaks,
    )


def cost_ratio(
    rows: Sequence[EpisodeMetrics], others: Sequence[EpisodeMetrics]
) -> tuple[float, float, float]:
    """Return summed cost over the others' on the same earthquakes, with its 95 % interval."""
    cost, base = np.asarray([r.cost for r in rows]), np.asarray([r.cost for r in others])
    return (float(_ratio(cost, base)), *_interval(cost, base))


def cost_text(value: float, low: float | None, high: float | None) -> str:
    """Return a cost with its interval in words, without one where there is none."""
    known = low is not None and high is not None and low == low
    digits = 3 if (high if known and high is not None else value) < 10.0 else 1
    return f"{value:.{digits}f}" + (f" [{low:.{digits}f}, {high:.{digits}f}]" if known else "")


def plain_row(row: dict[str, Any]) -> dict[str, Any]:
    """Return a row for JSON, which has no NaN: what is not defined (a still table's lag) is null."""
    return {key: None if value != value else value for key, value in row.items()}


def _mean(values: Sequence[float]) -> float:
    known = np.asarray(values)[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")


def _ratio(cost: NDArray[np.float64], base: NDArray[np.float64], axis: int = -1) -> Any:
    return np.sum(cost, axis=axis) / np.sum(base, axis=axis)


def _interval(cost: NDArray[np.float64], base: NDArray[np.float64]) -> tuple[float, float]:
    """Return the 95 % percentile-bootstrap interval of the cost ratio; NaN of one earthquake."""
    if len(cost) < 2:
        return float("nan"), float("nan")
    if np.array_equal(cost, base):
        return 1.0, 1.0
    result = bootstrap(
        (cost, base), _ratio, paired=True, vectorized=True, method="percentile", n_resamples=9999,
        rng=np.random.default_rng(0),
    )  # fmt: skip
    return float(result.confidence_interval.low), float(result.confidence_interval.high)
