"""An input motion whose response spectrum is compatible with a required one.

Sines of random phase under an envelope, whose amplitudes are corrected by the ratio of required to
computed spectrum until they agree (Gasparini and Vanmarcke, Simulated earthquake motions compatible with
prescribed response spectra, MIT R76-4, 1976: SIMQKE). The whole motion is then raised until no ordinate
lies below the required spectrum.
"""

from __future__ import annotations

import math

import numpy as np

from agents.acceptance.clauses import measured_spectrum
from agents.acceptance.required import FloatArray, RequiredSpectrum
from agents.acceptance.rules import AcceptanceRules
from shake_env.errors import ParameterError
from shake_env.records import Record

RISE, DECAY = 5.0, 5.0  # [s] before and after the strong motion
LOWEST = 0.3  # [Hz] of the sines, over the spectrum's first frequency: below it there is no stroke
ITERATIONS = 30


def compatible_motion(
    required: RequiredSpectrum,
    rules: AcceptanceRules | None = None,
    *,
    seed: int = 0,
    hold: float = 24.0,
    step: float = 0.002,
) -> Record:
    """Return a motion whose test response spectrum is at or just above the required one.

    Parameters
    ----------
    required, rules
        What the motion is to pass.
    seed
        Of the phases; channels of one test take different ones.
    hold
        [s] of constant intensity, between a rise and a decay of 5 s each.
    step
        [s]

    Raises
    ------
    ParameterError
        If the step is too long for the spectrum, or the hold too short for its lowest frequency.
    """
    rules = AcceptanceRules() if rules is None else rules
    frequency = rules.frequencies
    if step * frequency[-1] > 0.25:
        raise ParameterError("step", step, f"must be at most {0.25 / frequency[-1]:.3g} s")
    if not hold * frequency[0] >= 5.0:
        raise ParameterError("hold", hold, f"must be at least {5.0 / frequency[0]:.3g} s")
    samples = round((RISE + hold + DECAY) / step)
    time = step * np.arange(samples)
    rise, decay = time / RISE, (samples * step - time) / DECAY
    envelope = np.clip(np.minimum(rise, decay), 0.0, 1.0) ** 2
    fourier = np.fft.rfftfreq(samples, step)
    band = (fourier >= LOWEST * frequency[0]) & (fourier <= 1.2 * frequency[-1])
    phase = np.random.default_rng(seed).uniform(0.0, 2.0 * math.pi, len(fourier))
    wanted = required.at(frequency)
    amplitude = np.where(band, required.at(np.maximum(fourier, fourier[1])), 0.0)
    amplitude /= np.sqrt(np.maximum(fourier, fourier[1]))

    def motion() -> FloatArray:
        values: FloatArray = envelope * np.fft.irfft(amplitude * np.exp(1j * phase), samples)
        return values

    best, least = motion(), math.inf
    for _ in range(ITERATIONS):
        trial = motion()
        ratio = wanted / measured_spectrum(trial, step, frequency, required.damping)
        spread = float(np.max(ratio) / np.min(ratio))
        if spread < least:
            best, least = trial * math.sqrt(np.max(ratio) * np.min(ratio)), spread
        correction = np.exp(
            np.interp(np.log(np.maximum(fourier, 1e-9)), np.log(frequency), np.log(ratio))
        )
        amplitude = amplitude * correction
    best = best * np.max(wanted / measured_spectrum(best, step, frequency, required.damping))
    made = f"Gasparini and Vanmarcke (1976), {required.name}, seed {seed}"
    return Record(f"compatible {seed}", best, step, (("made", made),))
