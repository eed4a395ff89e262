"""Arithmetic of the compiled kernels, over the lanes of a block: nonlinear parts, products, one period.

A row for each state and the lanes along it, so that every line of arithmetic runs over the lanes of a
block in vector registers. The array-API kernel is the reference (:mod:`shake_env.dynamics.nonlinear`),
and a test holds these equal to it. Matrices are (columns, rows, 1 or lanes): common to the lanes, or one
a lane.
"""

from __future__ import annotations

import math
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numba import carray, njit, types
from numba.core.typing import signature
from numba.extending import intrinsic
from numba.np.arrayobj import make_array
from numpy.typing import NDArray

from shake_env.model.nonlinearity import Nonlinearity
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import LOAD_PRESSURE, SPOOL_POSITION, TABLE_DISPLACEMENT, TABLE_VELOCITY

IntArray = NDArray[np.int64]

BLOCK = 64  # lanes: the rows of a block, half a kilobyte each, stay in the first-level cache

# Places in the vector of scalars; infinite is off.
(
    EXCESS, STRIBECK_VELOCITY, SMOOTHING_VELOCITY, VISCOUS, RATED_PRESSURE, SUPPLY_SAG, SPOOL_LIMIT,
    DEAD_BAND, RATE_LIMIT, GAP, STIFFNESS, DAMPING, YIELD_DRIFT, EXPONENT,
) = range(14)  # fmt: skip
# Places in the vector of switches: where each part's first column of g lies, -1 if the part is off and
# its columns left out of every product; then what else shapes the loops.
FLOW, FORCE, RATE, SLIPS, COLUMNS, FRICTION, STATIC, SPOOL_VELOCITY, STORIES = range(9)

# fastmath stays off and nothing is contracted: a lane's sums are the same in a vector register as alone,
# so that no result depends on the batch.
jit = njit(error_model="numpy", nogil=True)
# Part of its caller, which may know the number of lanes: loops over one lane then fall away.
inlined = njit(error_model="numpy", nogil=True, forceinline=True)
SOURCES = (
    "kernels/lanes", "kernels/table", "kernels/table_adjoint", "kernels/period_adjoint", "model/plant",
)  # fmt: skip


def stamp() -> int:
    """Return a number that changes with the sources of the compiled functions.

    numba looks only at the file of the function itself to tell whether what it keeps on disk is out of
    date. A closure over this number makes the sources of what it calls part of the question.
    """
    folder = Path(__file__).parents[1]
    content = b"".join((folder / f"{name}.py").read_bytes() for name in SOURCES)
    return 1 + zlib.crc32(content)


