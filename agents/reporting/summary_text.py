"""A comparison's answer in three sentences, made from its numbers: who wins, where not, what limits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from agents.evaluation.bootstrap import cost_ratio
from agents.evaluation.results import Comparison, GroupSummary
from agents.policies.registry import ORACLE
from shake_env.scenario.scenario import Scenario

NEAR = 0.9  # share of a limit from which on it counts as what limits a test


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

    The oracle knows each plant and the coming target, and is no candidate. Intervals are 95 %
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
    group = main_group(comparison)
    rows = {s.controller: s for s in comparison.summaries if s.group == group}
    candidates = sorted(
        (row for name, row in rows.items() if name != ORACLE), key=lambda row: row.relative_cost
    )
    best = candidates[0]
    return Verdict(
        winner=best.controller,
        group=group,
        wins=_wins(comparison, candidates, group, label),
        loses=_loses(comparison, candidates, group, label),
        limits=_limits(best, rows.get(ORACLE), scenario, label),
    )


def _wins(
    comparison: Comparison,
    candidates: Sequence[GroupSummary],
    group: str,
    label: Callable[[str], str],
) -> str:
    best, name = candidates[0], label(candidates[0].controller)
    where = f"On {_count(best.earthquakes, group)}"
    if len(candidates) == 1:
        return f"{where} only {name} was run, so that there is nobody to compare it with."
    second = candidates[1]
    ratio, low, high = _against(comparison, best.controller, second.controller, group)
    gap = f"{100 * (1 - ratio):.1f} %"
    interval = f"95 % interval {100 * (1 - high):.1f} to {100 * (1 - low):.1f} %"
    if best.earthquakes < 2:
        sure = "one earthquake gives no interval"
    elif high < 1.0:
        sure = f"{interval}, beyond chance"
    else:
        sure = f"{interval}, which contains zero: chance alone could explain it"
    versus = ""
    if comparison.reference not in (best.controller, second.controller):
        range_of_cost = f" ({best.relative_cost_low:.3f} to {best.relative_cost_high:.3f})"
        versus = (
            f", and costs {best.relative_cost:.3f} of what the reference "
            f"{label(comparison.reference)} does{range_of_cost if best.earthquakes > 1 else ''}"
        )
    return f"{where} {name} wins: it costs {gap} less than {label(second.controller)} ({sure}){versus}."


def _loses(
    comparison: Comparison,
    candidates: Sequence[GroupSummary],
    group: str,
    label: Callable[[str], str],
) -> str:
    best, name = candidates[0], label(candidates[0].controller)
    if len(candidates) == 1:
        return "Name further controllers to see where it loses."
    parts = []
    names = [row.controller for row in candidates]
    for other in dict.fromkeys(comparison.groups):
        rows = [s for s in comparison.summaries if s.group == other and s.controller in names]
        leader = min(rows, key=lambda row: row.relative_cost)
        if other != group and leader.controller != best.controller:
            ratio, *_ = _against(comparison, best.controller, leader.controller, other)
            parts.append(
                f"on the {leader.earthquakes} {other}, where {label(leader.controller)} is ahead and it "
                f"costs {_factor(ratio)} as much"
            )
    members = [i for i, each in enumerate(comparison.groups) if each == group]
    lost = [
        i for i in members
        if any(
            comparison.episodes[n][i].cost < comparison.episodes[best.controller][i].cost
            for n in names[1:]
        )
    ]  # fmt: skip
    if lost:
        parts.append(f"on {len(lost)} of these {len(members)} earthquakes taken one by one")
    for what, field in (
        ("acceleration", "acceleration_rms_error"),
        ("base shear", "base_shear_rms_error"),
    ):
        leader = min(candidates, key=lambda row: getattr(row, field))
        mine, least = getattr(best, field), getattr(leader, field)
        if leader.controller != best.controller and _percent(mine) != _percent(least):
            parts.append(
                f"in {what}, where its error is {_percent(mine)} and that of {label(leader.controller)} "
                f"{_percent(least)}"
            )
    if not parts:
        return f"{name} loses nowhere here: no other is ahead on any earthquake or in either error."
    return f"{name} loses {_listed(parts)}."


def _limits(
    best: GroupSummary,
    bound: GroupSummary | None,
    scenario: Scenario,
    label: Callable[[str], str],
) -> str:
    name = label(best.controller)
    errors = (
        f"its acceleration is off by {_percent(best.acceleration_rms_error)} and its base shear by "
        f"{_percent(best.base_shear_rms_error)} of the target's rms"
    )
    if best.broken_limits:
        return (
            f"What limits {name} is the table: {best.broken_limits} of {best.earthquakes} tests ended "
            f"at a limit; {errors}."
        )
    shares = {
        "current": (best.peak_current, scenario.current_limit),
        "stroke": (best.peak_displacement, scenario.limits.table_displacement),
        "velocity": (best.peak_velocity, scenario.limits.table_velocity),
    }
    used = {what: value / limit for what, (value, limit) in shares.items() if limit is not None}
    what = max(used, key=lambda each: used[each])
    missed = f"{100 * best.spectral_error:.0f} % of response-spectrum ordinates are more than 10 % off"
    if bound is not None and bound.relative_cost < best.relative_cost:
        saved = 100 * (1 - bound.relative_cost / best.relative_cost)
        missed += f"; who knew the plant and the coming target would cost {saved:.0f} % less"
    if used[what] >= NEAR:
        return (
            f"What limits {name} is the {what}, which reaches {100 * used[what]:.0f} % of its limit; "
            f"{errors}, and {missed}."
        )
    return (
        f"No limit is near (the {what} comes closest, at {100 * used[what]:.0f} %), so that what "
        f"remains is tracking: {errors}, and {missed}."
    )


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


def _factor(ratio: float) -> str:
    return f"{ratio:.2f} times" if ratio < 10 else f"{ratio:.0f} times"


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else "; ".join(parts[:-1]) + "; and " + parts[-1]
