"""What stands below a table of controllers: the true bound, the causal bound, classes of information."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from agents.evaluation.bound_store import AGREEMENT
from agents.evaluation.results import Comparison
from baselines.information import MEANINGS, knows_no_more

MARK = "\u2020"  # of a class that knows more than the scenario shows


def marked_class(information: str, own: str) -> str:
    """Return a row's class of information, with a mark where it knows more than a scenario shows."""
    return f"{information} {MARK}" if knows_more(information, own) else information


def knows_more(information: str, own: str) -> bool:
    """Return whether a class of information knows more than the scenario's own; ``-`` does not."""
    return bool(own) and information != "-" and not knows_no_more(information, own)


def class_note(classes: Sequence[str], own: str) -> list[str]:
    """Return what the classes of information in a table mean; nothing where all are one."""
    if all(each == own for each in classes):
        return []
    meanings = "; ".join(
        f"*{name}*: {text}" for name, text in MEANINGS.items() if name in (*classes, own)
    )
    lines = [f"Information: {meanings}. The scenario shows: {own}."]
    if any(knows_more(each, own) for each in classes):
        lines.append(
            f"{MARK}: knows more than the scenario shows; its cost is not comparable with that of "
            "controllers without the mark."
        )
    return lines


def comparison_notes(comparison: Comparison) -> list[str]:
    """Return in sentences what the bound and the classes of information in the tables are."""
    classes = [row.information for row in comparison.summaries]
    notes = class_note(classes, comparison.information)
    bound = comparison.bound_to_json()
    if bound is None:
        return notes
    # For terminal and page, which have no Markdown.
    own = [note.replace("**", "") for note in bound_notes(bound, len(comparison.groups))]
    return [*own, *notes]


def bound_notes(bound: dict[str, Any], earthquakes: int) -> list[str]:
    """Return in sentences how large the true bound is, how far it is to be trusted, and what is below.

    Parameters
    ----------
    bound
        `bound_store.Bounds.to_json`, with ``below``, see `scores.below_bound`.
    earthquakes
        Number that the controllers were run on.
    """
    if bound["reason"]:
        return [f"Bound: none ({bound['reason']})."]
    costs, disagreements = np.array(bound["costs"]), np.array(bound["disagreements"])
    of = "" if len(costs) == earthquakes else f" of the first {len(costs)} earthquakes"
    lines = [
        f"Bound: mean stage cost {costs.mean():.6g}{of}, everything known; its starts agree within "
        f"{100 * np.median(disagreements):.2g} % (median; at most {100 * disagreements.max():.2g} %)."
    ]
    below = bound.get("below", [])
    if below:
        worst = min(below, key=lambda each: each["ratio"])
        names = ", ".join(f"`{name}`" for name in dict.fromkeys(each["controller"] for each in below))
        lines.append(
            f"**{len(below)} episodes cost less than their bound by more than its starts differ, or by "
            f"more than {100 * AGREEMENT:g} %** ({names}; the least {worst['ratio']:.4f} of it): "
            "there the bound is not the optimum."
        )
    else:
        lines.append("No controller costs less than the bound on any of these.")
    return lines + disagreement_note(bound["disagreements"])


def disagreement_note(disagreements: Sequence[float]) -> list[str]:
    """Return in a sentence where the starts of a search do not establish the bound; empty: nowhere.

    Parameters
    ----------
    disagreements
        Of each earthquake, the cost of the worst start over that of the best one, minus 1.
    """
    apart = [each for each in disagreements if each > AGREEMENT]
    if not apart:
        return []
    return [
        f"**On {len(apart)} of {len(disagreements)} earthquakes the starts differ by more than "
        f"{100 * AGREEMENT:g} %** (at most {100 * max(apart):.2g} %): there the bound is not "
        "established. The cause is usually a dead band or a friction threshold, which the slopes of "
        "the search do not show. A controller that costs less is the better yardstick there."
    ]


def causal_notes(
    causal: dict[str, Any], own: str, rows: Sequence[dict[str, Any]], bound: dict[str, Any]
) -> list[str]:
    """Return what the least cost with the scenario's own information is: exact, or the best attained.

    Parameters
    ----------
    causal
        `agents.evaluation.bound.causal_bound`.
    own
        Class of what the scenario shows.
    rows
        Of the table, each with ``controller``, ``information`` and ``mean_cost``.
    bound
        As for `bound_notes`.
    """
    mean = np.mean(bound["costs"]) if bound["costs"] else None
    if causal["exact"]:
        over = "" if mean is None else f" That is {causal['cost'] / mean:.3f} of the bound."
        return [f"Causal bound: J* = {causal['text']}.{over}"]
    attained = [row for row in rows if not knows_more(row["information"], own)]
    if not attained:
        return []
    best = min(attained, key=lambda row: row["mean_cost"])
    return [
        f"Causal bound: {causal['text']}: `{best['controller']}`, mean stage cost "
        f"{best['mean_cost']:.6g}."
    ]