def scalars(parts: Nonlinearity) -> FloatArray:
    """Return the values of the parts in SI, in the order of :data:`EXCESS` and its followers."""
    friction, valve, stops, yielding = parts.friction, parts.valve, parts.stops, parts.yielding
    excess = 0.0 if friction.static is None else friction.static - friction.coulomb
    return np.array(
        [
            excess, friction.stribeck_velocity, friction.smoothing_velocity, friction.viscous,
            valve.rated, valve.supply_sag, valve.spool_limit, valve.dead_band, valve.spool_rate_limit,
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


@intrinsic
def _address(_context: Any, array: Any, start: Any) -> Any:
    """Return where the numbers of an array from `start` on lie."""

    def generate(context: Any, builder: Any, signed: Any, arguments: Any) -> Any:
        first = make_array(signed.args[0])(context, builder, arguments[0]).data
        return builder.gep(first, [arguments[1]])

    return signature(types.CPointer(array.dtype), array, types.int64), generate


@jit
def view(array: FloatArray, start: int, shape: tuple[int, ...]) -> FloatArray:
    """Return a part of a contiguous array in another shape; the array must hold it, and outlive it.

    Slices and reshape() have their references counted, which costs a lone table more than its
    arithmetic.
    """
    part: FloatArray = carray(_address(array, start), shape)
    return part


@jit
def expm1(x: float) -> float:
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


@jit
def tanh(x: float) -> float:
    """Return tanh(x) to a few units in the last place."""
    p = expm1(-2.0 * abs(x))
    return math.copysign(-p / (p + 2.0), x)


@jit
def within(x: float, limit: float) -> float:
    """Return x between -limit and limit."""
    # As comparisons, and not min and max, so that a NaN stays one.
    return limit if x > limit else (-limit if x < -limit else x)


@jit
def _flow(
    spool: FloatArray, pressure: FloatArray, v: FloatArray, missing: FloatArray, out: FloatArray, w: int
) -> None:
    limit, dead, rated, sag = v[SPOOL_LIMIT], v[DEAD_BAND], v[RATED_PRESSURE], v[SUPPLY_SAG]
    for n in range(w):
        limited = within(spool[n], limit)
        past = abs(limited) - dead
        opening = math.copysign(0.0 if past < 0.0 else past, limited)
        short = missing[n] + abs(opening) * sag
        available = 1.0 - ((pressure[n] if opening > 0.0 else -pressure[n]) + short) / rated
        out[n] = opening * math.sqrt(1e-6 if available < 1e-6 else available) - spool[n]


@jit
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
            force[n] += excess * (1.0 + expm1(-(ratio * ratio)))
    for n in range(w):
        force[n] = -(force[n] * tanh(velocity[n] / smoothing) + viscous * velocity[n])


@jit
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


@jit
def slip_rates(x: FloatArray, v: FloatArray, stories: int, slips: FloatArray, w: int) -> None:
    """Write the slip rates (stories, w) of states whose first four rows are the table's."""
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
            size = 1.0 if size > 1.0 else size
            power = size
            if whole:
                for _ in range(int(exponent) - 1):
                    power *= size
            else:
                power = size**exponent
            slips[storey, n] = rate * (1.0 if rate * z > 0.0 else 0.0) * power


@jit
def fill(y: FloatArray, value: float, w: int) -> None:
    """Set the first w entries of each row of y."""
    for i in range(len(y)):
        for n in range(w):
            y[i, n] = value


@jit
def nonlinear(
    x: FloatArray,
    current: FloatArray,
    v: FloatArray,
    s: IntArray,
    coulomb: FloatArray,
    valve: FloatArray,
    g: FloatArray,
    w: int,
) -> None:
    """Write g, (columns, w), for states x, (order, w); see `NonlinearDynamics.nonlinear`."""
    if s[FLOW] >= 0:
        _flow(x[SPOOL_POSITION], x[LOAD_PRESSURE], v, valve[2], g[s[FLOW]], w)
    if s[FORCE] >= 0:
        fill(g[s[FORCE] : s[FORCE] + 1], 0.0, w)
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
                rate[n] = valve[0, n] * x[SPOOL_POSITION, n] + valve[1, n] * current[n]
        for n in range(w):
            rate[n] = within(rate[n], limit) - rate[n]
    if s[SLIPS] >= 0:
        slip_rates(x, v, s[STORIES], g[s[SLIPS] :], w)


@jit
def add_product(matrix: FloatArray, x: FloatArray, y: FloatArray, w: int) -> None:
    """Add matrix (columns, rows, 1 or lanes) times x (columns, w) to y (rows, w).

    Four columns a pass, so that a sum is loaded and stored a quarter as often, and of a common matrix
    two rows, so that x is loaded half as often. A lone table's rows take the place of the lanes. Sums
    run in the same order throughout.
    """
    columns, rows = matrix.shape[0], matrix.shape[1]
    if y.shape[1] == 1:
        flat, out = view(matrix, 0, (columns, rows)), view(y, 0, (rows,))
        for j in range(columns):
            row, value = flat[j], x[j, 0]
            for i in range(rows):
                out[i] = out[i] + row[i] * value
        return
    quads = columns - columns % 4
    if matrix.shape[2] == 1:
        for i in range(0, rows - 1, 2):
            _add_two_rows(matrix, x, y, i, quads, w)
        for i in range(rows - rows % 2, rows):
            _add_row(matrix, x, y[i], i, quads, w)
        return
    for i in range(rows):
        out = y[i]
        for j in range(0, quads, 4):
            for n in range(w):
                out[n] = (
                    out[n]
                    + matrix[j, i, n] * x[j, n]
                    + matrix[j + 1, i, n] * x[j + 1, n]
                    + matrix[j + 2, i, n] * x[j + 2, n]
                    + matrix[j + 3, i, n] * x[j + 3, n]
                )
        for j in range(quads, columns):
            for n in range(w):
                out[n] = out[n] + matrix[j, i, n] * x[j, n]


@jit
def _add_row(matrix: FloatArray, x: FloatArray, out: FloatArray, i: int, quads: int, w: int) -> None:
    """Add row i of a common matrix times x."""
    for j in range(0, quads, 4):
        a, b, c, d = matrix[j, i, 0], matrix[j + 1, i, 0], matrix[j + 2, i, 0], matrix[j + 3, i, 0]
        for n in range(w):
            out[n] = out[n] + a * x[j, n] + b * x[j + 1, n] + c * x[j + 2, n] + d * x[j + 3, n]
    for j in range(quads, matrix.shape[0]):
        a = matrix[j, i, 0]
        for n in range(w):
            out[n] = out[n] + a * x[j, n]


@jit
def _add_two_rows(matrix: FloatArray, x: FloatArray, y: FloatArray, i: int, quads: int, w: int) -> None:
    """Add rows i and i + 1 of a common matrix times x."""
    out, below, k = y[i], y[i + 1], i + 1
    for j in range(0, quads, 4):
        a, b, c, d = matrix[j, i, 0], matrix[j + 1, i, 0], matrix[j + 2, i, 0], matrix[j + 3, i, 0]
        e, f, g, h = matrix[j, k, 0], matrix[j + 1, k, 0], matrix[j + 2, k, 0], matrix[j + 3, k, 0]
        for n in range(w):
            p, q, r, s = x[j, n], x[j + 1, n], x[j + 2, n], x[j + 3, n]
            out[n] = out[n] + a * p + b * q + c * r + d * s
            below[n] = below[n] + e * p + f * q + g * r + h * s
    for j in range(quads, matrix.shape[0]):
        a, e = matrix[j, i, 0], matrix[j, k, 0]
        for n in range(w):
            out[n] = out[n] + a * x[j, n]
            below[n] = below[n] + e * x[j, n]


@inlined
def follow(
    x: FloatArray,
    y: FloatArray,
    later: FloatArray,
    sampled: FloatArray,
    arriving: FloatArray,
    transition: FloatArray,
    change: FloatArray,
    outputs: FloatArray,
    v: FloatArray,
    s: IntArray,
    friction: FloatArray,
    rate: FloatArray,
    response: FloatArray,
    w: int,
) -> None:
    """Advance a block by one control period; see `NonlinearDynamics.control_step`.

    Parameters
    ----------
    x
        (order + 1 + columns of g, w): the states, moved in place; then room for current and g.
    y, later, seen
        (order, w), (columns of g, w) and (2, w): room.
    arriving
        (k, w) current [A] that acts in each physics step.
    transition, change, outputs
        (columns, rows, 1 or lanes): of ``[x, current, g]``, of the change of g, of the outputs.
    v, s, friction, rate
        As for `nonlinear`.
    response
        (2 k, w): y_A after each physics step, then f_s.
    """
    order, inputs, substeps = y.shape[0], s[COLUMNS], arriving.shape[0]
    current, g = x[order], x[order + 1 :]
    for j in range(substeps + 1):
        # The outputs see of g the force only, which does not depend on the current: what is computed
        # for them also begins the next step.
        for n in range(w):
            current[n] = arriving[min(j, substeps - 1), n]
        nonlinear(x, current, v, s, friction, rate, g, w)
        if j > 0:
            fill(sampled, 0.0, w)
            add_product(outputs, x, sampled, w)
            for n in range(w):
                response[j - 1, n] = sampled[0, n]
                response[substeps + j - 1, n] = sampled[1, n]
        if j == substeps:
            break
        fill(y, 0.0, w)
        add_product(transition, x, y, w)
        nonlinear(y, current, v, s, friction, rate, later, w)
        for i in range(inputs):
            for n in range(w):
                later[i, n] -= g[i, n]
        add_product(change, later, y, w)
        for n in range(w):
            y[SPOOL_POSITION, n] = within(y[SPOOL_POSITION, n], v[SPOOL_LIMIT])
        for i in range(order):
            for n in range(w):
                x[i, n] = y[i, n]
