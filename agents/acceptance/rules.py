"""Numbers of the clauses of an acceptance test."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shake_env.errors import ParameterError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class AcceptanceRules:
    """Numbers of the clauses.

    Raises
    ------
    ParameterError
        If a number is out of range.
    """

    lowest_frequency: float = 1.3  # [Hz] from which the required spectrum counts
    highest_frequency: float = 33.3  # [Hz]
    lowest_mode: float | None = None  # [Hz] of the specimen; a third of it counts, where that is higher
    per_octave: int = 6
    tolerated: float = 0.9  # [-] of the required spectrum, that single ordinates may fall to
    most_below: int = 5  # ordinates
    upper: float | None = None  # [-] of the required spectrum; None: no upper bound
    strong_motion: float = 20.0  # [s] at least, between 5 and 95 % of the squared acceleration
    strong_part: float = 0.3  # [-] at least, time of 25 to 75 % over that of 5 to 95 %
    correlation: float = 0.3  # [-] at most, between channels at any lag
    coherence: float = 0.5  # [-] at most, between channels at any frequency
    averages: int = 12  # of a coherence

    def __post_init__(self) -> None:
        if not 0.0 < self.lowest_frequency < self.highest_frequency < math.inf:
            pair = (self.lowest_frequency, self.highest_frequency)
            raise ParameterError(
                "lowest_frequency, highest_frequency", pair, "must be in order, above 0 Hz"
            )
        if not 0.0 < self.tolerated <= 1.0:
            raise ParameterError("tolerated", self.tolerated, "must be above 0 and at most 1")
        if self.upper is not None and not self.upper > 1.0:
            raise ParameterError("upper", self.upper, "must be above 1, or None")
        if self.per_octave < 1 or self.averages < 2:
            raise ParameterError(
                "per_octave, averages", (self.per_octave, self.averages), "are too small"
            )

    @property
    def frequencies(self) -> FloatArray:
        """Frequencies of the test response spectrum, (ordinates,) [Hz]."""
        lowest = max(self.lowest_frequency, (self.lowest_mode or 0.0) / 3.0)
        if lowest >= self.highest_frequency:
            raise ParameterError("lowest_mode", self.lowest_mode, "is above the whole spectrum")
        steps = math.floor(self.per_octave * math.log2(self.highest_frequency / lowest) + 1e-9)
        return lowest * 2.0 ** (np.arange(steps + 1) / self.per_octave)
