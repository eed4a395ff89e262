"""The matrices of drawn plants from their numbers, in one compiled call.

Beside `model.plant`, `dynamics.nonlinear` and `dynamics.ground`, of which it repeats the assembly one
number at a time; see :mod:`shake_env.dynamics.drawn_plants`. Storeys are a chain.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numba import boolean, float64, int64, types
from numpy.typing import NDArray

from shake_env.kernels.compiling import cached, stamp
from shake_env.kernels.small_matrices import hold, jit, noise_map, period, stationary_covariance
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import LOAD_PRESSURE, SPOOL_POSITION, TABLE_DISPLACEMENT, TABLE_VELOCITY

IntArray = NDArray[np.int64]

# Numbers of a plant: of its actuator by their names there, then of its valve.
ACTUATOR = (
    "table_mass", "table_damping", "table_stiffness", "piston_area", "leakage", "bulk_modulus",
    "oil_volume", "flow_gain", "valve_gain", "valve_time_constant",
)  # fmt: skip
(
    MASS, DAMPING, STIFFNESS, AREA, LEAKAGE, MODULUS, VOLUME, FLOW_GAIN, VALVE_GAIN, TIME_CONSTANT,
    NATURAL_FREQUENCY, DAMPING_RATIO, MISSING,
) = range(13)  # fmt: skip
STATE, OUTPUT, FLOOR = range(3)  # what a low-pass is fed by
FLOW, FORCE, SPOOL_RATE, SLIPS = range(1, 5)  # columns of B, behind the current's


flat, rows, stack = float64[::1], float64[:, ::1], float64[:, :, ::1]


@jit
def _put(matrix: FloatArray, first: int, out: FloatArray, column: int) -> None:
    """Write a matrix, less its first columns, to another from a column on.

    numba compiles an assignment of arrays with the text of an error, which takes seconds.
    """
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1] - first):
            out[i, column + j] = matrix[i, first + j]


@jit
def _chain(masses: FloatArray, stiffnesses: FloatArray, dampings: FloatArray, ratio: float) -> Any:
    """Return `nonlinear.floor_rows` (n, 2 n) of a chain; (n, 3 n) where a ratio is 0 or more."""
    n = len(masses)
    rows = np.zeros((n, 3 * n if ratio >= 0.0 else 2 * n))
    for i in range(n):
        inverse, top = 1.0 / masses[i], i + 1 == n
        for start in range(0, 2 * n, n):
            links = dampings if start else stiffnesses
            rows[i, start + i] = -inverse * (links[i] if top else links[i] + links[i + 1])
            if i:
                rows[i, start + i - 1] = inverse * links[i]
            if not top:
                rows[i, start + i + 1] = inverse * links[i + 1]
        if ratio >= 0.0:
            rows[i, 2 * n + i] = inverse * ((1.0 - ratio) * stiffnesses[i])
            if not top:
                rows[i, 2 * n + i + 1] = -inverse * ((1.0 - ratio) * stiffnesses[i + 1])
    return rows


@jit
def _exogenous(floors: FloatArray, target: FloatArray, filtered: FloatArray) -> Any:
    """Return the matrix of ``[x_W, x~_S]``, which white noise drives through state 1."""
    n, w = len(floors), len(target)
    a = np.zeros((w + 2 * n, w + 2 * n))
    _put(filtered, 0, a, 0)
    for i in range(n):
        a[w + i, w + n + i] = 1.0
        for j in range(w):
            a[w + n + i, j] = -target[j]
        for j in range(2 * n):
            a[w + n + i, w + j] = floors[i, j]
    return a


@jit
def _damped(storeys: FloatArray) -> Any:
    """Return the dampings of `specimens.damped_specimen`, each storey damped by 1 % at least."""
    damped = np.empty(storeys.shape[1])
    for i in range(len(damped)):
        damped[i] = max(storeys[2, i], 0.01 * (2.0 * math.sqrt(storeys[0, i] * storeys[1, i])))
    return damped


@jit
def _scale(
    numbers: FloatArray,
    storeys: FloatArray,
    filters: int,
    omega: float,
    zeta: float,
    spread: FloatArray,
) -> Any:
    """Return `CoupledPlant.state_scale` up to the specimen's states, (w + 4 + 2 n).

    From the stationary covariance of ``[x_W, x~_S]`` without a high-pass, storeys as `_damped`.
    """
    n = storeys.shape[1]
    acceleration, velocity = math.sqrt(zeta * omega), math.sqrt(zeta / omega)
    scale = np.empty(filters + 4 + 2 * n)
    for i in range(2):
        scale[i] = math.sqrt(spread[i, i])
    if filters == 4:
        scale[2], scale[3] = velocity / omega, velocity
    k, c = storeys[1, 0], _damped(storeys)[0]
    square = k * (k * spread[2, 2] + 2.0 * c * spread[2, 2 + n]) + c * c * spread[2 + n, 2 + n]
    inertia, drag = numbers[MASS] * acceleration, numbers[DAMPING] * velocity
    force = math.sqrt(inertia * inertia + drag * drag + square)
    scale[filters + LOAD_PRESSURE] = force / numbers[AREA]
    scale[filters + TABLE_DISPLACEMENT], scale[filters + TABLE_VELOCITY] = velocity / omega, velocity
    scale[filters + SPOOL_POSITION] = numbers[AREA] * velocity / numbers[FLOW_GAIN]
    for i in range(2 * n):
        scale[filters + 4 + i] = math.sqrt(spread[2 + i, 2 + i])
    return scale


@jit
def _table(
    numbers: FloatArray,
    storeys: FloatArray,
    floors: FloatArray,
    ratio: float,
    second_order: bool,
    signals: IntArray,
    omegas: FloatArray,
) -> Any:
    """Return A, B, C and D of `nonlinear.controlled_plant`."""
    n, width = floors.shape
    slips, place = width - 2 * n, 4 + width
    m = place + len(signals) + second_order
    A, B = np.zeros((m, m)), np.zeros((m, SLIPS + slips))
    C, D = np.zeros((2, m)), np.zeros((2, SLIPS + slips))
    mass = numbers[MASS]
    oil, inverse = 4.0 * numbers[MODULUS] / numbers[VOLUME], 1.0 / mass
    A[LOAD_PRESSURE, LOAD_PRESSURE] = oil * -numbers[LEAKAGE]
    A[LOAD_PRESSURE, TABLE_VELOCITY] = oil * -numbers[AREA]
    A[LOAD_PRESSURE, SPOOL_POSITION] = B[LOAD_PRESSURE, FLOW] = oil * numbers[FLOW_GAIN]
    A[TABLE_DISPLACEMENT, TABLE_VELOCITY] = 1.0
    acceleration, shear = C[0], C[1]
    shear[4], shear[4 + n] = storeys[1, 0], storeys[2, 0]
    if slips:
        shear[4 + 2 * n] = -((1.0 - ratio) * storeys[1, 0])
    acceleration[LOAD_PRESSURE] = numbers[AREA] / mass
    acceleration[TABLE_DISPLACEMENT] = -numbers[STIFFNESS] / mass
    acceleration[TABLE_VELOCITY] = -numbers[DAMPING] / mass
    for j in range(4, place, n):
        acceleration[j] = inverse * shear[j]
    for j in range(place):
        A[TABLE_VELOCITY, j] = acceleration[j]
    for i in range(n):
        A[4 + i, 4 + n + i] = 1.0
        for j in range(width):
            A[4 + n + i, 4 + j] = floors[i, j]
        for j in range(place):
            if acceleration[j] != 0.0:
                A[4 + n + i, j] -= acceleration[j]
        B[4 + n + i, FORCE] = -inverse
    for i in range(slips):
        B[4 + 2 * n + i, SLIPS + i] = 1.0
    B[TABLE_VELOCITY, FORCE] = D[0, FORCE] = inverse
    B[SPOOL_POSITION, SPOOL_RATE] = 1.0
    if second_order:
        omega = 2.0 * math.pi * numbers[NATURAL_FREQUENCY]
        A[SPOOL_POSITION, m - 1], A[m - 1, SPOOL_POSITION] = 1.0, -(omega * omega)
        A[m - 1, m - 1] = -2.0 * numbers[DAMPING_RATIO] * omega
        B[m - 1, 0] = omega * omega * numbers[VALVE_GAIN]
    else:
        A[SPOOL_POSITION, SPOOL_POSITION] = -1.0 / numbers[TIME_CONSTANT]
        B[SPOOL_POSITION, 0] = numbers[VALVE_GAIN] / numbers[TIME_CONSTANT]
    for i in range(len(signals)):
        row, kind, which, omega = place + i, signals[i, 0], signals[i, 1], omegas[i]
        if kind == STATE:
            A[row, which] = omega
        elif kind == OUTPUT:
            for j in range(m):
                A[row, j] = omega * C[which, j]
            for j in range(B.shape[1]):
                B[row, j] = omega * D[which, j]
        else:
            for j in range(width):
                A[row, 4 + j] = omega * floors[which, j]
        A[row, row] = -omega
    return A, B, C, D


@jit
def _table_scale(
    own: FloatArray, width: int, sizes: FloatArray, second_order: bool, frequency: float
) -> Any:
    """Return `nonlinear.controlled_scale` from the scale of ``[x_A, x_S]``."""
    place, specimen = 4 + width, len(own) - 4
    scale = np.empty(place + len(sizes) + second_order)
    for i in range(place):
        scale[i] = own[i if i < 4 + specimen else i - specimen]
    for i in range(len(sizes)):
        scale[place + i] = sizes[i]
    if second_order:
        scale[len(scale) - 1] = own[SPOOL_POSITION] * (2.0 * math.pi * frequency)
    return scale


@jit
def _scaled(A: FloatArray, own: FloatArray) -> Any:
    """Return the matrix of states over their scale, and what white noise drives of them."""
    e = len(A)
    scaled, driven = np.empty((e, e)), np.zeros(e)
    for i in range(e):
        for j in range(e):
            scaled[i, j] = A[i, j] * own[j] / own[i]
    driven[1] = 1.0 / own[1]
    return scaled, driven


@jit
def _generator(scaled: FloatArray, driven: FloatArray) -> Any:
    """Return the matrix whose exponential has the covariance of a step's noise."""
    e = len(scaled)
    generator = np.zeros((2 * e, 2 * e))
    for i in range(e):
        for j in range(e):
            generator[i, j], generator[e + i, e + j] = -scaled[i, j], scaled[j, i]
    generator[1, e + 1] = driven[1] * driven[1]
    return generator


