"""What is said of the bound below a table: what costs less, and where its starts do not establish it."""

from types import SimpleNamespace

from agents.evaluation.bound_store import Bounds, EpisodeBound
from agents.evaluation.results import Comparison
from agents.reporting.bound_notes import comparison_notes
from baselines.planning.bound import Start


def notes(costs, other_starts):
    """The notes of a comparison of one law, with a bound of 1 whose other start ended so much above."""
    bounds = Bounds(
        tuple(
            EpisodeBound(1.0, tuple(Start("", 9.0, c, True, 1, 0.1) for c in (1.0, 1.0 + other)))
            for other in other_starts
        )
    )
    rows = {"lqg": [SimpleNamespace(cost=cost) for cost in costs]}
    compared = Comparison(
        [], rows, {}, {}, "lqg", "", [], {}, ["noise"] * len(costs), bounds=bounds, information=""
    )
    return " ".join(comparison_notes(compared)), compared.bound_to_json()


def test_a_comparison_says_which_controller_costs_less_than_the_bound():
    text, plain = notes([0.97, 1.2], [0.0, 0.0])
    assert "1 episodes cost less than their bound" in text and "`lqg`" in text and "0.9700" in text
    assert plain["below"] == [{"controller": "lqg", "run": 0, "earthquake": 0, "ratio": 0.97}]
    text, plain = notes([1.0, 1.2], [0.0, 0.0])
    assert "No controller costs less than the bound" in text and plain["below"] == []


def test_where_the_starts_disagree_the_bound_is_not_established():
    assert "established" not in notes([1.1, 1.1, 1.1], [0.0, 0.0099, 0.0])[0]
    text, _ = notes([0.97, 1.1, 1.1], [0.06, 0.0, 0.02])
    assert "On 2 of 3 earthquakes the starts differ by more than 1 % (at most 6 %)" in text
    assert "dead band" in text and "better yardstick" in text
    assert "*" not in text  # it stands on a terminal and on a page
    # What costs less is still told there.
    assert "1 episodes cost less than their bound" in text
