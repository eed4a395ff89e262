"""Strict reader of the embedded record format: a commented header, then one acceleration per line."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field

import numpy as np

from shake_env.errors import RecordError
from shake_env.parameters import GRAVITY, FloatArray

_NEEDED = (
    "event",
    "station",
    "component",
    "network",
    "licence",
    "sampling_interval_s",
    "points",
    "units",
)


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
        acceleration = np.array(self.acceleration, dtype=np.float64)
        if acceleration.ndim != 1 or len(acceleration) < 2:
            raise RecordError(
                f"{self.name}, acceleration shape", acceleration.shape, "must be (points,), 2 at least"
            )
        if not np.isfinite(acceleration).all():
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
        object.__setattr__(self, "digest", hashlib.sha256(acceleration.tobytes()).digest())

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return (len(self.acceleration) - 1) * self.sampling_interval


def parse_record(name: str, text: str) -> Record:
    """Read a record and check its header against its data.

    Raises
    ------
    RecordError
        If a header line is missing or not a number, the unit is not g, a sample is not a finite
        number, or the count differs from the header's. The message names line and value.
    """
    header: dict[str, str] = {}
    values: list[float] = []
    in_header = True
    for number, line in enumerate(text.splitlines(), start=1):
        if line.startswith("#"):
            key, colon, entry = line[1:].partition(":")
            if not (in_header and colon):
                raise RecordError(f"{name}, line {number}", line, "header lines read '# key: value'")
            if key.strip() in header:
                raise RecordError(f"{name}, line {number}", line, "says again what a line above says")
            header[key.strip()] = entry.strip()
        elif in_header:
            in_header = False
            if line.strip() != "acceleration":
                raise RecordError(f"{name}, line {number}", line, "expected the column 'acceleration'")
        else:
            value = _parse(line)
            if value is None:
                raise RecordError(f"{name}, line {number}", line, "is not a number")
            if not math.isfinite(value * GRAVITY):
                raise RecordError(f"{name}, line {number}", line, "is not a finite acceleration")
            values.append(value)
    missing = [key for key in _NEEDED if key not in header]
    if missing:
        raise RecordError(f"{name}, header", missing, "these lines are missing")
    if header["units"] != "g":
        raise RecordError(f"{name}, units", header["units"], "must be g")
    step, points = _number(name, header, "sampling_interval_s"), _number(name, header, "points")
    if not step > 0.0:
        raise RecordError(f"{name}, sampling_interval_s", step, "must be above 0 s")
    if points != len(values) or points < 2:
        raise RecordError(
            f"{name}, points", header["points"], f"the file holds {len(values)} samples (2 at least)"
        )
    return Record(name, np.asarray(values) * GRAVITY, step, tuple(header.items()))


def _parse(text: str) -> float | None:
    # float() also reads 1_000 and other alphabets' digits, which no writer of records means.
    if "_" in text or not text.isascii():
        return None
    try:
        return float(text)
    except ValueError:
        return None


def _number(name: str, header: dict[str, str], key: str) -> float:
    value = _parse(header[key])
    if value is None or not math.isfinite(value):
        raise RecordError(f"{name}, {key}", header[key], "must be a finite number")
    return value
