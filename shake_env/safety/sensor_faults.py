"""Readings that cannot be true: no number, out of range, or equal for longer than noise allows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shake_env.model.parameters import FloatArray
from shake_env.scenario.observation import STATE_SIGNALS
from shake_env.scenario.scenario import Scenario

ACCELERATION = "table_acceleration"
RANGE = 1.5  # [-] of a hard limit; a reading beyond it is out of the sensor's range
# Equal readings in a row, or of all channels at once, are a fault if chance gives them less often than
# this: once in a year of tests at 200 Hz.
CHANCE = 1e-9
LEAST_CHANCE = 1e-3  # [-] of two equal readings, however fine the resolution


@dataclass(frozen=True)
class Channels:
    """The readings of an observation that say where the table is.

    The four of x_A in its order, and the accelerometer's where there is one; s of them.
    """

    names: tuple[str, ...]  # s signals
    places: NDArray[np.intp]  # (s,) in the observation
    scale: FloatArray  # (s,) SI, of the observation's entries
    noise: FloatArray  # (s,) rms of a reading's error, SI; a gain's at a third of the signal's limit
    cutoff: float  # [Hz] of the accelerometer's low-pass; infinite: none
    reach: FloatArray  # (s,) largest credible reading, SI; infinite where nothing limits it
    rarity: FloatArray  # (s,) -log10 of the chance that two readings in a row are equal; 0: certain

    @classmethod
    def from_scenario(cls, scenario: Scenario) -> Channels:
        """Return the channels of a scenario that shows all four readings of x_A."""
        layout, limits = scenario.observation, scenario.limits
        names = sorted(STATE_SIGNALS, key=STATE_SIGNALS.__getitem__)
        cutoff = math.inf
        if layout.sensing.full_state:
            actuator = scenario.plant.layout.actuator
            places = np.arange(actuator.start, actuator.stop)
            scale = scenario.plant.state_scale[actuator]
            noise = rarity = gain = np.zeros(len(names))
        else:
            if ACCELERATION in layout.reading_names:
                names.append(ACCELERATION)
            at = np.asarray([layout.reading_names.index(name) for name in names])
            places, scale = layout.readings.start + at, layout.reading_scale[at]
            white, bias, step, gain = (
                layout.sensor_values(name)[at] for name in ("noise", "bias", "resolution", "gain_error")
            )
            noise = np.sqrt(white**2 + bias**2 + step**2 / 12.0)
            rarity = np.where(white > 0.0, _rarity(white, step), 0.0)
            if ACCELERATION in names:
                cutoff = float(layout.sensor_values("lowpass_frequency")[at[-1]])
        spool = min(
            scenario.nonlinearity.valve.spool_limit,
            scenario.actuator.valve_gain * scenario.current_limit,
        )
        own = {"spool_position": spool}
        most = [own.get(name, getattr(limits, name, None)) for name in names]
        reach = np.asarray([math.inf if value is None else RANGE * value for value in most])
        # A gain error counts as that of a signal whose rms is a third of its limit.
        usual = np.where(np.isfinite(reach), reach / (3.0 * RANGE), scale)
        noise = np.hypot(noise, gain * usual)
        return cls(tuple(names), places, scale, noise, cutoff, reach, rarity)

    def incredible(
        self, readings: FloatArray, before: FloatArray, equal: NDArray[np.int64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.int64]]:
        """Return which readings (N, s) cannot be true.

        Parameters
        ----------
        readings, before
            (N, s) now and in the period before, SI.
        equal
            (N, s) readings in a row, up to the one before, that were equal to the first of them.

        Returns
        -------
        impossible, repeated, equal
            (N, s) which are a fault; which are equal to the one before and noise makes that rare; and
            the count, this reading included.
        """
        with np.errstate(invalid="ignore"):
            impossible = ~(np.abs(readings) <= self.reach) | ~np.isfinite(readings)
            same = (readings == before) & (self.rarity > 0.0)
        equal = np.where(same, equal + 1, 0)
        rare = -math.log10(CHANCE)
        together = (same * self.rarity).sum(axis=1) >= rare
        stuck = (equal * self.rarity >= rare) | (same & together[:, None])
        return impossible | stuck, same, equal


def _rarity(noise: FloatArray, resolution: FloatArray) -> FloatArray:
    """Return -log10 of the chance of two equal readings: the density of their difference at zero."""
    with np.errstate(divide="ignore", invalid="ignore"):
        chance = resolution / (2.0 * math.sqrt(math.pi) * noise)
    rarity: FloatArray = -np.log10(np.clip(np.nan_to_num(chance), LEAST_CHANCE, 1.0))
    return rarity
