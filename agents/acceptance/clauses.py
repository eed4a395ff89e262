"""Whether a measured table motion passes: its response spectra against the required one, and more.

The rules are those of ICC-ES AC156 and IEEE 693 as far as they could be read; each clause carries the
source of its number. Numbers are options, for editions differ.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import coherence, correlate

from agents.acceptance.required import RequiredSpectrum
from agents.acceptance.rules import AcceptanceRules
from agents.evaluation.fidelity import spectrum
from shake_env.errors import ParameterError
from shake_env.motion.targets import resample

FloatArray = NDArray[np.float64]

SAMPLES_A_PERIOD = 20  # of the highest frequency: the peak between samples is then within 1.3 %
_QUOTED = "as commonly quoted of AC156; its text was not read"
_RECALLED = "number from general knowledge of AC156 and IEEE 344; their texts were not read"
_NOTES = "definition from public notes on IEEE 693; the standard's text and its limit were not read"


@dataclass(frozen=True)
class Clause:
    """One clause: what was measured, what is required, and where that comes from."""

    name: str
    passed: bool
    measured: str
    required: str
    source: str


@dataclass(frozen=True)
class Acceptance:
    """A motion's test response spectra beside the required one, and the clauses."""

    required: RequiredSpectrum
    rules: AcceptanceRules
    frequency: FloatArray  # (ordinates,) [Hz]
    rrs: FloatArray  # (ordinates,) [m/s^2]
    trs: FloatArray  # (channels, ordinates) [m/s^2]
    names: tuple[str, ...]  # of the channels
    clauses: tuple[Clause, ...]

    @property
    def passed(self) -> bool:
        """Whether every clause is met."""
        return all(clause.passed for clause in self.clauses)


def accept(
    channels: Sequence[FloatArray],
    step: float,
    required: RequiredSpectrum,
    rules: AcceptanceRules | None = None,
    names: Sequence[str] | None = None,
) -> Acceptance:
    """Hold measured accelerations against a required spectrum.

    Parameters
    ----------
    channels
        (samples,) each [m/s^2]: the table's acceleration in one direction.
    step
        [s] of all of them.
    required
        At its own damping.
    rules
        None: the defaults.
    names
        Of the channels.

    Raises
    ------
    ParameterError
        If there is no channel, one is not finite, or it is sampled too coarsely for the spectrum.
    """
    rules = AcceptanceRules() if rules is None else rules
    motions = [np.asarray(each, dtype=float) for each in channels]
    if not motions or any(each.ndim != 1 or not np.isfinite(each).all() for each in motions):
        raise ParameterError("channels", len(motions), "give at least one, of finite numbers")
    if not all(np.any(each) for each in motions):
        raise ParameterError("channels", 0.0, "one is all zeros: no motion was measured")
    frequency = rules.frequencies
    if step * frequency[-1] > 0.4:
        raise ParameterError("step", step, f"is too long for a spectrum to {frequency[-1]:.3g} Hz")
    labels = tuple(names or (f"channel {i + 1}" for i in range(len(motions))))
    trs = np.stack([measured_spectrum(each, step, frequency, required.damping) for each in motions])
    rrs = required.at(frequency)
    clauses: list[Clause] = []
    for label, motion, ordinates in zip(labels, motions, trs, strict=True):
        clauses += _spectral(label, frequency, ordinates / rrs, rules)
        clauses += _durations(label, motion, step, rules)
    for i, j in itertools.combinations(range(len(motions)), 2):
        length = min(len(motions[i]), len(motions[j]))
        pair = (motions[i][:length], motions[j][:length])
        clauses += _independence(f"{labels[i]}, {labels[j]}", *pair, step, rules)
    return Acceptance(required, rules, frequency, rrs, trs, labels, tuple(clauses))


