"""One control period of one table with its Jacobian, compiled, for planning and estimation.

The update is that of :mod:`shake_env.dynamics.nonlinear`, differentiated forwards along every state and
the command (Griewank and Walther, Evaluating Derivatives, 2008, ch. 3): with one current, one forward
sweep costs less than a reverse sweep for every output. The nonlinear parts and their slopes are those of
the compiled step and its adjoint. A test holds the Jacobian equal to the adjoint. Imported on first use
only.
"""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import TypeAlias

import numpy as np

from shake_env.kernels.lanes import COLUMNS as COLUMNS
from shake_env.kernels.lanes import SPOOL_LIMIT, IntArray, jit, nonlinear, within
from shake_env.kernels.lanes import scalars as scalars
from shake_env.kernels.lanes import stamp as kernel_stamp
from shake_env.kernels.lanes import switches as switches
from shake_env.kernels.table_adjoint import pull
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import SPOOL_POSITION

# advance, slope, C, D, valve, coulomb, arrival of one table (of N with an axis
# ahead), then values and switches, common
ModelArrays: TypeAlias = tuple[
    FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray,
    IntArray,
]  # fmt: skip
# taped, predicted, spool, arriving: what a period leaves for its Jacobian
Tape: TypeAlias = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
Tapes: TypeAlias = Tape  # the same with an axis of periods ahead


def stamp(*modules: str) -> int:
    """Return a number that changes with the sources of compiled modules; see `lanes.stamp`."""
    content = b"".join((Path(__file__).parent / f"{name}.py").read_bytes() for name in modules)
    return kernel_stamp() + zlib.crc32(content)


@jit
def table_model(models: ModelArrays, table: int) -> ModelArrays:
    """Return the model of one of N tables."""
    advance, slope, C, D, rate, coulomb, arrival, v, s = models
    return (
        advance[table], slope[table], C[table], D[table], rate[table], coulomb[table], arrival[table],
        v, s,
    )  # fmt: skip


@jit
def make_tapes(model: ModelArrays, periods: int) -> Tapes:
    """Return room for periods of a table, along the first axis."""
    advance, arrival, s = model[0], model[6], model[8]
    order, substeps = advance.shape[0], arrival.shape[0]
    tall = order + 1 + s[COLUMNS]
    return (
        np.zeros((periods, substeps + 1, tall, 1)),
        np.zeros((periods, substeps, order, 1)),
        np.zeros((periods, substeps)),
        np.zeros((periods, substeps)),
    )


@jit
def tape_of(tapes: Tapes, t: int) -> Tape:
    """Return the room of one period."""
    return tapes[0][t], tapes[1][t], tapes[2][t], tapes[3][t]


@jit
def period(
    x: FloatArray, u: float, model: ModelArrays, tape: Tape, moved: FloatArray, response: FloatArray
) -> None:
    """Advance one table by one control period.

    Parameters
    ----------
    x
        (m + commands) SI: the state, then the commands under way [A], oldest first.
    u
        Command [A].
    model, tape
        See `ModelArrays`, and `tape_of`.
    moved, response
        (m + commands) and (2 k), written: the state a period on; y_A after each physics step, then f_s.
    """
    advance, slope, C, D, rate, coulomb, arrival, v, s = model
    taped, predicted, spool, arriving = tape
    order, inputs, substeps = advance.shape[0], s[COLUMNS], arrival.shape[0]
    commands = arrival.shape[1] - 1
    later = np.empty((inputs, 1))
    for j in range(substeps):
        arriving[j] = arrival[j, commands] * u
        for i in range(commands):
            arriving[j] += arrival[j, i] * x[order + i]
    for i in range(order):
        taped[0, i, 0] = x[i]
    for j in range(substeps + 1):
        row = taped[j]
        current, g = row[order], row[order + 1 :]
        current[0] = arriving[min(j, substeps - 1)]
        if inputs > 0:
            nonlinear(row, current, v, s, coulomb, rate, g, 1)
        if j > 0:
            for o in range(2):
                total = 0.0
                for i in range(order):
                    total += C[o, i] * row[i, 0]
                for i in range(inputs):
                    total += D[o, i] * g[i, 0]
                response[o * substeps + j - 1] = total
        if j == substeps:
            break
        y, following = predicted[j], taped[j + 1]
        for i in range(order):
            total = 0.0
            for n in range(order + 1 + inputs):
                total += advance[i, n] * row[n, 0]
            y[i, 0] = total
            following[i, 0] = total
        if inputs > 0:
            nonlinear(y, current, v, s, coulomb, rate, later, 1)
            for n in range(inputs):
                later[n, 0] -= g[n, 0]
            for i in range(order):
                for n in range(inputs):
                    following[i, 0] += slope[i, n] * later[n, 0]
        spool[j] = following[SPOOL_POSITION, 0]
        following[SPOOL_POSITION, 0] = within(following[SPOOL_POSITION, 0], v[SPOOL_LIMIT])
    for i in range(order):
        moved[i] = taped[substeps, i, 0]
    for i in range(commands):
        moved[order + i] = x[order + i + 1] if i + 1 < commands else u


