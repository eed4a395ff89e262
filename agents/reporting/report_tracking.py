"""The report's table of tracking figures: peak and rms errors, delay, error energy, ratios by octave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from agents.evaluation.tracking import BANDS, TrackingFigures

_ERRORS = (
    ("acceleration", "acceleration_peak", "acceleration_rms"),
    ("velocity", "velocity_peak", "velocity_rms"),
    ("displacement", "displacement_peak", "displacement_rms"),
)


def tracking_table(
    tracking: Mapping[str, Sequence[TrackingFigures]], labels: Mapping[str, str], members: Sequence[int]
) -> str:
    """Return an HTML table of the means over some earthquakes.

    Parameters
    ----------
    tracking
        Figures of each earthquake, by controller.
    labels
        How the controllers are called.
    members
        Places of the earthquakes.
    """
    heads = [f"{what}<br>{kind} [%]" for what, *_ in _ERRORS for kind in ("peak", "rms")]
    heads += ["delay<br>[ms]", "error<br>energy [%]"]
    heads += [f"{low:g}–{high:g}<br>Hz" for low, high in BANDS]  # noqa: RUF001  # a range's dash
    lines = []
    for name, figures in tracking.items():
        rows = np.array([_row(figures[i]) for i in members])
        known = np.isfinite(rows)
        means = np.where(known, rows, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        shown = np.where(known.any(axis=0), means, np.nan)
        cells = "".join(f"<td>{_cell(value, place)}</td>" for place, value in enumerate(shown))
        lines.append(f'<tr><th scope="row">{escape(labels[name])}</th>{cells}</tr>')
    head = "".join(f'<th scope="col">{heading}</th>' for heading in heads)
    title = "Tracking: errors relative to the target's peak and rms; rms over the target's by octave"
    return (
        '<div class="scroll" tabindex="0" role="region" aria-label="Table: tracking"><table>\n'
        f"<caption>{title}. Means over {len(members)} earthquakes.</caption>\n"
        f'<thead><tr><th scope="col">controller</th>{head}</tr></thead>\n'
        f"<tbody>\n{chr(10).join(lines)}\n</tbody></table></div>\n"
    )


def _row(figures: TrackingFigures) -> list[float]:
    errors = [100.0 * getattr(figures, name) for _, *names in _ERRORS for name in names]
    return [*errors, 1e3 * figures.delay, 100.0 * figures.error_energy, *figures.band_ratios]


def _cell(value: float, place: int) -> str:
    if not np.isfinite(value):
        return "–"  # noqa: RUF001
    return f"{value:.2f}" if place >= 2 * len(_ERRORS) + 2 else f"{value:.1f}"
