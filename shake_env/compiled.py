"""The update of :mod:`shake_env.nonlinear_dynamics`, compiled by numba: same equations, same results.

Lanes are stepped in blocks through a whole control period, a row for each state, so that every line of
arithmetic runs over the lanes of a block in vector registers. The array-API kernel is the reference, and
a test holds this one equal to it. Nothing else imports numba; this module is imported on first use.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import float64, int64, njit, types, void
from numpy.typing import NDArray

from shake_env.nonlinearity import Nonlinearity
from shake_env.parameters import FloatArray
from shake_env.plant import LOAD_PRESSURE, SPOOL_POSITION, TABLE_DISPLACEMENT, TABLE_VELOCITY

IntArray = NDArray[np.int64]

BLOCK = 64  # lanes: the rows of a block, half a kilobyte each, stay in the first-level cache

# Places in the vector of scalars; infinite is off.
(
    EXCESS, STRIBECK_VELOCITY, SMOOTHING_VELOCITY, VISCOUS, SUPPLY_PRESSURE, SPOOL_LIMIT, DEAD_BAND,
    RATE_LIMIT, GAP, STIFFNESS, DAMPING, YIELD_DRIFT, EXPONENT,
) = range(13)  # fmt: skip
# Places in the vector of switches: where each part's first column of g lies, -1 if the part is off and
# its columns left out of every product; then what else shapes the loops.
FLOW, FORCE, RATE, SLIPS, COLUMNS, FRICTION, STATIC, SPOOL_VELOCITY, STORIES = range(9)

# fastmath stays off and nothing is contracted: a lane's sums are the same in a vector register as alone,
# so that no result depends on the batch.
_jit = njit(cache=True, error_model="numpy", nogil=True)


def scalars(parts: Nonlinearity) -> FloatArray:
    """Return the values of the parts in SI, in the order of :data:`EXCESS` and its followers."""
    friction, valve, stops, yielding = parts.friction, parts.valve, parts.stops, parts.yielding
    excess = 0.0 if friction.static is None else friction.static - friction.coulomb
    return np.array(
        [
            excess, friction.stribeck_velocity, friction.smoothing_velocity, friction.viscous,
            valve.supply_pressure, valve.spool_limit, valve.dead_band, valve.spool_rate_limit,
            stops.gap, stops.stiffness, stops.damping, yielding.yield_drift, yielding.exponent,
        ]
    )  # fmt: skip


def switches(parts: Nonlinearity, stories: int, order: int) -> IntArray:
    """Return which parts are on and where, in the order of :data:`FLOW` and its followers."""
    widths = (
        int(parts.valve.flow_active),
        int(parts.friction.active or parts.stops.active),
        int(math.isfinite(parts.valve.spool_rate_limit)),
        stories * parts.yielding.active,
    )
    places = [sum(widths[:i]) if width else -1 for i, width in enumerate(widths)]
    first_order = parts.valve.natural_frequency is None
    static = parts.friction.static is not None
    rest = (sum(widths), parts.friction.active, static, -1 if first_order else order - 1, stories)
    return np.array([*places, *rest], dtype=np.int64)


@_jit
def _expm1(x: float) -> float:
    """Return exp(x) - 1 for x <= 0 to a few units in the last place, without a branch or a call.

    The series at x / 256, where eleven terms reach rounding, then ``e(2 x) = e(x) (e(x) + 2)`` eight
    times, which does not amplify a relative error. Beyond -40 it is -1 to rounding.
    """
    z = (-40.0 if x < -40.0 else x) * (1.0 / 256.0)
    p = 1.0 + z * (1.0 / 11.0)
    p = 1.0 + z * (1.0 / 10.0) * p
    p = 1.0 + z * (1.0 / 9.0) * p
    p = 1.0 + z * (1.0 / 8.0) * p
    p = 1.0 + z * (1.0 / 7.0) * p
    p = 1.0 + z * (1.0 / 6.0) * p
    p = 1.0 + z * (1.0 / 5.0) * p
    p = 1.0 + z * (1.0 / 4.0) * p
    p = 1.0 + z * (1.0 / 3.0) * p
    p = z * (1.0 + z * (1.0 / 2.0) * p)
    for _ in range(8):
        p = p * (p + 2.0)
    return p


@_jit
def _tanh(x: float) -> float:
    p = _expm1(-2.0 * abs(x))
    return math.copysign(-p / (p + 2.0), x)


@_jit
def _within(x: float, limit: float) -> float:
    # As comparisons, and not min and max, so that a NaN stays one.
    return limit if x > limit else (-limit if x < -limit else x)


@_jit
def _flow(spool: FloatArray, pressure: FloatArray, v: FloatArray, flow: FloatArray, w: int) -> None:
    limit, dead, supply = v[SPOOL_LIMIT], v[DEAD_BAND], v[SUPPLY_PRESSURE]
    for n in range(w):
        limited = _within(spool[n], limit)
        past = abs(limited) - dead
        opening = math.copysign(0.0 if past < 0.0 else past, limited)
        available = 1.0 - (pressure[n] if opening > 0.0 else -pressure[n]) / supply
        flow[n] = opening * math.sqrt(1e-6 if available < 1e-6 else available) - spool[n]


@_jit
def _friction(
    velocity: FloatArray, v: FloatArray, static: bool, coulomb: FloatArray, force: FloatArray, w: int
) -> None:
    smoothing, viscous = v[SMOOTHING_VELOCITY], v[VISCOUS]
    excess, stribeck = v[EXCESS], v[STRIBECK_VELOCITY]
    for n in range(w):
        force[n] = coulomb[n]
    if static:
        for n in range(w):
            ratio = velocity[n] / stribeck
            force[n] += excess * (1.0 + _expm1(-(ratio * ratio)))
    for n in range(w):
        force[n] = -(force[n] * _tanh(velocity[n] / smoothing) + viscous * velocity[n])


@_jit
def _stops(
    displacement: FloatArray, velocity: FloatArray, v: FloatArray, force: FloatArray, w: int
) -> None:
    gap, stiffness, damping = v[GAP], v[STIFFNESS], v[DAMPING]
    for n in range(w):
        past = abs(displacement[n]) - gap
        depth = 0.0 if past < 0.0 else past
        outward = velocity[n] if displacement[n] > 0.0 else -velocity[n]
        share = depth / 1e-3
        push = stiffness * depth + damping * outward * (1.0 if share > 1.0 else share)
        force[n] -= math.copysign(0.0 if push < 0.0 else push, displacement[n])


@_jit
def _slips(x: FloatArray, v: FloatArray, stories: int, slips: FloatArray, w: int) -> None:
    drift_limit, exponent = v[YIELD_DRIFT], v[EXPONENT]
    whole = exponent == math.floor(exponent) and exponent <= 16.0
    for storey in range(stories):
        position, velocity, slip = x[4 + storey], x[4 + stories + storey], x[4 + 2 * stories + storey]
        below, below_velocity = x[3 + storey], x[3 + stories + storey]
        # Drifts are relative to the table: nothing lies below the first storey.
        moving = 0.0 if storey == 0 else 1.0
        for n in range(w):
            z = (position[n] - moving * below[n] - slip[n]) / drift_limit
            rate = velocity[n] - moving * below_velocity[n]
            size = abs(z)
            power = size
            if whole:
                for _ in range(int(exponent) - 1):
                    power *= size
            else:
                power = size**exponent
            slips[storey, n] = rate * (1.0 if rate * z > 0.0 else 0.0) * power


@_jit
def _fill(y: FloatArray, value: float, w: int) -> None:
    for i in range(len(y)):
        for n in range(w):
            y[i, n] = value


@_jit
def _nonlinear(
    x: FloatArray,
    current: FloatArray,
    v: FloatArray,
    s: IntArray,
    coulomb: FloatArray,
    spool_rate: FloatArray,
    g: FloatArray,
    w: int,
) -> None:
    """Write g, (columns, w), for states x, (order, w); see `NonlinearDynamics.nonlinear`."""
    if s[FLOW] >= 0:
        _flow(x[SPOOL_POSITION], x[LOAD_PRESSURE], v, g[s[FLOW]], w)
    if s[FORCE] >= 0:
        _fill(g[s[FORCE] : s[FORCE] + 1], 0.0, w)
        if s[FRICTION]:
            _friction(x[TABLE_VELOCITY], v, s[STATIC] > 0, coulomb, g[s[FORCE]], w)
        if v[GAP] < math.inf:
            _stops(x[TABLE_DISPLACEMENT], x[TABLE_VELOCITY], v, g[s[FORCE]], w)
    if s[RATE] >= 0:
        rate, limit = g[s[RATE]], v[RATE_LIMIT]
        if s[SPOOL_VELOCITY] >= 0:
            for n in range(w):
                rate[n] = x[s[SPOOL_VELOCITY], n]
        else:
            for n in range(w):
                rate[n] = spool_rate[0, n] * x[SPOOL_POSITION, n] + spool_rate[1, n] * current[n]
        for n in range(w):
            rate[n] = _within(rate[n], limit) - rate[n]
    if s[SLIPS] >= 0:
        _slips(x, v, s[STORIES], g[s[SLIPS] :], w)


@_jit
def _add_product(matrix: FloatArray, x: FloatArray, y: FloatArray, w: int) -> None:
    """Add matrix (rows, columns, 1 or lanes) times x (columns, w) to y (rows, w).

    Four columns a pass, so that a sum is loaded and stored a quarter as often.
    """
    rows, columns = matrix.shape[0], matrix.shape[1]
    quads = columns - columns % 4
    for i in range(rows):
        out, row = y[i], matrix[i]
        if matrix.shape[2] == 1:
            for j in range(0, quads, 4):
                a, b, c, d = row[j, 0], row[j + 1, 0], row[j + 2, 0], row[j + 3, 0]
                for n in range(w):
                    out[n] = out[n] + a * x[j, n] + b * x[j + 1, n] + c * x[j + 2, n] + d * x[j + 3, n]
            for j in range(quads, columns):
                a = row[j, 0]
                for n in range(w):
                    out[n] = out[n] + a * x[j, n]
        else:
            for j in range(0, quads, 4):
                for n in range(w):
                    out[n] = (
                        out[n]
                        + row[j, n] * x[j, n]
                        + row[j + 1, n] * x[j + 1, n]
                        + row[j + 2, n] * x[j + 2, n]
                        + row[j + 3, n] * x[j + 3, n]
                    )
            for j in range(quads, columns):
                for n in range(w):
                    out[n] = out[n] + row[j, n] * x[j, n]


@_jit
def _gather(
    source: FloatArray, first: int, count: int, s: IntArray, plain: int, target: FloatArray, start: int
) -> None:
    """Copy matrices (lanes, rows, columns) from lane `first` on, lanes last, to columns from `start` on.

    After `plain` columns come those of g, of which parts that are off are left out.
    """
    for n in range(count):
        for i in range(source.shape[1]):
            for j in range(plain):
                target[i, start + j, n] = source[first + n, i, j]
            at = start + plain
            for j in range(source.shape[2] - plain):
                if s[min(j, SLIPS)] >= 0:
                    target[i, at, n] = source[first + n, i, plain + j]
                    at += 1


def _given(dimensions: int) -> types.Array:
    return types.Array(float64, dimensions, "A", readonly=True)


_ranks = (2, 1, 3, 3, 3, 3, 2, 1, 3)  # of state to arrival
_made = float64[:, ::1]


# A signature of its own, so that this compiles once, for arrays of any layout.
@njit(
    void(*map(_given, _ranks), float64[::1], int64[::1], _made, _made, _made),
    cache=True,
    error_model="numpy",
    nogil=True,
)
def _period(
    state: FloatArray,
    command: FloatArray,
    advance: FloatArray,
    slope: FloatArray,
    C: FloatArray,
    D: FloatArray,
    spool_rate: FloatArray,
    coulomb: FloatArray,
    arrival: FloatArray,
    v: FloatArray,
    s: IntArray,
    moved: FloatArray,
    acceleration: FloatArray,
    shear: FloatArray,
) -> None:
    lanes, order, inputs = len(state), advance.shape[1], s[COLUMNS]
    substeps, commands = arrival.shape[1], arrival.shape[2] - 1
    own = len(advance) > 1
    width = min(BLOCK, lanes)
    depth = width + 8 if own else 1  # a stride off the powers of two, which share few cache lines
    transition = np.empty((order, order + 1 + inputs, depth))
    change = np.empty((order, inputs, depth))
    outputs = np.zeros((2, order + 1 + inputs, depth))
    x = np.empty((order + 1 + inputs, width))  # state, current, g
    current, g = x[order], x[order + 1 :]
    y, later, seen = np.empty((order, width)), np.empty((inputs, width)), np.empty((2, width))
    arriving, friction, rate = np.empty((substeps, width)), np.empty(width), np.empty((2, width))
    none = lanes - lanes  # a zero that is no literal: for one the helpers would be compiled again
    for first in range(0, lanes, width):
        w = min(width, lanes - first)
        if own or first == 0:
            count = w if own else 1
            _gather(advance, first, count, s, order + 1, transition, none)
            _gather(slope, first, count, s, none, change, none)
            _gather(C, first, count, s, order, outputs, none)
            _gather(D, first, count, s, none, outputs, order + 1)
        for n in range(w):
            lane = first + n
            for i in range(order):
                x[i, n] = state[lane, i]
            friction[n] = coulomb[lane if len(coulomb) > 1 else 0]
            for i in range(2):
                rate[i, n] = spool_rate[lane if len(spool_rate) > 1 else 0, i]
            picks = arrival[lane if len(arrival) > 1 else 0]
            for j in range(substeps):
                arriving[j, n] = picks[j, commands] * command[lane]
                for i in range(commands):
                    arriving[j, n] += picks[j, i] * state[lane, order + i]
        for j in range(substeps + 1):
            # The outputs see of g the force only, which does not depend on the current: what is computed
            # for them also begins the next step.
            for n in range(w):
                current[n] = arriving[min(j, substeps - 1), n]
            _nonlinear(x, current, v, s, friction, rate, g, w)
            if j > 0:
                _fill(seen, 0.0, w)
                _add_product(outputs, x, seen, w)
                for n in range(w):
                    acceleration[first + n, j - 1], shear[first + n, j - 1] = seen[0, n], seen[1, n]
            if j == substeps:
                break
            _fill(y, 0.0, w)
            _add_product(transition, x, y, w)
            _nonlinear(y, current, v, s, friction, rate, later, w)
            for i in range(inputs):
                for n in range(w):
                    later[i, n] -= g[i, n]
            _add_product(change, later, y, w)
            for n in range(w):
                y[SPOOL_POSITION, n] = _within(y[SPOOL_POSITION, n], v[SPOOL_LIMIT])
            for i in range(order):
                for n in range(w):
                    x[i, n] = y[i, n]
        for n in range(w):
            lane = first + n
            for i in range(order):
                moved[lane, i] = x[i, n]
            for i in range(commands):
                moved[lane, order + i] = (
                    state[lane, order + i + 1] if i + 1 < commands else command[lane]
                )


@dataclass(frozen=True)
class CompiledStep:
    """The matrices of a `NonlinearDynamics` as the compiled update takes them.

    They are views: what is written into the stacks of a fleet is seen.
    """

    advance: FloatArray  # (1 or N, m, m + 1 + inputs), and so on as in NonlinearDynamics
    slope: FloatArray
    C: FloatArray
    D: FloatArray
    spool_rate: FloatArray  # (1 or N, 2)
    coulomb: FloatArray  # (1 or N)
    arrival: FloatArray  # (1 or N, k, commands + 1)
    values: FloatArray  # see scalars
    on: IntArray  # see switches
    lanes: int | None  # N, or None where the matrices are common to any batch

    @classmethod
    def of(
        cls, parts: Nonlinearity, stories: int, matrices: dict[str, FloatArray]
    ) -> CompiledStep | None:
        """Return the step of these matrices, or None where they are not laid out for it."""
        ranks = {"advance": 2, "slope": 2, "C": 2, "D": 2, "spool_rate": 1, "coulomb": 0, "arrival": 2}
        extra = {array.ndim - ranks[name] for name, array in matrices.items()}
        double = all(type(a) is np.ndarray and a.dtype == np.float64 for a in matrices.values())
        if not double or extra not in ({0}, {1}):
            return None
        stacked = extra == {1}
        if stacked and len({len(array) for array in matrices.values()}) != 1:
            return None
        views = {name: array if stacked else array[None] for name, array in matrices.items()}
        order = views["advance"].shape[1]
        lanes = len(views["advance"]) if stacked else None
        return cls(**views, values=scalars(parts), on=switches(parts, stories, order), lanes=lanes)

    def fits(self, state: FloatArray, current: FloatArray) -> bool:
        """Return whether a batch has the type and shape that the compiled update takes."""
        batch = state.shape[:-1]
        return (
            state.dtype == np.float64
            and isinstance(current, np.ndarray | np.float64)
            and current.dtype == np.float64
            and current.shape == batch
            and state.shape[-1] == self.advance.shape[1] + self.arrival.shape[2] - 1
            and state.size > 0
            and (self.lanes is None or batch == (self.lanes,))
        )

    def __call__(
        self, state: FloatArray, current: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the state, y_A (..., k) and f_s (..., k) of one control period."""
        rows = state.reshape(-1, state.shape[-1])
        lanes, substeps = len(rows), self.arrival.shape[1]
        moved = np.empty(rows.shape)
        acceleration, shear = np.empty((lanes, substeps)), np.empty((lanes, substeps))
        _period(
            rows, current.reshape(-1), self.advance, self.slope, self.C, self.D, self.spool_rate,
            self.coulomb, self.arrival, self.values, self.on, moved, acceleration, shear,
        )  # fmt: skip
        if state.ndim == 2:
            return moved, acceleration, shear
        steps = (*state.shape[:-1], substeps)
        return moved.reshape(state.shape), acceleration.reshape(steps), shear.reshape(steps)
