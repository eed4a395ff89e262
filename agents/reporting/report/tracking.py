"""The report's table of tracking figures: peak and rms errors, delay, error energy, ratios by octave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from agents.evaluation.tracking import BANDS, TrackingFigures

_SIGNALS = ("acceleration", "velocity", "displacement")
_KINDS = ("peak", "rms")
# Two lines of each heading, and the digits below it.
TRACKING_COLUMNS: tuple[tuple[str, str, int], ...] = (
    *((signal, f"{kind} [%]", 1) for signal in _SIGNALS for kind in _KINDS),
    ("delay", "[ms]", 1),
    ("error", "energy [%]", 1),
    *((f"{low:g}–{high:g}", "Hz", 2) for low, high in BANDS),  # noqa: RUF001  # a range's dash
)


def tracking_rows(
    tracking: Mapping[str, Sequence[TrackingFigures]], members: Sequence[int]
) -> dict[str, list[float]]:
    """Return a report's means of `TRACKING_COLUMNS` over some earthquakes, by controller.

    Figures that an earthquake does not have are left out of its mean; NaN where none has them.

    Parameters
    ----------
    tracking
        Figures of each earthquake, by controller.
    members
        Indices of the earthquakes.
    """
    means = {}
    for name, figures in tracking.items():
        rows = np.array([_row(figures[i]) for i in members])
        known = np.isfinite(rows)
        sums, numbers = np.where(known, rows, 0.0).sum(axis=0), known.sum(axis=0)
        means[name] = np.where(numbers, sums / np.maximum(numbers, 1), np.nan).tolist()
    return means


def _row(figures: TrackingFigures) -> list[float]:
    errors = [100.0 * getattr(figures, f"{signal}_{kind}") for signal in _SIGNALS for kind in _KINDS]
    return [*errors, 1e3 * figures.delay, 100.0 * figures.error_energy, *figures.band_ratios]