@jit
def gradients_of_g(
    states: FloatArray, currents: FloatArray, model: ModelArrays
) -> tuple[FloatArray, FloatArray]:
    """Return what g is along the state and the current, of one table in several states.

    Parameters
    ----------
    states, currents
        (order, points) and (points) [A].

    Returns
    -------
    along_state, along_current
        (order, points columns) and (points columns): dg/dx transposed and dg/du, a point's columns of g
        side by side.
    """
    coulomb, rate, v, s = model[5], model[4], model[7], model[8]
    order, inputs = states.shape[0], s[COLUMNS]
    lanes = states.shape[1] * inputs  # a point's column of g takes the place of a table in `pull`
    wide, scalars, seed = np.empty((order, lanes)), np.empty((5, lanes)), np.zeros((inputs, lanes))
    along_state, along_current = np.zeros((order, lanes)), np.zeros(lanes)
    for lane in range(lanes):
        point = lane // inputs
        for i in range(order):
            wide[i, lane] = states[i, point]
        scalars[0, lane] = currents[point]
        scalars[1, lane] = coulomb[0]
        for i in range(3):
            scalars[2 + i, lane] = rate[i, 0]
        seed[lane - point * inputs, lane] = 1.0
    pull(wide, scalars[0], v, s, scalars[1], scalars[2:], seed, along_state, along_current, lanes)
    return along_state, along_current


@jit
def add_along(
    gradient: FloatArray,
    along_current: FloatArray,
    point: int,
    dx: FloatArray,
    dcurrent: FloatArray,
    dg: FloatArray,
) -> None:
    """Add ``dg/dx dx + dg/du du`` of a point of `gradients_of_g` to dg, (columns, directions)."""
    inputs, directions = dg.shape
    first = point * inputs
    for n in range(inputs):
        for i in range(len(gradient)):
            value = gradient[i, first + n]
            if value != 0.0:
                for c in range(directions):
                    dg[n, c] += value * dx[i, c]
        value = along_current[first + n]
        if value != 0.0:
            for c in range(directions):
                dg[n, c] += value * dcurrent[c]


@jit
def period_jacobian(
    model: ModelArrays,
    tape: Tape,
    scale: FloatArray,
    A: FloatArray,
    B: FloatArray,
    C_x: FloatArray,
    D_u: FloatArray,
) -> None:
    """Write the Jacobian of the period that `tape` holds.

    Parameters
    ----------
    scale
        (n,) size of each of the n = m + commands states.
    A, B
        (n, n) and (n): scaled state a period on along the scaled state, and along the command [1/A].
    C_x, D_u
        (2 k, n) and (2 k): y_A and f_s [m/s^2, N] along the scaled state and the command [A].
    """
    advance, slope, C, D, _, _, arrival, v, s = model
    taped, predicted, spool, arriving = tape
    order, inputs, substeps = advance.shape[0], s[COLUMNS], arrival.shape[0]
    commands = arrival.shape[1] - 1
    n, directions = order + commands, order + commands + 1
    dx, dp = np.zeros((order, directions)), np.zeros((order, directions))
    dg, change = np.zeros((inputs, directions)), np.zeros((inputs, directions))
    dcurrent = np.zeros(directions)
    points = 2 * substeps + 1 if inputs > 0 else 0  # the states, then the predicted ones
    states, currents = np.empty((order, points)), np.empty(points)
    for j in range(points):
        at = j if j <= substeps else j - substeps - 1
        currents[j] = arriving[min(at, substeps - 1)]
        for i in range(order):
            states[i, j] = taped[at, i, 0] if j <= substeps else predicted[at, i, 0]
    gradient, along = gradients_of_g(states, currents, model)
    for i in range(order):
        dx[i, i] = scale[i]
    for j in range(substeps + 1):
        for i in range(commands):
            dcurrent[order + i] = arrival[min(j, substeps - 1), i] * scale[order + i]
        dcurrent[n] = arrival[min(j, substeps - 1), commands]
        if inputs > 0:
            for i in range(inputs):
                for c in range(directions):
                    dg[i, c] = 0.0
            add_along(gradient, along, j, dx, dcurrent, dg)
        if j > 0:
            for o in range(2):
                at = o * substeps + j - 1
                for c in range(n):
                    C_x[at, c] = 0.0
                D_u[at] = 0.0
                for i in range(order):
                    value = C[o, i]
                    if value != 0.0:
                        for c in range(n):
                            C_x[at, c] += value * dx[i, c]
                        D_u[at] += value * dx[i, n]
                for i in range(inputs):
                    value = D[o, i]
                    if value != 0.0:
                        for c in range(n):
                            C_x[at, c] += value * dg[i, c]
                        D_u[at] += value * dg[i, n]
        if j == substeps:
            break
        for i in range(order):
            value = advance[i, order]
            for c in range(directions):
                dp[i, c] = value * dcurrent[c]
            for b in range(order):
                value = advance[i, b]
                for c in range(directions):
                    dp[i, c] += value * dx[b, c]
            for b in range(inputs):
                value = advance[i, order + 1 + b]
                for c in range(directions):
                    dp[i, c] += value * dg[b, c]
        if inputs > 0:
            for i in range(inputs):
                for c in range(directions):
                    change[i, c] = -dg[i, c]
            add_along(gradient, along, substeps + 1 + j, dp, dcurrent, change)
        for i in range(order):
            for c in range(directions):
                dx[i, c] = dp[i, c]
            for b in range(inputs):
                value = slope[i, b]
                for c in range(directions):
                    dx[i, c] += value * change[b, c]
        if abs(spool[j]) > v[SPOOL_LIMIT]:
            for c in range(directions):
                dx[SPOOL_POSITION, c] = 0.0
    for i in range(order):
        for c in range(n):
            A[i, c] = dx[i, c] / scale[i]
        B[i] = dx[i, n] / scale[i]
    for i in range(commands):
        for c in range(n):
            A[order + i, c] = 0.0
        B[order + i] = 0.0
        if i + 1 < commands:
            A[order + i, order + i + 1] = scale[order + i + 1] / scale[order + i]
        else:
            B[order + i] = 1.0 / scale[order + i]
