"""The matrices of drawn plants, from numbers to the stacks of a batch, by compiled small matrices.

What `plant_batch.PlantBatch` otherwise makes through `model.plant`, `nonlinear`, `yielding_reference`
and `ground`, which stay the reference; a test holds this equal to it. There each entry is an operation
on arrays; here it is one on numbers, and what the current cannot reach is made from its own states
alone. Storeys are a chain, and the equations the corrected ones.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.dynamics.low_pass import OUTPUTS, STATE_SIGNALS, LowPass
from shake_env.dynamics.nonlinear import FLOW, FORCE, SPOOL_RATE
from shake_env.dynamics.yielding_reference import ARRAYS
from shake_env.model.nonlinearity import Nonlinearity, ServoValve
from shake_env.model.parameters import Actuator, FloatArray, GroundFilter, Specimen
from shake_env.model.plant import (
    LOAD_PRESSURE,
    SPOOL_POSITION,
    TABLE_DISPLACEMENT,
    TABLE_VELOCITY,
    ground_filter,
)

IntArray = NDArray[np.int64]
Rows = list[list[float]]


@lru_cache
def _compiled() -> Any:
    """Return :mod:`shake_env.kernels.small_matrices`, which the caller has found to be there."""
    return importlib.import_module("shake_env.kernels.small_matrices")


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
        self._ground, self._parts, self._dt = ground, parts, dt
        self._low_passes, self._force_weight = low_passes, force_weight
        self._stacks: dict[str, Any] = dict(stacks)
        plain = GroundFilter(frequency=ground.frequency, damping_ratio=ground.damping_ratio)
        self._filters = [_filter(ground), _filter(plain)]
        self._ratio = parts.yielding.stiffness_ratio if parts.yielding.active else None

    def put(
        self,
        index: IntArray,
        actuators: Sequence[Actuator],
        specimens: Sequence[Specimen],
        valves: Sequence[ServoValve],
    ) -> int:
        """Write plants to rows `index` (P,) of the stacks; return how many before one was unsound."""
        stacks = self._stacks
        floors = [floor_rows(each, self._ratio) for each in specimens]
        scale = self._scale(actuators, specimens)
        w, n = self._ground.states, specimens[0].stories
        tables = [self._table(*each) for each in zip(actuators, specimens, valves, floors, strict=True)]
        A, B, C, D = (np.array(column) for column in zip(*tables, strict=True))
        moved, level, slope = self._hold(A, B, self._table_scale(scale, valves))
        m, at, rows = A.shape[-1], SPOOL_POSITION, rows_of(index)
        stacks["advance"][rows, :, :m], stacks["advance"][rows, :, m:] = moved, level
        stacks["slope"][rows], stacks["C"][rows] = slope[..., 1:], C
        stacks["D"][rows] = D[..., 1:]
        if self._parts.valve.natural_frequency is None:
            stacks["valve"][rows, 0], stacks["valve"][rows, 1] = A[:, at, at], B[:, at, 0]
        stacks["valve"][rows, 2] = [valve.missing for valve in valves]
        if stacks["floors"] is not None:
            stacks["floors"][rows] = floors
        own = np.concatenate([scale[:, :w], scale[:, w + 4 :]], axis=1)
        sound = self._put_ground(index, specimens, floors, own)
        if self._ratio is not None:
            self._put_yielding(index, specimens, floors, own[:, w : w + 2 * n])
        return min(sound, _sound(scale))

    def _hold(
        self, A: FloatArray, B: FloatArray, scale: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the first-order hold (P, ...): A, and what levels and slopes of the inputs add."""
        moved, level, slope = np.empty_like(A), np.empty_like(B), np.empty_like(B)
        _compiled().holds(A, B, scale, self._dt, moved, level, slope)
        return moved, level, slope

    def _stationary(self, A: FloatArray, B: FloatArray) -> FloatArray:
        """Return the stationary covariances (P, n, n) under white noise through B (P, n)."""
        covariance = np.empty_like(A)
        _compiled().stationary_covariances(A, B, covariance)
        return covariance

    def _scale(self, actuators: Sequence[Actuator], specimens: Sequence[Specimen]) -> FloatArray:
        """Return `CoupledPlant.state_scale` up to the specimen's states, (P, w + 4 + 2 n)."""
        damped = [(each.masses, each.stiffnesses, damped_storeys(each)) for each in specimens]
        rows = [_chain(*each, None) for each in damped]
        A = np.array([_exogenous(each, self._filters[1]) for each in rows])
        B = np.zeros(A.shape[:2])
        B[:, 1] = 1.0
        covariance = self._stationary(A, B)
        rms = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        n, omega, zeta = len(rows[0]), self._ground.omega, self._ground.damping_ratio
        acceleration, velocity = math.sqrt(zeta * omega), math.sqrt(zeta / omega)
        scale = np.empty((len(A), self._ground.states + 4 + 2 * n))
        scale[:, :2] = rms[:, :2]
        if self._ground.states == 4:
            scale[:, 2], scale[:, 3] = velocity / omega, velocity
        middle = []
        for a, (_, stiffnesses, dampings), P in zip(actuators, damped, covariance.tolist(), strict=True):
            k, c = stiffnesses[0], dampings[0]
            square = k * (k * P[2][2] + 2.0 * c * P[2][2 + n]) + c * c * P[2 + n][2 + n]
            force = math.sqrt(
                (a.table_mass * acceleration) ** 2 + (a.table_damping * velocity) ** 2 + square
            )
            spool = a.piston_area * velocity / a.flow_gain
            middle.append((force / a.piston_area, velocity / omega, velocity, spool))
        scale[:, -2 * n - 4 : -2 * n] = middle
        scale[:, -2 * n :] = rms[:, 2:]
        return scale

    def _table_scale(self, scale: FloatArray, valves: Sequence[ServoValve]) -> FloatArray:
        """Return `nonlinear.controlled_scale`, (P, m)."""
        own = scale[:, self._ground.states :]
        n = (own.shape[1] - 4) // 2
        parts = [own]
        if self._ratio is not None:
            parts.append(own[:, 4 : 4 + n])
        if self._low_passes:
            parts.append(np.tile([each.scale for each in self._low_passes], (len(own), 1)))
        if self._parts.valve.natural_frequency is not None:
            omega = np.array([2.0 * math.pi * (each.natural_frequency or 0.0) for each in valves])
            parts.append((own[:, SPOOL_POSITION] * omega)[:, None])
        return np.concatenate(parts, axis=1)

    def _table(
        self, actuator: Actuator, specimen: Specimen, valve: ServoValve, floors: Rows
    ) -> tuple[Rows, Rows, Rows, Rows]:
        """Return A, B, C and D of `nonlinear.controlled_plant`, of one plant."""
        a, n, second_order = actuator, specimen.stories, valve.natural_frequency is not None
        width, slips = len(floors[0]), len(floors[0]) - 2 * n
        place = 4 + width
        m = place + len(self._low_passes) + second_order
        A, B = _zeros(m, m), _zeros(m, 4 + slips)
        C, D = _zeros(2, m), _zeros(2, 4 + slips)
        oil, inverse = 4.0 * a.bulk_modulus / a.oil_volume, 1.0 / a.table_mass
        A[LOAD_PRESSURE][LOAD_PRESSURE] = oil * -a.leakage
        A[LOAD_PRESSURE][TABLE_VELOCITY] = oil * -a.piston_area
        A[LOAD_PRESSURE][SPOOL_POSITION] = B[LOAD_PRESSURE][1 + FLOW] = oil * a.flow_gain
        A[TABLE_DISPLACEMENT][TABLE_VELOCITY] = 1.0
        shear, acceleration = C[1], A[TABLE_VELOCITY]
        shear[4], shear[4 + n] = specimen.stiffnesses[0], specimen.dampings[0]
        if self._ratio is not None:
            shear[4 + 2 * n] = -((1.0 - self._ratio) * specimen.stiffnesses[0])
        acceleration[LOAD_PRESSURE] = a.piston_area / a.table_mass
        acceleration[TABLE_DISPLACEMENT] = -a.table_stiffness / a.table_mass
        acceleration[TABLE_VELOCITY] = -a.table_damping / a.table_mass
        for j in (4, 4 + n, 4 + 2 * n)[: 2 + (slips > 0)]:
            acceleration[j] = inverse * shear[j]
        C[0] = list(acceleration)
        pulled = [(j, value) for j, value in enumerate(acceleration) if value]
        for i in range(n):
            A[4 + i][4 + n + i] = 1.0
            row = A[4 + n + i]
            row[4:place] = floors[i]
            for j, value in pulled:
                row[j] -= value
            B[4 + n + i][1 + FORCE] = -inverse
        for i in range(slips):
            B[4 + 2 * n + i][4 + i] = 1.0
        B[TABLE_VELOCITY][1 + FORCE] = D[0][1 + FORCE] = inverse
        B[SPOOL_POSITION][1 + SPOOL_RATE] = 1.0
        if second_order:
            omega = 2.0 * math.pi * (valve.natural_frequency or 0.0)
            A[SPOOL_POSITION][-1], A[-1][SPOOL_POSITION] = 1.0, -(omega**2)
            A[-1][-1] = -2.0 * valve.damping_ratio * omega
            B[-1][0] = omega**2 * a.valve_gain
        else:
            A[SPOOL_POSITION][SPOOL_POSITION] = -1.0 / a.valve_time_constant
            B[SPOOL_POSITION][0] = a.valve_gain / a.valve_time_constant
        for i, low_pass in enumerate(self._low_passes, start=place):
            name, omega = low_pass.signal, 2.0 * math.pi * low_pass.frequency
            if name in STATE_SIGNALS:
                A[i][STATE_SIGNALS[name]] = omega
            elif name in OUTPUTS:
                A[i] = [omega * value for value in C[OUTPUTS[name]]]
                B[i] = [omega * value for value in D[OUTPUTS[name]]]
            else:
                A[i][4:place] = [omega * value for value in floors[int(name.rsplit("_", 1)[1]) - 1]]
            A[i][i] = -omega
        return A, B, C, D

    def _put_ground(
        self, index: IntArray, specimens: Sequence[Specimen], floors: Sequence[Rows], own: FloatArray
    ) -> int:
        """Write `GroundMaps` and the cost of a force; return how many plants before one was unsound."""
        stacks, w = self._stacks, self._ground.states
        n = specimens[0].stories
        e, P = w + 2 * n, len(index)
        A = np.array([_exogenous(each, self._filters[0]) for each in floors])
        rows = np.array([_outputs(each, self._filters[0][0]) for each in specimens])
        row, column = own[:, None, :], own[:, :, None]
        scaled, driven = A * row / column, np.zeros((P, e))
        driven[:, 1] = 1.0 / own[:, 1]
        sound = P
        if self._force_weight:
            shear = rows[:, 1] * own
            covariance = self._stationary(scaled, driven)
            variance = (shear[:, None, :] @ covariance @ shear[:, :, None])[:, 0, 0]
            stacks["force"][rows_of(index)] = self._force_weight / variance
            sound = _sound(variance[:, None])
        generator = np.zeros((P, 2 * e, 2 * e))
        generator[:, :e, :e], generator[:, e:, e:] = -scaled, scaled.swapaxes(1, 2)
        generator[:, 1, e + 1] = driven[:, 1] ** 2
        power, _, _ = self._hold(generator, np.empty((P, 2 * e, 0)), np.ones((P, 2 * e)))
        made: int = _compiled().noise_maps(power, own, rows, index, stacks["noise"])
        pushed = np.zeros((P, 2 * n, 1))
        pushed[:, n:] = -1.0
        reference = np.ascontiguousarray(A[:, w:, w:])
        held, level, slope = self._hold(reference, pushed, own[:, w:].copy())
        shear = rows[:, 1:, w:].copy()
        _compiled().periods(held, level - slope, slope, shear, index, stacks["record"])
        return min(sound, made)

    def _put_yielding(
        self, index: IntArray, specimens: Sequence[Specimen], floors: Sequence[Rows], own: FloatArray
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
        moved, level, slope = self._hold(A, B, scale)
        ground = slope[..., :1]
        made = (moved, level[..., :1] - ground, ground, level[..., 1:], slope[..., 1:], C)
        for name, values in zip(ARRAYS, made, strict=True):
            self._stacks[f"reference_{name}"][rows_of(index)] = values


def floor_rows(specimen: Specimen, ratio: float | None) -> Rows:
    """Return `nonlinear.floor_rows` of one specimen, with slips where a stiffness ratio is given."""
    return _chain(specimen.masses, specimen.stiffnesses, specimen.dampings, ratio)


def damped_storeys(specimen: Specimen) -> tuple[float, ...]:
    """Return the dampings of `specimens.damped_specimen`, each storey damped by 1 % at least."""
    rows = zip(specimen.masses, specimen.stiffnesses, specimen.dampings, strict=True)
    return tuple(max(c, 0.01 * (2.0 * math.sqrt(m * k))) for m, k, c in rows)


def _chain(
    masses: Sequence[float], stiffnesses: Sequence[float], dampings: Sequence[float], ratio: float | None
) -> Rows:
    n = len(masses)
    rows = _zeros(n, 2 * n if ratio is None else 3 * n)
    for i, (row, mass) in enumerate(zip(rows, masses, strict=True)):
        inverse, top = 1.0 / mass, i + 1 == n
        for start, links in ((0, stiffnesses), (n, dampings)):
            row[start + i] = -inverse * (links[i] if top else links[i] + links[i + 1])
            if i:
                row[start + i - 1] = inverse * links[i]
            if not top:
                row[start + i + 1] = inverse * links[i + 1]
        if ratio is not None:
            row[2 * n + i] = inverse * ((1.0 - ratio) * stiffnesses[i])
            if not top:
                row[2 * n + i + 1] = -inverse * ((1.0 - ratio) * stiffnesses[i + 1])
    return rows


def _filter(ground: GroundFilter) -> tuple[list[float], Rows]:
    """Return the row of the target and the matrix of a ground filter."""
    filtered = ground_filter(ground)
    return filtered.C[0].tolist(), filtered.A.tolist()


def _exogenous(floors: Rows, filtered: tuple[list[float], Rows]) -> Rows:
    """Return the matrix of ``[x_W, x~_S]``, which white noise drives through state 1."""
    target, A = filtered
    n, w = len(floors), len(target)
    pushed = [-value for value in target]
    still = [0.0] * (2 * n)
    rows = [row + still for row in A]
    rows += [[0.0] * (w + n + i) + [1.0] + [0.0] * (n - 1 - i) for i in range(n)]
    return rows + [pushed + row[: 2 * n] for row in floors]


def _outputs(specimen: Specimen, target: list[float]) -> Rows:
    """Return the rows of target and reference shear on ``[x_W, x~_S]``."""
    rest = [0.0] * (specimen.stories - 1)
    shear = [0.0] * len(target) + [specimen.stiffnesses[0], *rest, specimen.dampings[0], *rest]
    return [target + [0.0] * (2 * specimen.stories), shear]


def _zeros(rows: int, columns: int) -> Rows:
    return [[0.0] * columns for _ in range(rows)]


def rows_of(index: IntArray) -> Any:
    """Return an index of plants' rows in a stack; of one row a slice, which is five times as fast."""
    return slice(int(index[0]), int(index[0]) + 1) if len(index) == 1 else index


def _sound(values: FloatArray) -> int:
    """Return how many rows (P, ...) come before one with a value that is not above 0, or infinite."""
    if values.min() > 0.0 and values.max() < math.inf:  # neither holds for NaN
        return len(values)
    sound = ((values > 0.0) & (values < math.inf)).all(axis=1)
    return int(np.argmin(sound))
