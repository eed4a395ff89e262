"""A table of episodes, seeds by earthquakes, and what a result says of it, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from agents.evaluation.bound_store import AGREEMENT, SOLVER_TOLERANCE
from agents.evaluation.statistics import (
    Scores,
    Statistic,
    estimate,
    interquartile_mean,
    probability_of_improvement,
    ratio_of_means,
    worst_mean,
)

MEANS = (
    "acceleration_rms_error",
    "acceleration_peak_error",
    "base_shear_rms_error",
    "base_shear_peak_error",
)
# Ratios that should be 1: given is the median distance from it, whichever way.
RATIOS = {"drift_ratio": "drift_error", "energy_ratio": "energy_error", "arias_ratio": "arias_error"}
PEAKS = ("peak_current", "peak_velocity", "peak_displacement")
DIGITS = 7  # of the figures of an episode in a result


@dataclass(frozen=True)
class Episodes:
    """Figures of every run of a row on every earthquake; NaN where a figure is not defined."""

    figures: dict[str, Scores]  # name: (runs, earthquakes)
    broken: tuple[tuple[str | None, ...], ...]  # what limit ended an episode

    @classmethod
    def from_rows(cls, rows: Sequence[Sequence[dict[str, Any]]]) -> Episodes:
        """Collect rows of plain values, runs by earthquakes."""
        names = [name for name in rows[0][0] if name not in ("earthquake", "broken_limit")]
        figures = {
            name: np.array(
                [[np.nan if (v := row[name]) is None else v for row in run] for run in rows], dtype=float
            )
            for name in names
        }
        return cls(figures, tuple(tuple(row["broken_limit"] for row in run) for run in rows))

    @property
    def cost(self) -> Scores:
        """Mean stage cost of each episode, (runs, earthquakes)."""
        return self.figures["cost"]

    @property
    def failures(self) -> int:
        """Number of episodes that a limit ended."""
        return sum(reason is not None for run in self.broken for reason in run)

    def to_json(self) -> dict[str, Any]:
        """Return costs, base-shear errors and failures as plain values."""
        figures = {name: self.figures[name] for name in ("cost", "base_shear_rms_error")}
        plain = {name: [[_short(v) for v in run] for run in table] for name, table in figures.items()}
        ended = [
            [run, quake, reason]
            for run, reasons in enumerate(self.broken)
            for quake, reason in enumerate(reasons)
            if reason is not None
        ]
        return {**plain, "broken_limits": ended}


def result_row(
    name: str,
    episodes: Episodes,
    *,
    normaliser: Scores,
    reference: Scores,
    optimum: float | None,
    resamples: int,
) -> dict[str, Any]:
    """Return a controller's row of the protocol's result: figures with their 95 % intervals.

    Parameters
    ----------
    name
        Of the controller.
    found
        Its episodes.
    normaliser, reference
        Costs on the same earthquakes; the normaliser's may be those of the first of them alone.
    optimum
        J*, or None.
    resamples
        Draws of the bootstrap.
    """
    row: dict[str, Any] = {
        "controller": name,
        "runs": len(episodes.cost),
        "episodes": episodes.cost.size,
        **cost_figures(episodes.cost, normaliser, reference, optimum, resamples),
        "failures": episodes.failures,
    }
    for figure in MEANS:
        row[figure] = _interval(_mean, resamples, episodes.figures[figure])
    for figure, error in RATIOS.items():
        known = episodes.figures.get(figure)
        row[error] = None
        if known is not None and np.isfinite(known).all():
            row[error] = _interval(_median, resamples, np.abs(known - 1.0))
    for figure in ("delay", "spectral_error"):
        known = episodes.figures.get(figure)
        finite = known is not None and np.isfinite(known).any()
        row[figure] = float(np.nanmean(known)) if known is not None and finite else None
    for peak in PEAKS:
        row[peak] = float(episodes.figures[peak].max())
    return row


def cost_figures(
    cost: Scores, normaliser: Scores, reference: Scores, optimum: float | None, resamples: int
) -> dict[str, Any]:
    """Return those figures of a row that come of costs alone, (runs, earthquakes); see `result_row`.

    What is relative to the normaliser is of the earthquakes that it has, the first ones.
    """
    bounded = normaliser.shape[1]
    own, base = cost[:, :bounded], reference[:, :bounded]
    ratio = own / normaliser
    same = np.array_equal(own, normaliser)
    regret = optimum is None and not same and base.mean() > normaliser.mean()
    return {
        "mean_cost": float(cost.mean()),
        "relative_cost": _interval(ratio_of_means, resamples, own, normaliser),
        "interquartile_mean": _interval(interquartile_mean, resamples, ratio),
        "worst_twentieth": _interval(worst_mean, resamples, ratio),
        "reference_cost": _interval(ratio_of_means, resamples, cost, reference),
        "probability_of_improvement": _interval(probability_of_improvement, resamples, cost, reference),
        "optimality": (
            None
            if optimum is None
            else _interval(lambda costs: float(costs.mean() / optimum), resamples, cost)
        ),
        "regret_closed": _interval(_regret_closed, resamples, own, base, normaliser) if regret else None,
        "run_costs": [float(run.mean() / normaliser.mean()) for run in own],
    }


def below_bound(
    cost: Sequence[Sequence[float]], bounds: Sequence[float], disagreements: Sequence[float]
) -> list[dict[str, Any]]:
    """Return the episodes that cost less than their bound by more than its starts differ.

    Starts that differ by more than `AGREEMENT` excuse no more than that: a bound that they do not
    establish is not hidden by them.

    Parameters
    ----------
    cost
        (runs, earthquakes) mean stage costs.
    bounds
        (n,) of the first earthquakes.
    disagreements
        (n,) cost of the worst start over that of the best one, minus 1.

    Returns
    -------
    Run, earthquake (places) and cost over the bound, of each such episode.
    """
    ratio = np.array(cost)[:, : len(bounds)] / np.array(bounds)
    low = ratio < 1.0 - np.clip(disagreements, SOLVER_TOLERANCE, AGREEMENT)
    return [
        {"run": int(run), "earthquake": int(quake), "ratio": float(ratio[run, quake])}
        for run, quake in np.argwhere(low)
    ]


def _interval(statistic: Statistic, resamples: int, *samples: Scores) -> dict[str, float]:
    return asdict(estimate(statistic, *samples, resamples=resamples))


def _mean(scores: Scores) -> float:
    return float(scores.mean())


def _median(scores: Scores) -> float:
    return float(np.median(scores))


def _regret_closed(cost: Scores, reference: Scores, bound: Scores) -> float:
    """Return the share of what the bound saves against the reference that is saved."""
    return float((reference.mean() - cost.mean()) / (reference.mean() - bound.mean()))


def _short(value: float) -> float | None:
    return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None