@jit
def _outputs(target: FloatArray, storeys: FloatArray) -> Any:
    """Return the rows of target and reference shear on ``[x_W, x~_S]``."""
    w, n = len(target), storeys.shape[1]
    rows = np.zeros((2, w + 2 * n))
    for j in range(w):
        rows[0, j] = target[j]
    rows[1, w], rows[1, w + n] = storeys[1, 0], storeys[2, 0]
    return rows


@jit
def _part(matrix: FloatArray, row: int, column: int) -> Any:
    """Return the rows and columns of a matrix from some on."""
    part = np.empty((matrix.shape[0] - row, matrix.shape[1] - column))
    for i in range(part.shape[0]):
        for j in range(part.shape[1]):
            part[i, j] = matrix[row + i, column + j]
    return part


def _made() -> Any:
    """Return the function as numba keeps it on disk."""
    number = stamp()

    def put_plants(
        index: IntArray,
        numbers: FloatArray,
        storeys: FloatArray,
        parts: Any,
        lag: Any,
        ground: FloatArray,
        filters: Any,
        dt: float,
        tables: Any,
        grounds: Any,
        costs: Any,
        seen: Any,
    ) -> int:
        """Write plants to rows `index` (P,) of stacks; return how many before one was unsound.

        Parameters
        ----------
        index, numbers, storeys
            (P,) rows, (P, 13) numbers of actuators and valves, and (P, 3, n) masses, stiffnesses and
            dampings.
        parts
            Stiffness ratio of yielding storeys, or -1; whether the valve is of second order.
        lag
            Low-passes: (f, 2) what each is fed by, (f,) rates [rad/s] and (f,) sizes of the signals.
        ground
            Angular frequency and damping ratio of the ground filter.
        filters
            Rows of the target and matrices of the ground filter, and of the one without a high-pass.
        dt
            [s]
        tables
            Stacks ``advance``, ``slope``, ``C``, ``D``, ``valve``.
        grounds
            Stacks ``noise`` and ``record``.
        costs
            Whether covariances (P, e, e) and shears (P, e) are written, of which the cost of a force is
            made; and those.
        seen
            (P, n, 2 n or 3 n) maps of the floors and (P, w + 4 + 2 n) scales of the states, written.
        """
        target, filtered, plain_target, plain = filters
        ratio, second_order = parts
        advance, slopes, outputs, through, valve = tables
        w, n = len(target), storeys.shape[2]
        own, sizes = np.empty(w + 2 * n), np.empty(2 * n)
        for p in range(len(index) if number else 0):
            row, each, of = index[p], numbers[p], storeys[p]
            floors, seen_rows = _chain(of[0], of[1], of[2], ratio), _outputs(target, of)
            A = _exogenous(_chain(of[0], of[1], _damped(of), -1.0), plain_target, plain)
            driven = np.zeros(2 + 2 * n)
            driven[1] = 1.0
            # Each function by one call in a loop, which then is compiled once.
            for turn in range(2 if costs[0] else 1):
                spread = np.empty(A.shape)
                stationary_covariance(A, driven, spread)
                if turn == 0:
                    scale = _scale(each, of, w, ground[0], ground[1], spread)
                    for i in range(len(scale)):
                        if not 0.0 < scale[i] < math.inf:
                            return p
                        seen[1][p, i] = scale[i]
                        if not w <= i < w + 4:
                            own[i if i < w else i - 4] = scale[i]
                    whole = _exogenous(floors, target, filtered)
                    A, driven = _scaled(whole, own)
                else:
                    _put(spread, 0, costs[1][p], 0)
                    for j in range(len(own)):
                        costs[2][p, j] = seen_rows[1, j] * own[j]
            _put(floors, 0, seen[0][p], 0)
            for turn in range(3):
                if turn == 0:
                    a, b, C, D = _table(each, of, floors, ratio, second_order, lag[0], lag[1])
                    frequency = each[NATURAL_FREQUENCY]
                    size = _table_scale(scale[w:], floors.shape[1], lag[2], second_order, frequency)
                    if not second_order:
                        valve[row, 0] = a[SPOOL_POSITION, SPOOL_POSITION]
                        valve[row, 1] = b[SPOOL_POSITION, 0]
                    valve[row, 2] = each[MISSING]
                elif turn == 1:
                    a, b, size = _generator(A, driven), np.empty((2 * len(A), 0)), np.ones(2 * len(A))
                else:
                    a, b, size = _part(whole, w, w), np.zeros((2 * n, 1)), sizes
                    for i in range(2 * n):
                        b[i, 0], size[i] = -1.0 if i >= n else 0.0, own[w + i]
                moved, level, slope = hold(a, b, size, dt)
                if turn == 0:
                    _put(moved, 0, advance[row], 0)
                    _put(level, 0, advance[row], len(a))
                    _put(slope, 1, slopes[row], 0)
                    _put(C, 0, outputs[row], 0)
                    _put(D, 1, through[row], 0)
                elif turn == 1:
                    if not noise_map(moved, own, seen_rows, grounds[0][row]):
                        return p
                else:
                    for i in range(2 * n):
                        level[i, 0] -= slope[i, 0]
                    period(moved, level, slope, _part(seen_rows, 1, w), grounds[1][row])
        return len(index)

    low_passes, both = types.Tuple([int64[:, ::1], flat, flat]), types.Tuple([flat, rows, flat, rows])
    tables, seen = types.Tuple([stack, stack, stack, stack, rows]), types.Tuple([stack, rows])
    parts, costs = types.Tuple([float64, boolean]), types.Tuple([boolean, stack, rows])
    given = (int64[::1], rows, stack, parts, low_passes, flat, both, float64, tables)
    return cached(int64(*given, types.Tuple([stack, stack]), costs, seen), put_plants)


put_plants = _made()


@lru_cache
def holds_of_stacks() -> Any:
    """Return what writes `hold` of stacks, which yielding storeys alone need."""
    number = stamp()

    def holds(
        a: FloatArray,
        b: FloatArray,
        scale: FloatArray,
        dt: float,
        moved: FloatArray,
        level: FloatArray,
        slope: FloatArray,
    ) -> int:
        """Write `hold` of stacks (P, n, n), (P, n, inputs) and (P, n)."""
        for p in range(len(a) if number else 0):
            made = hold(a[p], b[p], scale[p], dt)
            _put(made[0], 0, moved[p], 0)
            _put(made[1], 0, level[p], 0)
            _put(made[2], 0, slope[p], 0)
        return 0

    return cached(int64(stack, stack, rows, float64, stack, stack, stack), holds)
