"""Controllers on the same earthquakes: figures with intervals, as data.

Printing is `agents.reporting.comparison_tables`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.evaluation.bound_store import Bounds, earthquake_bounds
from agents.evaluation.controller_set import get_controllers, require_names
from agents.evaluation.fidelity import Fidelity, fidelity
from agents.evaluation.latency import decision_time
from agents.evaluation.results import Comparison, GroupSummary
from agents.evaluation.statistics import _interval, _mean, _ratio
from agents.evaluation.tracking import TrackingFigures, tracking_figures
from agents.policies.registry import ORACLE, find_controller, get_driven, information_of
from agents.run_directory import names_in_words
from agents.seeds import COMPARISON_SEED
from baselines.information import scenario_information
from baselines.iterative.drive_file import DriveFile
from baselines.tuned_values import TunedValues
from shake_env.errors import ParameterError
from shake_env.motion.targets import RecordedMotion
from shake_env.rollout import Earthquake, noise_earthquakes, recorded_earthquakes, rollout
from shake_env.safety.supervisor import Supervised
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.metrics import EpisodeMetrics
from shake_env.simulation.trajectory import Trajectory

FIGURES = (
    "acceleration_rms_error",
    "acceleration_peak_error",
    "base_shear_rms_error",
    "base_shear_peak_error",
)
PEAKS = ("peak_current", "peak_velocity", "peak_displacement")
Histories = Sequence[tuple[Earthquake, Trajectory]]


def compare(
    scenario: Scenario,
    names: Sequence[str],
    *,
    noise: int = 32,
    records: bool = True,
    seed: int = COMPARISON_SEED,
    motions: Sequence[Earthquake] = (),
    events: Sequence[str] = (),
    supervised: bool = False,
    tuned: TunedValues | None = None,
    bound: bool = False,
    on_progress: Callable[[str, float], None] = lambda controller, share: None,
    on_histories: Callable[[str, Histories], None] = lambda controller, histories: None,
) -> Comparison:
    """Run every controller on the same earthquakes.

    Parameters
    ----------
    scenario
        What is driven.
    names
        See :func:`get_controllers`.
    noise
        Number of seeded filtered-noise earthquakes.
    records
        Whether the embedded records are among the earthquakes.
    seed
        First seed of the noise; far from those of training and its evaluation.
    motions
        Further earthquakes, a group of their own; the first of them is traced.
    events
        Event of each motion; none: they have no events.
    supervised
        Whether a `Supervised` keeps every controller within the hard limits.
    tuned
        Tuned values of a file that was named; see `baselines.registry.parameter_values`.
    bound
        Whether the true bound of every earthquake is computed; see `bound_store`.
    on_progress
        Told the controller that runs, or ``bound``, and its share done, 0 to 1.
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
    chosen = get_controllers(names, scenario, earthquakes, tuned)
    controllers = dict(chosen.controllers)
    reference = next(iter(controllers))
    damage = {
        name: each.damage
        for name, each in controllers.items()
        if isinstance(each, DriveFile) and each.damage is not None
    }
    driven = dict.fromkeys(controllers, scenario)
    if chosen.oracle:
        driven[ORACLE], controllers[ORACLE] = get_driven(ORACLE, scenario, earthquakes)
    episodes: dict[str, list[EpisodeMetrics]] = {}
    fidelities: dict[str, list[Fidelity]] = {}
    tracking: dict[str, list[TrackingFigures]] = {}
    latency: dict[str, float] = {}
    shares: dict[str, float] = {}
    traces: dict[str, Trajectory] = {}
    if supervised:
        controllers = {name: Supervised(c, driven[name]) for name, c in controllers.items()}
    for name, controller in controllers.items():

        def report(share: float, name: str = name) -> None:
            on_progress(name, share)

        episodes[name], histories = rollout(
            controller, driven[name], earthquakes, record=range(len(earthquakes)), on_step=report
        )
        traces[name] = histories[traced]
        if isinstance(controller, Supervised):
            shares[name] = controller.interventions().share
        step = scenario.physics_step
        on_histories(name, [(quake, histories[i]) for i, quake in enumerate(earthquakes)])
        fidelities[name] = [fidelity(histories[i], step) for i in range(len(earthquakes))]
        tracking[name] = [tracking_figures(histories[i], step) for i in range(len(earthquakes))]
        # What is made for each lane's own earthquake or plant has no decision for one table to time.
        untimed = find_controller(name).needs_earthquakes
        latency[name] = float("nan") if untimed else decision_time(controller, scenario)
    bounds = None
    if bound:
        bounds = earthquake_bounds(
            scenario, earthquakes, on_progress=lambda share: on_progress("bound", share)
        )
    summaries = [
        replace(
            summarise(
                name,
                group,
                [rows[i] for i in members],
                [episodes[reference][i] for i in members],
                [fidelities[name][i] for i in members],
                latency[name],
                find_controller(name).tests,
                damage[name][list(members)] if name in damage else None,
            ),
            information=information_of(name, scenario),
            **_over_bound(rows, episodes[reference], bounds, members),
        )
        for group, members in groups.items()
        if len(members)
        for name, rows in episodes.items()
    ]
    name = earthquakes[traced].name
    of_each = [group for group, members in groups.items() for _ in members]
    return Comparison(
        summaries, episodes, fidelities, traces, reference, name, chosen.skipped, shares, of_each,
        chosen.values, [*chosen.warnings, *repeated_motions(earthquakes)], tracking, bounds,
        scenario_information(scenario), scenario.input_unit, tuple(events),
    )  # fmt: skip


def _over_bound(
    rows: Sequence[EpisodeMetrics],
    reference: Sequence[EpisodeMetrics],
    bounds: Bounds | None,
    members: Sequence[int],
) -> dict[str, Any]:
    """Return a controller's cost over the bound on a group, and what it saves of the regret."""
    if bounds is None or bounds.reason:
        return {}
    cost, base = (np.array([each[i].cost for i in members]) for each in (rows, reference))
    least = bounds.costs[list(members)]
    low, high = _interval(cost, least)
    regret = base.sum() - least.sum()
    return {
        "bound_cost": _ratio(cost, least),
        "bound_cost_low": low,
        "bound_cost_high": high,
        "regret_closed": float((base.sum() - cost.sum()) / regret) if regret > 0.0 else float("nan"),
    }


def repeated_motions(earthquakes: Sequence[Earthquake]) -> list[str]:
    """Return a sentence that names the recorded motions which repeat another one; empty: none does."""
    first: dict[Any, str] = {}
    copies = []
    for quake in earthquakes:
        motion = quake.motion
        if not isinstance(motion, RecordedMotion):
            continue
        record = motion.source
        options = [getattr(motion, f.name) for f in fields(motion) if f.name != "record"]
        key = (record.digest, record.sampling_interval, *options)
        if key in first:
            copies.append(f"{quake.name} repeats {first[key]}")
        first.setdefault(key, quake.name)
    if not copies:
        return []
    number = len(first) + len(copies)
    return [
        f"of {number} recorded motions {len(first)} are distinct ({names_in_words(copies)}): "
        "copies count in means and make intervals too narrow"
    ]


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
    figures: dict[str, Any] = {
        **{each.name: _mean([getattr(f, each.name) for f in repeated]) for each in fields(Fidelity)},
        **{figure: float(np.mean([getattr(row, figure) for row in rows])) for figure in FIGURES},
        **{peak: float(np.max([getattr(row, peak) for row in rows])) for peak in PEAKS},
    }
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
        **figures,
    )
