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
def make_tape(model: ModelArrays) -> Tape:
    """Return room for one period of a table."""
    advance, arrival, s = model[0], model[6], model[8]
    order, substeps = advance.shape[0], arrival.shape[0]
    tall = order + 1 + s[COLUMNS]
    return (
        np.zeros((substeps + 1, tall, 1)),
        np.zeros((substeps, order, 1)),
        np.zeros(substeps),
        np.zeros(substeps),
    )


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
        See `ModelArrays`, and `make_tape`.
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
def gradient_of_g(
    x: FloatArray,
    current: float,
    model: ModelArrays,
    wide: FloatArray,
    scalars: FloatArray,
    seed: FloatArray,
    gradient: FloatArray,
    along_current: FloatArray,
) -> None:
    """Write dg/dx transposed, (order, columns), and dg/du, (columns), of one table.

    `wide` (order, columns), `scalars` (5, columns) and `seed`, the unit matrix, are room: each column of
    g takes the place of a table in `pull`.
    """
    coulomb, rate, v, s = model[5], model[4], model[7], model[8]
    order, inputs = gradient.shape
    for n in range(inputs):
        scalars[0, n] = current
        scalars[1, n] = coulomb[0]
        scalars[2, n] = rate[0, 0]
        scalars[3, n] = rate[1, 0]
        scalars[4, n] = rate[2, 0]
        along_current[n] = 0.0
    for i in range(order):
        for n in range(inputs):
            wide[i, n] = x[i, 0]
            gradient[i, n] = 0.0
    pull(
        wide, scalars[0], v, s, scalars[1], scalars[2:], seed, gradient, along_current, inputs
    )  # fmt: skip


@jit
def add_along(
    gradient: FloatArray,
    along_current: FloatArray,
    dx: FloatArray,
    dcurrent: FloatArray,
    sign: float,
    dg: FloatArray,
) -> None:
    """Add ``sign (dg/dx dx + dg/du du)`` to dg, (columns, directions)."""
    order, inputs = gradient.shape
    directions = dx.shape[1]
    for n in range(inputs):
        for i in range(order):
            value = sign * gradient[i, n]
            if value != 0.0:
                for c in range(directions):
                    dg[n, c] += value * dx[i, c]
        if along_current[n] != 0.0:
            value = sign * along_current[n]
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
    gradient, wide = np.zeros((order, inputs)), np.zeros((order, inputs))
    along, scalars, seed = np.zeros(inputs), np.zeros((5, inputs)), np.eye(inputs)
    for i in range(order):
        dx[i, i] = scale[i]
    for j in range(substeps + 1):
        x = taped[j]
        for i in range(commands):
            dcurrent[order + i] = arrival[min(j, substeps - 1), i] * scale[order + i]
        dcurrent[n] = arrival[min(j, substeps - 1), commands]
        if inputs > 0:
            now = arriving[min(j, substeps - 1)]
            gradient_of_g(x, now, model, wide, scalars, seed, gradient, along)
            for i in range(inputs):
                for c in range(directions):
                    dg[i, c] = 0.0
            add_along(gradient, along, dx, dcurrent, 1.0, dg)
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
            gradient_of_g(predicted[j], arriving[j], model, wide, scalars, seed, gradient, along)
            for i in range(inputs):
                for c in range(directions):
                    change[i, c] = -dg[i, c]
            add_along(gradient, along, dp, dcurrent, 1.0, change)
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
