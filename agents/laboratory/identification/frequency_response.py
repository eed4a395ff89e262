"""Frequency responses and coherence of a log, without a model (Welch; H1 and H2).

H1 = S_xy / S_xx is too small where the input is noisy, H2 = S_yy / S_yx too large where the output is.
Under feedback both are biased where the noise goes round the loop. Ordinates below a coherence of
`GATE` are not shown (Bendat and Piersol, Random Data, 4th ed., 2010, ch. 6 and 9).
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import csd, welch

from agents.figure_style import SERIES, figure_style, new_figure, save_figure
from agents.laboratory.logs.test_log import CURRENT, TARGET, TestLog, unit_of
from shake_env.model.parameters import FloatArray

GATE = 0.8  # [-] least coherence that is shown
RESOLUTION = 0.5  # [Hz] wanted between ordinates
SEGMENTS = 6  # at least, half of each common to the next
PAIRS = (
    (TARGET, "table_acceleration"),
    (CURRENT, "table_velocity"),
    (CURRENT, "table_acceleration"),
    ("table_acceleration", "base_shear"),
    ("table_acceleration", "load_pressure"),
)


@dataclass(frozen=True)
class FrequencyResponse:
    """From one channel to another."""

    source: str
    response: str
    frequency: FloatArray  # (f,) [Hz]
    h1: NDArray[np.complex128]  # (f,)
    h2: NDArray[np.complex128]  # (f,)
    coherence: FloatArray  # (f,)
    segments: int

    @property
    def shown(self) -> NDArray[np.bool_]:
        """Ordinates (f,) of sufficient coherence."""
        shown: NDArray[np.bool_] = self.coherence >= GATE
        return shown


def frequency_responses(log: TestLog) -> list[FrequencyResponse]:
    """Return the responses between those of `PAIRS` that a log holds, and to every floor."""
    floors = [("table_acceleration", n) for n in log.measured if n.startswith("floor_acceleration_")]
    pairs = [pair for pair in (*PAIRS, *floors) if set(pair) <= set(log.channels)]
    return [frequency_response(log, *pair) for pair in pairs if np.any(log.channels[pair[0]])]


def frequency_response(log: TestLog, source: str, response: str) -> FrequencyResponse:
    """Return the response between two channels of a log."""
    x, y, rate = log.channels[source], log.channels[response], 1.0 / log.sampling_interval
    length = min(round(rate / RESOLUTION), 2 * log.samples // (SEGMENTS + 1))
    options = {"fs": rate, "nperseg": length, "window": "hann", "detrend": "linear"}
    frequency, s_xx = welch(x, **options)
    _, s_yy = welch(y, **options)
    _, s_xy = csd(x, y, **options)
    with np.errstate(divide="ignore", invalid="ignore"):
        coherence = np.nan_to_num(np.abs(s_xy) ** 2 / (s_xx * s_yy)).clip(0.0, 1.0)
        h1, h2 = np.nan_to_num(s_xy / s_xx), np.nan_to_num(s_yy / np.conj(s_xy))
    segments = 2 * log.samples // length - 1
    return FrequencyResponse(source, response, frequency, h1, h2, coherence, segments)


def draw_frequency_responses(log: TestLog, folder: str | os.PathLike[str], name: str) -> list[Path]:
    """Draw the responses of a log with their coherence; return the files."""
    folder = Path(folder)
    responses = frequency_responses(log)[:4]
    with figure_style():
        figure = new_figure(8.0, 2.2 * len(responses) + 0.6)
        rows = figure.subplots(len(responses), 2, squeeze=False, sharex=True)
        for (left, right), each in zip(rows, responses, strict=True):
            for values, label, style in ((each.h1, "H1", SERIES[0]), (each.h2, "H2", SERIES[1])):
                size = np.where(each.shown, np.abs(values), np.nan)
                left.plot(each.frequency, size, label=label, **{**style, "marker": ""})
            left.set_yscale("log")
            left.set_title(f"{each.source} to {each.response}", loc="left")
            left.set_ylabel(f"{unit_of(each.response)} / ({unit_of(each.source)})")
            right.plot(each.frequency, each.coherence, **{**SERIES[0], "marker": ""})
            right.axhline(GATE, color="#888888", linewidth=0.8)
            right.set_ylim(0.0, 1.05)
            right.set_title("coherence", loc="left")
        rows[0][0].legend()
        for panel in rows[-1]:
            panel.set_xlabel("frequency [Hz]")
        return save_figure(figure, folder, name)
