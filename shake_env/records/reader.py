"""Strict reader of the embedded record format: a commented header, then one acceleration per line."""

from __future__ import annotations

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

    Two records are the same if their name and attribution are; the samples are not compared.
    """

    name: str
    acceleration: FloatArray = field(compare=False, repr=False)  # (points,) [m/s^2], read-only
    sampling_interval: float  # [s]
    attribution: tuple[tuple[str, str], ...]  # the header, as (key, text); keep it with the data

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
            key, colon, value = line[1:].partition(":")
            if not (in_header and colon):
                raise RecordError(f"{name}, line {number}", line, "header lines read '# key: value'")
            header[key.strip()] = value.strip()
        elif in_header:
            in_header = False
            if line.strip() != "acceleration":
                raise RecordError(f"{name}, line {number}", line, "expected the column 'acceleration'")
        else:
            try:
                values.append(float(line))
            except ValueError:
                raise RecordError(f"{name}, line {number}", line, "is not a number") from None
            if not math.isfinite(values[-1]):
                raise RecordError(f"{name}, line {number}", line, "is not a finite acceleration")
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
    acceleration = np.asarray(values) * GRAVITY
    acceleration.flags.writeable = False
    return Record(name, acceleration, step, tuple(header.items()))


def _number(name: str, header: dict[str, str], key: str) -> float:
    try:
        value = float(header[key])
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RecordError(f"{name}, {key}", header[key], "must be a finite number")
    return value
