"""A comparison's answer in three sentences, made from its numbers: who wins, where not, what limits.

The words are in ``assets/verdict.txt``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from agents.evaluation.results import Comparison, GroupSummary
from agents.evaluation.statistics import cost_ratio
from agents.policies.registry import ORACLE
from shake_env.scenario.scenario import Scenario

QUESTIONS = ("Who wins", "Where it loses", "What limits it")
NEAR = 0.9  # share of a limit from which on it counts as what limits a test
ERRORS = {"acceleration": "acceleration_rms_error", "base shear": "base_shear_rms_error"}


@dataclass(frozen=True)
class Verdict:
    """Three sentences, and what they are about."""

    winner: str
    group: str  # of the earthquakes that the winner was found on
    wins: str
    loses: str
    limits: str

    @property
    def sentences(self) -> tuple[str, str, str]:
        """The three in order."""
        return self.wins, self.loses, self.limits


def main_group(comparison: Comparison) -> str:
    """Return the group that decides: one's own motions, or else the one of most earthquakes."""
    groups = list(dict.fromkeys(comparison.groups))
    return "motions" if "motions" in groups else max(groups, key=comparison.groups.count)


def verdict(comparison: Comparison, scenario: Scenario, label: Callable[[str], str] = str) -> Verdict:
    """Return the verdict of a comparison.

    The oracle knows each plant and is no candidate. Intervals are 95 %
    bootstrap intervals over earthquakes, paired.

    Parameters
    ----------
    comparison
        Of at least one controller.
    scenario
        What was driven: its limits.
    label
        Name of a controller as a reader knows it.
    """
    environment = Environment(
        loader=PackageLoader("agents.reporting", "assets"),
        extensions=["jinja2.ext.do"],
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    group = main_group(comparison)
    rows = {s.controller: s for s in comparison.summaries if s.group == group}
    rows.pop(ORACLE, None)
    candidates = sorted(rows.values(), key=lambda row: row.relative_cost)
    facts = {
        "label": label,
        "percent": _percent,
        "reference": comparison.reference,
        "near": NEAR,
        "reference_spread": math.isfinite(candidates[0].relative_cost_low),
        "where": _count(candidates[0].earthquakes, group),
        **_rivals(comparison, candidates, group),
        **_limits(candidates[0], scenario),
    }
    words: Any = environment.get_template("verdict.txt").make_module(facts)
    sentences = (str(part()).strip() for part in (words.wins, words.loses, words.limits))
    return Verdict(candidates[0].controller, group, *sentences)


def _rivals(comparison: Comparison, candidates: list[GroupSummary], group: str) -> dict[str, Any]:
    """Return the two best, the gain of the first with its interval, and where it is behind."""
    best, *others = candidates
    names = [row.controller for row in candidates]
    gain = (0.0, 0.0, 0.0)
    if others:
        ratio, low, high = _against(comparison, best.controller, names[1], group)
        gain = (1 - ratio, 1 - high, 1 - low)
    ahead = []
    for other in dict.fromkeys(comparison.groups):
        rows = [s for s in comparison.summaries if s.group == other and s.controller in names]
        leader = min(rows, key=lambda row: row.relative_cost)
        if other != group and leader.controller != best.controller:
            factor, *_ = _against(comparison, best.controller, leader.controller, other)
            ahead.append((leader, other, factor))
    members = [i for i, each in enumerate(comparison.groups) if each == group]
    costs = {
        name: [rows[i].cost for i in members]
        for name, rows in comparison.episodes.items()
        if name in names
    }
    least = map(min, zip(*costs.values(), strict=True))
    lost = sum(cost < own for cost, own in zip(least, costs[best.controller], strict=True))
    larger = []
    for what, field in ERRORS.items():
        leader = min(candidates, key=lambda row: getattr(row, field))
        mine, best_of_all = getattr(best, field), getattr(leader, field)
        if _percent(mine) != _percent(best_of_all):
            larger.append((what, mine, best_of_all, leader.controller))
    second = others[0] if others else None
    return dict(
        best=best, second=second, gain=gain, spread=math.isfinite(gain[1]), ahead=ahead, lost=lost,
        larger=larger,
    )  # fmt: skip


def _limits(best: GroupSummary, scenario: Scenario) -> dict[str, Any]:
    """Return the limit that comes closest, the share of it that is used, and what the bound saves."""
    shares = {
        "current": (best.peak_current, scenario.current_limit),
        "stroke": (best.peak_displacement, scenario.limits.table_displacement),
        "velocity": (best.peak_velocity, scenario.limits.table_velocity),
    }
    used = {what: value / limit for what, (value, limit) in shares.items() if limit is not None}
    limit = max(used, key=lambda each: used[each])
    saved = max(0.0, 1.0 - 1.0 / best.bound_cost) if math.isfinite(best.bound_cost) else 0.0
    return {"limit": limit, "used": used[limit], "saved": saved}


def _against(comparison: Comparison, one: str, other: str, group: str) -> tuple[float, float, float]:
    """Return one controller's cost over another's on a group, with its interval."""
    members = [i for i, each in enumerate(comparison.groups) if each == group]
    return cost_ratio(
        [comparison.episodes[one][i] for i in members], [comparison.episodes[other][i] for i in members]
    )


def _count(number: int, group: str) -> str:
    plural = "" if number == 1 else "s"
    words = {"motions": f"motion{plural} given", "records": f"record{plural}"}
    return f"the {number} {words.get(group, f'{group} earthquake{plural}')}"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"
