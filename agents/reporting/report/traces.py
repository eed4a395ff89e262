"""Curves over time, small enough for one page that holds them all.

A curve becomes whole multiples of a fraction of its own peak; differences of successive ones are small
numbers, mostly one byte each, which deflate halves again. Curves are thinned to the highest rate at
which all of them fit, those of filtered noise before those of records, for there are many alike.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.model.plant import LOAD_PRESSURE, TABLE_DISPLACEMENT
from shake_env.simulation.trajectory import Trajectory

FloatArray = NDArray[np.float64]

LEVELS = 400  # of a curve's peak: a quarter of a percent, less than a line is wide
BUDGET = 2_900_000  # [characters] of all curves on a page, which is then below 5 MB
HIGHEST_RATE = 200.0  # [Hz]
NOISE = "filtered noise"  # group of earthquakes that is thinned first
LOWEST_RATE = 10.0  # [Hz] nothing below is worth showing


@dataclass(frozen=True)
class Channel:
    """What a panel shows: the achieved, and where there is one the target, in the panel's unit."""

    key: str
    title: str
    unit: str
    limit: float | None = None  # in the unit
    targeted: bool = False  # whether a target belongs to it


@dataclass(frozen=True)
class Curves:
    """Curves of one earthquake at the control rate, by channel, in the channels' units."""

    rate: float  # [Hz]
    values: dict[str, NDArray[np.float32]]  # (samples,) each

    def thinned(self, stride: int) -> Curves:
        """Return every `stride`-th sample."""
        return Curves(
            self.rate / stride,
            {name: curve[stride - 1 :: stride] for name, curve in self.values.items()},
        )


def achieved_curves(trajectory: Trajectory, drift: bool, input_factor: float = 1e3) -> Curves:
    """Return a report's curves of what table and specimen did, at the end of each control period.

    `input_factor` takes the input to the unit of its panel: 1e3 to mA.
    """
    steps = len(trajectory.current)
    ends = slice(len(trajectory.time) // steps - 1, None, len(trajectory.time) // steps)
    values = {
        "acceleration": trajectory.table_acceleration[ends],
        "shear": 1e-3 * trajectory.base_shear[ends],
        "current": input_factor * trajectory.current,
        "pressure": 1e-6 * trajectory.state[:, LOAD_PRESSURE],
        "stroke": 1e3 * trajectory.state[:, TABLE_DISPLACEMENT],
    }
    if drift:
        values["drift"] = 1e3 * trajectory.state[:, 4]
    return Curves(_rate(trajectory), {key: each.astype(np.float32) for key, each in values.items()})


def target_curves(trajectory: Trajectory, drift: bool) -> Curves:
    """Return a report's curves of what table and specimen should have done."""
    steps = len(trajectory.current)
    ends = slice(len(trajectory.time) // steps - 1, None, len(trajectory.time) // steps)
    values = {
        "acceleration": trajectory.target_acceleration[ends],
        "shear": 1e-3 * trajectory.reference_base_shear[ends],
    }
    if drift:
        values["drift"] = 1e3 * trajectory.reference[:, 0]
    return Curves(_rate(trajectory), {key: each.astype(np.float32) for key, each in values.items()})


def _rate(trajectory: Trajectory) -> float:
    return 1.0 / float(trajectory.control_time[0])


def pack_curves(curves: Curves) -> dict[str, Any]:
    """Return curves over time as text for a report's page; `unpack_curves` is the other way round."""
    scales, parts = {}, []
    for name, curve in curves.values.items():
        known = np.nan_to_num(curve.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0)
        peak = float(np.max(np.abs(known), initial=0.0))
        scale = float(f"{peak / LEVELS:.6g}") or 1.0  # as short as it is written
        scales[name] = scale
        steps = np.diff(np.rint(known / scale).astype(np.int64), prepend=0)
        parts.append(_bytes(2 * np.abs(steps) - (steps < 0)))
    samples = len(next(iter(curves.values.values())))
    blob = base64.b64encode(zlib.compress(b"".join(parts), 9)).decode("ascii")
    return {"rate": curves.rate, "samples": samples, "scales": scales, "blob": blob}


def unpack_curves(packed: Mapping[str, Any]) -> Curves:
    """Return the curves over time that a report's page shows; the page's own script does the same."""
    data = zlib.decompress(base64.b64decode(packed["blob"]))
    numbers, value, shift = [], 0, 0
    for byte in data:
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            numbers.append(-(value + 1) // 2 if value & 1 else value // 2)
            value = shift = 0
    rows = np.array(numbers).reshape(len(packed["scales"]), packed["samples"])
    return Curves(
        packed["rate"],
        {
            name: (scale * np.cumsum(row)).astype(np.float32)
            for (name, scale), row in zip(packed["scales"].items(), rows, strict=True)
        },
    )


def _bytes(numbers: NDArray[np.int64]) -> bytes:
    """Return whole numbers below 2^14 as one or two bytes each, seven bits a byte, lowest first."""
    low, high = numbers & 127, numbers >> 7
    pairs = np.stack([low | np.where(high > 0, 128, 0), high], axis=1).astype(np.uint8)
    packed: bytes = pairs[np.stack([np.ones(len(high), dtype=bool), high > 0], axis=1)].tobytes()
    return packed


def pack_all(
    curves: Sequence[Sequence[Curves]], groups: Sequence[str], budget: int = BUDGET
) -> list[list[dict[str, Any]]]:
    """Return the curves of each earthquake packed, thinned until all fit into `budget` characters.

    Parameters
    ----------
    curves
        Of each earthquake: its target's, then one a controller.
    groups
        Of each earthquake.
    """
    rate = curves[0][0].rate
    stride = max(1, round(rate / HIGHEST_RATE))
    strides = dict.fromkeys(groups, stride)
    packed = [_pack_thinned(each, stride) for each in curves]
    while _size(packed) > budget and rate / max(strides.values()) > LOWEST_RATE:
        finer = [group for group in strides if strides[group] < max(strides.values())]
        for group in finer or ([NOISE] if NOISE in strides else strides):
            strides[group] *= 2
        packed = [
            _pack_thinned(each, strides[group]) if strides[group] != was else old
            for each, group, old, was in zip(
                curves, groups, packed, [round(rate / p[0]["rate"]) for p in packed], strict=True
            )
        ]
    return packed


def _pack_thinned(curves: Sequence[Curves], stride: int) -> list[dict[str, Any]]:
    return [pack_curves(each.thinned(stride)) for each in curves]


def _size(packed: Sequence[Sequence[Mapping[str, Any]]]) -> int:
    return sum(len(each["blob"]) for row in packed for each in row)
