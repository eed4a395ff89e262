"""The matrices of drawn plants, from numbers to the stacks of a batch, by one compiled call.

What `plant_batch.PlantBatch` otherwise makes through `model.plant`, `nonlinear`, `yielding_reference`
and `ground`, which stay the reference; a test holds this equal to it. There each entry is an operation
on arrays; in :mod:`shake_env.kernels.plant_matrices` it is one on numbers, and what the current cannot
reach is made from its own states alone. Storeys are a chain, and the equations the corrected ones.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.dynamics.low_pass import OUTPUTS, STATE_SIGNALS, LowPass
from shake_env.dynamics.yielding_reference import ARRAYS
from shake_env.model.nonlinearity import Nonlinearity, ServoValve
from shake_env.model.parameters import Actuator, FloatArray, GroundFilter, Specimen
from shake_env.model.plant import ground_filter

IntArray = NDArray[np.int64]


@lru_cache
def _compiled() -> Any:
    """Return :mod:`shake_env.kernels.plant_matrices`, which the caller has found to be there."""
    return importlib.import_module("shake_env.kernels.plant_matrices")


class DrawnPlants:
    """What the plants of a batch have in common, and the stacks that their matrices go to.

    Parameters
    ----------
    ground, parts, low_passes, dt
        Of the scenario.
    force_weight
        Of the normalised objective; 0: the cost of a force is the same for all plants.
    stacks
        ``advance``, ``slope``, ``C``, ``D``, ``valve``, ``noise``, ``record``, ``force`` (N, ...), and
        None or ``floors``; those of `YieldingReference`, where storeys yield, with "reference_" before.
    """

    def __init__(
        self,
        ground: GroundFilter,
        parts: Nonlinearity,
        low_passes: Sequence[LowPass],
        dt: float,
        force_weight: float,
        stacks: Mapping[str, FloatArray | None],
    ) -> None:
        self._stacks: dict[str, Any] = dict(stacks)
        self._dt, self._force_weight, self._filters = dt, force_weight, ground.states
        self._ratio = parts.yielding.stiffness_ratio if parts.yielding.active else None
        compiled = _compiled()
        plain = GroundFilter(frequency=ground.frequency, damping_ratio=ground.damping_ratio)
        omegas = [2.0 * math.pi * each.frequency for each in low_passes]
        fed = [_source(each.signal) for each in low_passes]
        second_order = parts.valve.natural_frequency is not None
        self._common = (
            (-1.0 if self._ratio is None else self._ratio, second_order),
            (
                np.array(fed, dtype=np.int64).reshape(-1, 2),
                np.array(omegas, dtype=float),
                np.array([each.scale for each in low_passes], dtype=float),
            ),
            np.array([ground.omega, ground.damping_ratio]),
            (*_filter(ground), *_filter(plain)),
            dt,
            tuple(self._stacks[name] for name in ("advance", "slope", "C", "D", "valve")),
            (self._stacks["noise"], self._stacks["record"]),
        )
        self._actuator = attrgetter(*compiled.ACTUATOR)
        self._put = compiled.put_plants

    def put(
        self,
        index: IntArray,
        actuators: Sequence[Actuator],
        specimens: Sequence[Specimen],
        valves: Sequence[ServoValve],
    ) -> int:
        """Write plants to rows `index` (P,) of the stacks; return how many before one was unsound."""
        plants, n, w = len(index), specimens[0].stories, self._filters
        numbers = np.array(
            [
                (*self._actuator(a), valve.natural_frequency or 0.0, valve.damping_ratio, valve.missing)
                for a, valve in zip(actuators, valves, strict=True)
            ]
        )
        storeys = np.array([(each.masses, each.stiffnesses, each.dampings) for each in specimens])
        e = w + 2 * n
        covariance, shear = np.zeros((plants, e, e)), np.zeros((plants, e))
        floors = np.zeros((plants, n, (2 if self._ratio is None else 3) * n))
        scale = np.ones((plants, e + 4))
        weighted = bool(self._force_weight)
        sound: int = self._put(
            index, numbers, storeys, *self._common, (weighted, covariance, shear), (floors, scale)
        )
        rows = rows_of(index)
        if self._stacks["floors"] is not None:
            self._stacks["floors"][rows] = floors
        if weighted:
            variance = (shear[:, None, :] @ covariance @ shear[:, :, None])[:, 0, 0]
            with np.errstate(divide="ignore"):
                self._stacks["force"][rows] = self._force_weight / variance
            sound = min(sound, _sound(variance[:, None]))
        if self._ratio is not None:
            self._put_yielding(index, specimens, floors, scale[:, w + 4 :])
        return sound

    def _put_yielding(
        self,
        index: IntArray,
        specimens: Sequence[Specimen],
        floors: FloatArray,
        own: FloatArray,
    ) -> None:
        """Write the arrays of `YieldingReference`."""
        P, n = len(index), specimens[0].stories
        A, B, C = np.zeros((P, 3 * n, 3 * n)), np.zeros((P, 3 * n, 1 + n)), np.zeros((P, 1, 3 * n))
        place = np.arange(n)
        A[:, place, n + place], B[:, n : 2 * n, 0], B[:, 2 * n + place, 1 + place] = 1.0, -1.0, 1.0
        A[:, n : 2 * n] = floors
        released = 1.0 - (self._ratio or 0.0)
        C[:, 0, [0, n, 2 * n]] = [
            (each.stiffnesses[0], each.dampings[0], -(released * each.stiffnesses[0]))
            for each in specimens
        ]
        scale = np.concatenate([own, own[:, :n]], axis=1)
        moved, level, slope = np.empty_like(A), np.empty_like(B), np.empty_like(B)
        _compiled().holds_of_stacks()(A, B, scale, self._dt, moved, level, slope)
        ground = slope[..., :1]
        made = (moved, level[..., :1] - ground, ground, level[..., 1:], slope[..., 1:], C)
        for name, values in zip(ARRAYS, made, strict=True):
            self._stacks[f"reference_{name}"][rows_of(index)] = values


def _filter(ground: GroundFilter) -> tuple[FloatArray, FloatArray]:
    """Return the row of the target and the matrix of a ground filter."""
    filtered = ground_filter(ground)
    return np.array(filtered.C[0], dtype=float), np.array(filtered.A, dtype=float)


def _source(signal: str) -> tuple[int, int]:
    """Return what a low-pass is fed by, and which of these."""
    compiled = _compiled()
    if signal in STATE_SIGNALS:
        return compiled.STATE, STATE_SIGNALS[signal]
    if signal in OUTPUTS:
        return compiled.OUTPUT, OUTPUTS[signal]
    return compiled.FLOOR, int(signal.rsplit("_", 1)[1]) - 1


def rows_of(index: IntArray) -> Any:
    """Return an index of plants' rows in a stack; of one row a slice, which is five times as fast."""
    return slice(int(index[0]), int(index[0]) + 1) if len(index) == 1 else index


def _sound(values: FloatArray) -> int:
    """Return how many rows (P, ...) come before one with a value that is not above 0, or infinite."""
    if values.min() > 0.0 and values.max() < math.inf:  # neither holds for NaN
        return len(values)
    sound = ((values > 0.0) & (values < math.inf)).all(axis=1)
    return int(np.argmin(sound))
