"""True bounds of a scenario's earthquakes beside its reference, and what theory says of causal laws."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from baselines.lqr.preview import preview_lqr
from baselines.lqr.sampled import sampled_lqr
from baselines.planning.bound import OptimalEpisode, optimal_episodes
from baselines.planning.episodes import driven
from baselines.registry import make_baseline, reference_name
from shake_env.errors import ParameterError
from shake_env.motion.targets import FilteredNoise
from shake_env.rollout import Earthquake, noise_earthquakes, recorded_earthquakes
from shake_env.scenario.scenario import Scenario


def seeded_earthquakes(scenario: Scenario, first: int, end: int) -> list[Earthquake]:
    """Return the earthquakes of seeds `first` to `end` - 1; recorded motions are numbered from 0.

    Raises
    ------
    ParameterError
        If a scenario of recorded motions has none of these numbers.
    """
    if isinstance(scenario.motion, FilteredNoise):
        return noise_earthquakes(scenario, end - first, first)
    recorded = recorded_earthquakes(scenario)
    chosen = recorded[first:end]
    if not chosen:
        raise ParameterError("seeds", (first, end), f"the scenario's motions are 0 to {len(recorded)}")
    return chosen


def bound_of(
    scenario: Scenario, first: int, end: int, on_step: Callable[[float], None]
) -> tuple[dict[str, Any], list[OptimalEpisode]]:
    """Return the bounds of seeds `first` to `end` - 1 as plain values, and the optima themselves."""
    quakes = seeded_earthquakes(scenario, first, end)
    name = reference_name(scenario)
    _, reference, lost = driven(make_baseline(name, scenario), scenario, quakes)
    optima = optimal_episodes(scenario, quakes, on_step=on_step)
    result = {
        "scenario": scenario.name,
        "seeds": [first, end],
        "earthquakes": [quake.name for quake in quakes],
        "costs": [each.cost for each in optima],
        "reference": name,
        "reference_costs": reference,
        "reference_lost": lost,
        "disagreements": [each.disagreement for each in optima],
        "seconds": [max(start.seconds for start in each.starts) for each in optima],
        "starts": [[vars(start) for start in each.starts] for each in optima],
        "causal_bound": causal_bound(scenario),
    }
    return result, optima


def causal_bound(scenario: Scenario) -> dict[str, Any]:
    """Return the least expected stage cost of a law with the scenario's own information.

    Exact where the table is linear, fully seen, without delay and limits, and the motion stationary
    noise of unit amplitude: the cost of preview LQR. Elsewhere there is no theory that gives it.
    """
    exact = (
        not scenario.nonlinearity.active
        and scenario.sensing.full_state
        and not scenario.delay
        and not scenario.uncertainty.active
        and scenario.limits.table_displacement is None
        and isinstance(scenario.motion, FilteredNoise)
        and scenario.motion.envelope is None
    )
    if not exact:
        text = "not known: the table is not linear, or not fully seen; the least that a controller of "
        return {"cost": None, "exact": False, "text": text + "the bench costs is the best attained"}
    sensing, motion = scenario.sensing, scenario.motion
    assert isinstance(motion, FilteredNoise)
    if sensing.preview:
        design = preview_lqr(
            scenario.discrete, scenario.stage_cost, sensing.preview, sensing.preview_spacing
        )
        cost = design.analytic_cost
    else:
        cost = sampled_lqr(scenario.discrete, scenario.stage_cost).analytic_cost
    cost *= motion.amplitude**2
    text = f"{cost:.6g} is the least expected stage cost of any causal law (stationary, by analysis)"
    return {"cost": cost, "exact": True, "text": text}
