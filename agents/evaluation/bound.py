"""True bounds of a scenario's earthquakes beside its reference, and what theory says of causal laws."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from agents.evaluation.bound_store import earthquake_bounds
from baselines.information import scenario_information
from baselines.lqr.preview import preview_lqr
from baselines.lqr.sampled import sampled_lqr
from baselines.planning.episodes import driven
from baselines.registry import make_baseline, reference_name
from shake_env.errors import ParameterError, ScenarioError
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
    scenario: Scenario, first: int, end: int, on_progress: Callable[[float], None]
) -> dict[str, Any]:
    """Return the bounds of seeds `first` to `end` - 1 beside the reference's costs, as plain values.

    Raises
    ------
    ScenarioError
        If the equations are not the corrected ones.
    """
    quakes = seeded_earthquakes(scenario, first, end)
    name = reference_name(scenario)
    _, reference, lost = driven(make_baseline(name, scenario), scenario, quakes)
    bounds = earthquake_bounds(scenario, quakes, on_progress=on_progress)
    if bounds.reason:
        raise ScenarioError("scenario", scenario.name, f"has no bound: {bounds.reason}")
    episodes = bounds.episodes
    return {
        "scenario": scenario.name,
        "seeds": [first, end],
        "earthquakes": [quake.name for quake in quakes],
        "costs": [each.cost for each in episodes],
        "reference": name,
        "reference_costs": reference,
        "reference_lost": lost,
        "disagreements": [each.disagreement for each in episodes],
        "seconds": [max(start.seconds for start in each.starts) for each in episodes],
        "starts": [[vars(start) for start in each.starts] for each in episodes],
        "causal_bound": causal_bound(scenario),
    }


def optimal_cost(scenario: Scenario) -> float | None:
    """Return the analytic optimum J* of the stage cost, or None where there is none.

    There is one for a linear plant that is known, fully seen and answers at once, with or without
    preview, under a stationary motion and without a limited stroke. The reference is then optimal
    among all laws with the scenario's information.
    """
    motion = scenario.motion
    suits = (
        scenario.sensing.full_state
        and not scenario.delay
        and not scenario.nonlinearity.active
        and not scenario.uncertainty.active
        and scenario.limits.table_displacement is None
        and isinstance(motion, FilteredNoise)
        and motion.envelope is None
    )
    if not suits:
        return None
    if preview := scenario.sensing.preview:
        spacing = scenario.sensing.preview_spacing
        cost = preview_lqr(scenario.discrete, scenario.stage_cost, preview, spacing).analytic_cost
    else:
        cost = sampled_lqr(scenario.discrete, scenario.stage_cost).analytic_cost
    return cost * motion.amplitude**2


def causal_bound(scenario: Scenario) -> dict[str, Any]:
    """Return the least expected stage cost of a law with the scenario's own information.

    Exact where `optimal_cost` is known. Elsewhere no theory gives it: ``cost`` is None, and the least
    cost that a controller with this information attains stands in its place.
    """
    shown = f"a law with the scenario's information ({scenario_information(scenario)})"
    cost = optimal_cost(scenario)
    if cost is None:
        text = f"no theory gives the least cost of {shown}; the best attained stands for it"
        return {"cost": None, "exact": False, "text": text}
    text = f"{cost:.6g} is the least expected stage cost of {shown}, by analysis (stationary)"
    return {"cost": cost, "exact": True, "text": text}
