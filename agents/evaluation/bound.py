"""True bounds of a scenario's earthquakes beside its reference, and what theory says of causal laws."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from agents.evaluation.bound_store import earthquake_bounds
from agents.seeds import TEST_SEED
from baselines.information import scenario_information
from baselines.lqr.preview import preview_lqr
from baselines.lqr.sampled import sampled_lqr
from baselines.planning.episodes import driven
from baselines.registry import make_baseline, reference_name
from shake_env.errors import ParameterError, ScenarioError
from shake_env.motion.targets import FilteredNoise
from shake_env.rollout import Earthquake, noise_earthquakes, recorded_earthquakes
from shake_env.scenario.scenario import Scenario

MOST_SEEDS = 10_000  # earthquakes at a time


def seeded_earthquakes(scenario: Scenario, first: int, end: int) -> list[Earthquake]:
    """Return the earthquakes of seeds `first` to `end` - 1; recorded motions are numbered from 0.

    Raises
    ------
    ParameterError
        If the seeds are negative, in disorder or more than `MOST_SEEDS`, or a scenario of recorded
        motions does not have all of these numbers.
    """
    if first < 0:
        raise ParameterError("seeds", (first, end), "must be 0 or more")
    if end <= first:
        raise ParameterError("seeds", (first, end), "give two, the second above the first")
    if end - first > MOST_SEEDS:
        remedy = f"are {end - first:.3g} earthquakes: ask for at most {MOST_SEEDS} at a time"
        raise ParameterError("seeds", (first, end), remedy)
    if isinstance(scenario.motion, FilteredNoise):
        return noise_earthquakes(scenario, end - first, first)
    recorded = recorded_earthquakes(scenario)
    if end > len(recorded):
        remedy = f"{scenario.name} has {len(recorded)} recorded motions, numbered from 0: "
        raise ParameterError("seeds", (first, end), remedy + f"the second is at most {len(recorded)}")
    return recorded[first:end]


def default_seeds(scenario: Scenario, number: int) -> tuple[int, int]:
    """Return the seeds of a scenario's first test earthquakes, as `seeded_earthquakes` takes them.

    Of recorded motions: all of them.
    """
    if isinstance(scenario.motion, FilteredNoise):
        return TEST_SEED, TEST_SEED + number
    return 0, len(recorded_earthquakes(scenario))


def bound_of(
    scenario: Scenario, first: int, end: int, on_progress: Callable[[float], None]
) -> dict[str, Any]:
    """Return the bounds of seeds `first` to `end` - 1 beside the reference's costs, as plain values.

    ``seconds`` is the processor time of the whole search of each earthquake: the sum over its starts.

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
        "seconds": [each.seconds for each in episodes],
        "starts": [[vars(start) for start in each.starts] for each in episodes],
        "causal_bound": causal_bound(scenario, beside_table=False),
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


def causal_bound(scenario: Scenario, *, beside_table: bool = True) -> dict[str, Any]:
    """Return the least expected stage cost of a law with the scenario's own information.

    Exact where `optimal_cost` is known. Elsewhere no theory gives it: ``cost`` is None, and the least
    cost that a controller with this information attains stands in its place, if a table of controllers
    stands beside it.
    """
    shown = f"a law with the scenario's information ({scenario_information(scenario)})"
    cost = optimal_cost(scenario)
    if cost is None:
        text = f"no theory gives the least cost of {shown}"
        text += "; the best attained stands for it" if beside_table else ""
        return {"cost": None, "exact": False, "text": text}
    text = f"{cost:.6g} is the least expected stage cost of {shown}, by analysis (stationary)"
    return {"cost": cost, "exact": True, "text": text}