def measured_spectrum(
    motion: FloatArray, step: float, frequency: FloatArray, damping: float
) -> FloatArray:
    """Return the test response spectrum (ordinates,) [m/s^2]: pseudo-acceleration, at 5 % as absolute.

    A motion that is sampled coarsely beside the highest frequency is interpolated first, band-limited.
    """
    factor = math.ceil(SAMPLES_A_PERIOD * frequency[-1] * step)
    if factor > 1:
        motion, step = resample(motion, step, step / factor), step / factor
    return spectrum(motion, step, 1.0 / frequency, damping)


def _spectral(
    label: str, frequency: FloatArray, ratio: FloatArray, rules: AcceptanceRules
) -> list[Clause]:
    """Return the clauses of one channel's ordinates; `ratio` is TRS over RRS."""
    below = ratio < 1.0
    lowest = int(np.argmin(ratio))
    at = f"{ratio[lowest]:.3f} at {frequency[lowest]:.3g} Hz"
    beside = below & (np.append(below[1:], False) | np.append(False, below[:-1]))
    clauses = [
        Clause(
            f"{label}: no ordinate below {rules.tolerated:g} RRS",
            bool(ratio[lowest] >= rules.tolerated), at, f"at least {rules.tolerated:g}", _QUOTED,
        ),
        Clause(
            f"{label}: ordinates below RRS",
            int(below.sum()) <= rules.most_below,
            f"{int(below.sum())} of {len(ratio)}", f"at most {rules.most_below}", _RECALLED,
        ),
        Clause(
            f"{label}: neighbours of an ordinate below RRS",
            not beside.any(),
            "none is below, too" if not beside.any() else f"{int(beside.sum())} side by side",
            "at or above RRS", _RECALLED,
        ),
    ]  # fmt: skip
    if rules.upper is not None:
        highest = int(np.argmax(ratio))
        clauses.append(
            Clause(
                f"{label}: no ordinate above {rules.upper:g} RRS",
                bool(ratio[highest] <= rules.upper),
                f"{ratio[highest]:.3f} at {frequency[highest]:.3g} Hz",
                f"at most {rules.upper:g}", "option of this program",
            )
        )  # fmt: skip
    return clauses


def _durations(label: str, motion: FloatArray, step: float, rules: AcceptanceRules) -> list[Clause]:
    energy = np.cumsum(motion**2)
    at = [
        float(np.searchsorted(energy, share * energy[-1]) * step) for share in (0.05, 0.25, 0.75, 0.95)
    ]
    strong = float(at[3] - at[0])
    part = float(at[2] - at[1]) / strong if strong > 0.0 else 0.0
    return [
        Clause(
            f"{label}: strong motion (5 to 95 % of energy)",
            strong >= rules.strong_motion - 0.5 * step,
            f"{strong:.2f} s", f"at least {rules.strong_motion:g} s", _RECALLED,
        ),
        Clause(
            f"{label}: stationarity (strong part ratio)",
            part >= rules.strong_part,
            f"{part:.2f}", f"at least {rules.strong_part:g}", _NOTES,
        ),
    ]  # fmt: skip


def _independence(
    label: str, a: FloatArray, b: FloatArray, step: float, rules: AcceptanceRules
) -> list[Clause]:
    whole = correlate(a - a.mean(), b - b.mean(), method="fft")
    size = math.sqrt(float(np.sum((a - a.mean()) ** 2) * np.sum((b - b.mean()) ** 2)))
    largest = float(np.max(np.abs(whole))) / size if size > 0.0 else 1.0
    segment = 2 * len(a) // (rules.averages + 1)
    f, coherent = coherence(a, b, 1.0 / step, nperseg=segment)
    band = (f >= rules.lowest_frequency) & (f <= rules.highest_frequency)
    mean = float(np.mean(coherent[band])) if band.any() else 1.0
    return [
        Clause(
            f"{label}: correlation at any lag", largest <= rules.correlation,
            f"{largest:.2f}", f"at most {rules.correlation:g}", _RECALLED,
        ),
        Clause(
            f"{label}: coherence, mean over the band", mean <= rules.coherence,
            f"{mean:.2f}", f"at most {rules.coherence:g}", _RECALLED,
        ),
    ]  # fmt: skip
