"""One recorded component of ground acceleration."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field

import numpy as np

from shake_env.errors import RecordError
from shake_env.model.parameters import FloatArray

PREPARATION = "preparation "  # first word of the keys under which an attribution lists what was done


@dataclass(frozen=True)
class Record:
    """One recorded component of ground acceleration.

    Raises
    ------
    RecordError
        If there are fewer than two samples, one is not finite, or the interval is not above 0 s.
    """

    name: str
    acceleration: FloatArray = field(compare=False, repr=False)  # (points,) [m/s^2], read-only
    sampling_interval: float  # [s]
    attribution: tuple[tuple[str, str], ...]  # the header, as (key, text); keep it with the data
    # Stands for the samples in == and hash: what is computed from a record is cached by the record.
    digest: bytes = field(init=False, repr=False)

    def __post_init__(self) -> None:
        acceleration = _own(self.acceleration)
        if acceleration.ndim != 1 or len(acceleration) < 2:
            raise RecordError(
                f"{self.name}, acceleration shape", acceleration.shape, "must be (points,), 2 at least"
            )
        if not np.isfinite([np.min(acceleration), np.max(acceleration)]).all():  # no array of flags
            index = int(np.argmin(np.isfinite(acceleration)))
            raise RecordError(
                f"{self.name}, sample {index}", float(acceleration[index]), "must be a finite number"
            )
        if not (math.isfinite(self.sampling_interval) and self.sampling_interval > 0.0):
            raise RecordError(
                f"{self.name}, sampling_interval_s", self.sampling_interval, "must be above 0 s"
            )
        acceleration.flags.writeable = False
        object.__setattr__(self, "acceleration", acceleration)
        object.__setattr__(self, "digest", hashlib.sha256(acceleration.data).digest())

    @property
    def prepared(self) -> bool:
        """Whether `shake_env.motion.processing` made it, as its attribution says."""
        return any(key.startswith(PREPARATION) for key, _ in self.attribution)

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return (len(self.acceleration) - 1) * self.sampling_interval


def _own(values: FloatArray) -> FloatArray:
    """Return `values` as an array of the record's own.

    An array that owns its memory and that its maker has set read-only is taken as it is: the readers
    hand over such arrays, so that a large record is in memory once.
    """
    given = isinstance(values, np.ndarray) and values.dtype == np.float64
    if given and values.flags.owndata and values.flags.c_contiguous and not values.flags.writeable:
        return values
    return np.array(values, dtype=np.float64)
