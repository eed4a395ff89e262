"""Artificial earthquakes for training, beside a scenario's own noise.

Filtered noise of one spectrum, within its stroke, teaches a policy little about motions that use all of
it. These have spectra, lengths and envelopes of their own, none of them taken from a record, and each is
scaled until the table can just repeat it, as recorded motions are.
"""

from __future__ import annotations

import numpy as np

from shake_env.errors import ParameterError
from shake_env.model.parameters import FloatArray
from shake_env.motion.processing import RATED_VELOCITY, TableCapacity, fit_amplitude
from shake_env.motion.targets import Envelope, RecordedMotion
from shake_env.records import Record
from shake_env.scenario.scenario import Scenario

INTERVAL = 0.005  # [s]
LONGEST = 64  # motions of a set: as many histories are kept prepared
STRONG = 50.0  # [m/s^2] rms, more than any table can repeat: only the capacity scales


def artificial_motions(scenario: Scenario, number: int, seed: int) -> tuple[RecordedMotion, ...]:
    """Return `number` artificial earthquakes that the scenario's table can repeat.

    White noise under an envelope, through the spectrum of Clough and Penzien (Dynamics of Structures,
    1993, eq. 24-37): a ground layer of 0.6 to 6 Hz and 30 to 80 % of critical damping on a rock whose
    motion is cut off below 0.1 to 0.5 Hz. Prepared and scaled as the named scenario `records` does it.

    Raises
    ------
    ParameterError
        If the number is not 1 to `LONGEST`.
    """
    if not 1 <= number <= LONGEST:
        raise ParameterError("artificial", number, f"must be 1 to {LONGEST} motions")
    capacity = TableCapacity.from_actuator(scenario.actuator, scenario.specimen, velocity=RATED_VELOCITY)
    motions = []
    for index in range(number):
        name, stream = f"artificial {seed + index}", np.random.default_rng([seed + index, 1])
        record = Record(name, _accelerogram(stream), INTERVAL, (("source", "made, not recorded"),))
        motion = RecordedMotion(record=record, highpass_frequency=0.2, lowpass_frequency=25.0)
        motions.append(fit_amplitude(motion, capacity, physics_step=scenario.physics_step).motion)
    return tuple(motions)


def _accelerogram(stream: np.random.Generator) -> FloatArray:
    """Return ground acceleration (samples,) [m/s^2] at `INTERVAL`."""
    envelope = Envelope(
        rise=stream.uniform(1.0, 5.0),
        hold=stream.uniform(2.0, 12.0),
        decay_rate=stream.uniform(0.1, 0.5),
    )
    time = np.arange(round(stream.uniform(15.0, 30.0) / INTERVAL), dtype=np.float64) * INTERVAL
    noise = stream.standard_normal(len(time)) * envelope.at(time)
    f = np.fft.rfftfreq(len(time), INTERVAL)
    ground, corner = np.exp(stream.uniform(np.log([0.6, 0.1]), np.log([6.0, 0.5])))
    damping = stream.uniform(0.3, 0.8)
    soil = 2j * damping * f / ground
    layer = (1.0 + soil) / (1.0 - (f / ground) ** 2 + soil)
    rock = (f / corner) ** 2 / (1.0 - (f / corner) ** 2 + 1.2j * f / corner)
    acceleration: FloatArray = np.fft.irfft(np.fft.rfft(noise) * layer * rock, len(time))
    return STRONG * acceleration / np.std(acceleration)
