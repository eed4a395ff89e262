"""A file of recorded motion as a figure: acceleration, velocity, displacement and response spectrum."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from agents.figure_style import BLUE, GREY, VERMILLION, figure_style, new_figure, save_figure
from agents.motions.channels import Channel
from agents.motions.intensity import DAMPING, PERIODS, REFINED, SAMPLES_A_PERIOD, response_spectrum
from shake_env.motion.processing import TableCapacity
from shake_env.motion.targets import target_history

FloatArray = NDArray[np.float64]

LONGEST_SPECTRUM = 300_000  # [samples] eqsig takes some 10 us each
COLUMNS = 3000  # lowest and highest value of each that a curve is drawn with
MOST_CHANNELS = 6  # a figure


def draw_channels(
    channels: Sequence[Channel], capacity: TableCapacity, folder: str | PathLike[str], title: str
) -> list[Path]:
    """Draw a recorded file's channels side by side; return the paths written, named after `title`.

    The curves are of the band that the table repeats, before scaling; lines mark the table's limits.
    Spectra are of the file's samples.
    """
    folder = Path(folder)
    written: list[Path] = []
    for first in range(0, len(channels), MOST_CHANNELS):
        shown = channels[first : first + MOST_CHANNELS]
        stem = re.sub(r"[^\w.-]+", "_", title).strip("._") or "motion"
        name = stem if len(channels) <= MOST_CHANNELS else f"{stem}-{first + 1}"
        written += _draw(shown, capacity, folder, title, name)
    return written


def _draw(
    channels: Sequence[Channel], capacity: TableCapacity, folder: Path, title: str, name: str
) -> list[Path]:
    with figure_style():
        figure = new_figure(max(3.4 * len(channels), 6.0), 8.6)
        panels = figure.subplots(4, len(channels), squeeze=False, sharey="row")
        for column, channel in zip(panels.T, channels, strict=True):
            record = channel.record
            step = record.sampling_interval
            history = target_history(replace(channel.by_amplitude.motion, amplitude=1.0), step)
            time = step * np.arange(len(history.acceleration), dtype=np.float64)
            rows: tuple[tuple[FloatArray, float | None], ...] = (
                (history.acceleration, None),
                (history.velocity, capacity.velocity),
                (1e3 * history.displacement, 1e3 * capacity.displacement),
            )
            for panel, (values, limit) in zip(column, rows, strict=False):
                panel.plot(*_outline(time, values), color=BLUE, linewidth=0.8)
                if limit is not None:
                    for side in (-limit, limit):
                        panel.axhline(side, color=VERMILLION, linewidth=1.2, linestyle=(0, (5, 2)))
                panel.set_xlim(0.0, time[-1])
                panel.set_xlabel("time [s]")
            label = record.name.removeprefix(f"{Path(title).stem} ")
            column[0].set_title(
                f"{label}\namplitude x {channel.by_amplitude.factor:.3g}"
                f" or time x {channel.by_time.factor:.3g}"
            )
            _spectrum(column[3], channel)
        for row, label in zip(
            panels,
            ("acceleration [m/s²]", "velocity [m/s]", "displacement [mm]", "response [m/s²]"),
            strict=True,
        ):
            row[0].set_ylabel(label)
        panels[3, 0].set_ylim(bottom=0.0)  # once all are drawn, which share it
        figure.align_ylabels(panels[:, 0])
        figure.suptitle(
            f"{title}: the band that the table repeats, unscaled; dashed: the table's limits"
        )
        return save_figure(figure, folder, name)


def _spectrum(panel: Axes, channel: Channel) -> None:
    record = channel.record
    panel.set_xlabel(f"period [s]\npseudo-acceleration, damping {100 * DAMPING:g} %")
    if len(record.acceleration) > LONGEST_SPECTRUM:
        panel.text(0.5, 0.5, "record too long\nfor a spectrum", ha="center", transform=panel.transAxes)
        return
    # A response at less than two samples a period would be that of motion which no sample holds.
    periods = PERIODS[2.0 * record.sampling_interval <= PERIODS]
    if len(record.acceleration) * REFINED > LONGEST_SPECTRUM:
        periods = periods[SAMPLES_A_PERIOD * record.sampling_interval <= periods]
    if not len(periods):
        text = "sampled too coarsely\nfor a spectrum"
        panel.text(0.5, 0.5, text, ha="center", transform=panel.transAxes)
        return
    panel.plot(periods, response_spectrum(record, periods), color=BLUE)
    peak = float(np.max(np.abs(record.acceleration)))
    panel.axhline(peak, color=GREY, linewidth=1.0, linestyle=(0, (1, 1.2)))
    panel.annotate("peak of the ground", (PERIODS[-1], peak), ha="right", va="bottom", color=GREY)
    panel.set_xscale("log")
    panel.set_xticks([0.05, 0.1, 0.2, 0.5, 1, 2, 5], ["0.05", "0.1", "0.2", "0.5", "1", "2", "5"])
    panel.set_xlim(PERIODS[0], PERIODS[-1])


def _outline(time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and highest value of each of `COLUMNS` stretches, which looks the same."""
    width = len(values) // COLUMNS
    if width < 3:
        return time, values
    first = np.linspace(0, len(values), COLUMNS, endpoint=False).astype(int)
    lowest, highest = np.minimum.reduceat(values, first), np.maximum.reduceat(values, first)
    return np.repeat(time[first], 2), np.stack([lowest, highest], axis=1).reshape(-1)
