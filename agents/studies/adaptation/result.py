"""Cost against time within an episode, beside the controller that is told the plant.

Where a scenario draws the plant, a controller that learns it from the signals begins an episode without
knowing it. Its stage cost over time, divided by that of nonlinear predictive control that is told the
plant (`baselines.planning.informed`), shows how fast it learns: both meet the same shaking at the same
time, so that the envelope of an earthquake divides out.

It does not divide out entirely: in weak shaking controllers differ for other reasons as well. Each
policy with a memory therefore also runs with its memory cleared once, in full shaking, and is compared
with itself: only what the memory held differs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

import shake_env
from agents.evaluation.statistics import estimate, ratio_of_means
from agents.policies.policy_file import PolicyFile
from agents.policies.registry import get_controller
from agents.provenance import machine
from agents.reporting.markdown_blocks import markdown_table
from agents.seeds import VALIDATION_SEED
from agents.studies.adaptation.costs import INFORMED, StageCosts, stage_costs
from shake_env.errors import ParameterError
from shake_env.motion.targets import FilteredNoise, control_steps
from shake_env.rollout import noise_earthquakes
from shake_env.scenario.scenario import Scenario

# [s] ends of the parts of an episode in the table: the rise, the shaking at full size, the decay.
PARTS = (0.0, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 15.0)
CLEAR_BIN = 0.1  # [s] bins in which the cost after a memory was cleared is shown
BEFORE, AFTER = 0.5, 1.5  # [s] of them, before and after


@dataclass(frozen=True, kw_only=True)
class AdaptationSettings:
    """What is run."""

    controllers: tuple[str, ...]
    earthquakes: int = 24
    seed: int = VALIDATION_SEED  # of the first
    bin: float = 0.5  # [s]
    clear_time: float = 5.0  # [s] when memories are cleared


def adaptation(
    scenario: Scenario,
    settings: AdaptationSettings,
    on_progress: Callable[[str, float], None] = lambda name, share: None,
) -> dict[str, Any]:
    """Return the costs of controllers over time, over those of the one that is told the plant.

    Parameters
    ----------
    scenario
        Draws its plant; its motion is filtered noise.
    settings
        Controllers and earthquakes.
    on_progress
        Told a controller's name, and the share of all the work done, 0 to 1.

    Returns
    -------
    Plain JSON values; ``rows`` a controller each, with ratios and 95 % intervals over earthquakes.

    Raises
    ------
    ScenarioError
        If the scenario draws nothing, or a controller does not suit it.
    ParameterError
        If a bin is no whole number of control periods or longer than the motion, memories are cleared
        outside of it, or a controller loses every earthquake.
    """
    period = scenario.control_period
    quakes = noise_earthquakes(scenario, settings.earthquakes, settings.seed)
    motion = quakes[0].motion
    assert isinstance(motion, FilteredNoise)  # as `noise_earthquakes` makes them
    periods = control_steps(motion, period, scenario.physics_step)
    edges = _edges(periods, settings.bin, period)
    clear = round(settings.clear_time / period)
    if not 0 < clear < periods:
        remedy = f"must lie within the motion, {periods * period:g} s"
        raise ParameterError("clear_time", settings.clear_time, remedy)
    names = (INFORMED, *settings.controllers)
    laws = {name: get_controller(name, scenario) for name in settings.controllers}
    remembering = [
        name for name, law in laws.items() if isinstance(law, PolicyFile) and law.memory is not None
    ]
    runs: list[tuple[str, int | None]] = [(name, None) for name in names]
    runs += [(name, clear) for name in remembering]
    costs: dict[tuple[str, int | None], StageCosts] = {}
    for number, run in enumerate(runs):

        def tell(share: float, number: int = number, name: str = run[0]) -> None:
            on_progress(name, (number + share) / len(runs))

        costs[run] = stage_costs(run[0], scenario, quakes, run[1], tell)
    told = costs[INFORMED, None]
    parts = [*(t for t in PARTS if t < periods * period), periods * period]
    rows = []
    for name in names:
        own = costs[name, None]
        kept = ~(own.lost | told.lost)
        if not kept.any():
            raise ParameterError("controllers", name, "loses every earthquake: leave it out")
        rows.append({
            "controller": name,
            "cost": float(np.mean(own.costs[:, kept])),
            "lost": int(own.lost.sum()),
            "ratio": _ratios(own, told, edges),
            "parts": _ratios(own, told, [round(t / period) for t in parts]),
        })  # fmt: skip
    near = [
        clear + round(k * CLEAR_BIN / period)
        for k in range(-round(BEFORE / CLEAR_BIN), 1 + round(AFTER / CLEAR_BIN))
    ]
    near = [edge for edge in near if 0 <= edge <= periods]
    return {
        "scenario": scenario.name,
        "earthquakes": settings.earthquakes,
        "seed": settings.seed,
        "version": shake_env.__version__,
        "machine": machine(),
        "edges": [round(edge * period, 6) for edge in edges],
        "parts": parts,
        "informed_cost": [float(np.mean(told.costs[a:b])) for a, b in pairwise(edges)],
        "rows": rows,
        "clear_time": settings.clear_time,
        "clear_edges": [round(edge * period, 6) for edge in near],
        "cleared": [
            {"policy": name, "ratio": _ratios(costs[name, clear], costs[name, None], near)}
            for name in remembering
        ],
    }


def _edges(periods: int, width: float, period: float) -> list[int]:
    """Return the control periods at which bins begin, and the last one's end."""
    each = round(width / period)
    if each < 1 or abs(each * period - width) > 1e-9:
        raise ParameterError("bin", width, f"must be a multiple of the control period, {period:g} s")
    if each > periods:
        raise ParameterError("bin", width, f"must not be longer than the motion, {periods * period:g} s")
    return list(range(0, periods + 1, each))


def _ratios(own: StageCosts, other: StageCosts, edges: Sequence[int]) -> list[list[float]]:
    """Return the ratio of summed costs between edges, with its interval: [value, low, high] each.

    Earthquakes that took either to a limit are left out.
    """
    kept = ~(own.lost | other.lost)
    found = []
    for first, end in pairwise(edges):
        sums = [each.costs[first:end, kept].sum(axis=0)[None] for each in (own, other)]
        ratio = estimate(ratio_of_means, *sums)
        found.append([round(float(value), 5) for value in (ratio.value, ratio.low, ratio.high)])
    return found


def adaptation_table(result: Mapping[str, Any]) -> str:
    """Return the result as a Markdown table: ratios of costs in parts of an episode."""
    parts = result["parts"]
    heads = [f"{a:g} to {b:g} s" for a, b in pairwise(parts)]
    rows = [
        (
            f"`{row['controller']}`",
            f"{row['cost']:.5f}" + (f" ({row['lost']} lost)" if row["lost"] else ""),
            *(f"{value:.2f} [{low:.2f}, {high:.2f}]" for value, low, high in row["parts"]),
        )
        for row in result["rows"]
        if row["controller"] != INFORMED
    ]
    informed = next(row for row in result["rows"] if row["controller"] == INFORMED)
    table = markdown_table((f"`{result['scenario']}`", "stage cost", *heads), rows)
    return (
        f"{table}\nCost over that of `{INFORMED}` ({informed['cost']:.5f}) in the same part of the same "
        f"episodes, with 95 % intervals over {result['earthquakes']} validation earthquakes (seeds from "
        f"{result['seed']}).\n"
    )
