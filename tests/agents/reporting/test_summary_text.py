"""The verdict of a comparison: its facts, whatever the words."""

import re
from dataclasses import replace

import pytest

from agents.evaluation.comparison import summarise
from agents.evaluation.fidelity import Fidelity
from agents.evaluation.results import Comparison
from agents.reporting.summary_text import verdict
from shake_env import make_scenario
from shake_env.simulation.metrics import EpisodeMetrics


def constructed(costs, groups=None, shear=None, **changes):
    """A comparison whose costs are given, by controller; the first is the reference."""
    number = len(next(iter(costs.values())))
    groups = groups or ["filtered noise"] * number
    shear = shear or {}
    episodes = {
        name: [
            replace(
                EpisodeMetrics(f"quake {i}", cost, 0.4, 0.5, 0.1, 0.1, 0.02, 0.3, 0.03, None),
                base_shear_rms_error=shear.get(name, 0.1),
                **changes,
            )
            for i, cost in enumerate(row)
        ]
        for name, row in costs.items()
    }
    reference = next(iter(costs))
    good = [Fidelity(0.005, 0.2, 1.0, 1.0, 1.0)] * number
    summaries = [
        summarise(
            name, group, [rows[i] for i in inside], [episodes[reference][i] for i in inside],
            good[: len(inside)], 1e-5,
        )
        for group in dict.fromkeys(groups)
        for inside in [[i for i, each in enumerate(groups) if each == group]]
        for name, rows in episodes.items()
    ]  # fmt: skip
    fidelities = dict.fromkeys(episodes, good)
    return Comparison(summaries, episodes, fidelities, {}, reference, "quake 0", [], {}, list(groups))


def numbers(sentence):
    return [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", sentence)]


def test_the_winner_is_who_costs_least_and_by_how_much():
    comparison = constructed(
        {"lqr": [1.0, 2.0, 3.0, 4.0], "new": [0.8, 1.6, 2.4, 3.2], "oracle": [0.1] * 4}
    )
    # The bound is a twentieth of the winner's cost; the oracle is no candidate and no bound.
    summaries = [
        replace(row, bound_cost=20.0) if row.controller == "new" else row for row in comparison.summaries
    ]
    found = verdict(replace(comparison, summaries=summaries), make_scenario("laboratory"))
    assert found.winner == "new"
    # Earthquakes; the gain; the level of its interval, and the interval.
    assert numbers(found.wins) == [4.0, 20.0, 95.0, 20.0, 20.0]
    assert "filtered noise" in found.wins and "new" in found.wins and "lqr" in found.wins
    assert numbers(found.loses) == [] and "lqr" not in found.loses  # in nothing, against nobody
    # The current's share of its limit; both errors; share of ordinates and what they may be off; what
    # the bound saves.
    assert numbers(found.limits)[:3] == [50.0, 40.0, 10.0] and numbers(found.limits)[-1] == 95.0
    assert "current" in found.limits and "stroke" not in found.limits


def test_a_gap_that_chance_could_make_is_called_one():
    found = verdict(
        constructed({"lqr": [1.0, 2.0, 1.0, 2.0], "new": [0.9, 2.05, 1.1, 1.9]}),
        make_scenario("laboratory"),
    )
    assert found.winner == "new"
    *_, low, high = numbers(found.wins)
    assert low < 0.0 < high and "chance" in found.wins and "beyond chance" not in found.wins
    assert numbers(found.loses) == [2.0, 4.0]  # lost one by one, of so many


def test_where_the_winner_is_behind_is_said():
    comparison = constructed(
        {"lqr": [1.0, 1.0, 1.0, 2.0], "new": [0.5, 0.5, 0.5, 4.0]},
        ["filtered noise"] * 3 + ["records"],
        {"lqr": 0.05},
    )
    found = verdict(comparison, make_scenario("laboratory"), {"lqr": "LQR", "new": "New"}.__getitem__)
    assert found.group == "filtered noise"
    # On one record at twice the cost; in base shear, its error and LQR's.
    assert numbers(found.loses) == [1.0, 2.0, 10.0, 5.0]
    assert found.loses.count("LQR") == 2 and "records" in found.loses and "base shear" in found.loses
    assert "acceleration" not in found.loses


@pytest.mark.parametrize(
    ("changes", "word", "first"),
    [
        ({"peak_displacement": 0.075}, "stroke", [99.0, 40.0]),  # of its limit [%]; then the error
        ({"peak_current": 0.04}, "current", [100.0, 40.0]),
        ({"broken_limit": "table_velocity"}, "limit", [2.0, 2.0]),  # tests that ended, of so many
    ],
)
def test_what_limits_is_named(changes, word, first):
    comparison = constructed({"lqr": [1.0, 2.0], "new": [0.5, 1.0]}, **changes)
    limits = verdict(comparison, make_scenario("laboratory")).limits
    assert numbers(limits)[:2] == first and word in limits and "new" in limits
    assert sum(each in limits for each in ("stroke", "current", "velocity")) == (word != "limit")


def test_one_controller_or_one_earthquake_is_no_contest():
    alone = verdict(constructed({"lqr": [1.0, 2.0]}), make_scenario("laboratory"))
    assert numbers(alone.wins) == [2.0] and "lqr" in alone.wins
    single = verdict(constructed({"lqr": [1.0], "new": [0.5]}), make_scenario("laboratory"))
    assert numbers(single.wins) == [1.0, 50.0] and "interval" in single.wins  # the gain, no interval


def test_copies_of_one_earthquake_give_no_interval():
    copies = constructed({"lqr": [1.0, 1.0, 1.0], "new": [0.5, 0.5, 0.5], "other": [0.75] * 3})
    wins = verdict(copies, make_scenario("laboratory")).wins
    # Earthquakes; the gain over the second, 1 - 0.5 / 0.75; the cost over the reference's.
    assert numbers(wins) == [3.0, 33.3, 0.5]
    assert "nan" not in wins and "chance" not in wins
