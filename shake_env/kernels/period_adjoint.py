"""The slope of a control period of the table, by a reverse sweep over its physics steps.

The adjoint of the update of :mod:`shake_env.dynamics.nonlinear` (Griewank and Walther, Evaluating
Derivatives, 2008, ch. 3), compiled. A period is run again from its start before it is swept back: that
costs less than keeping every physics step of a window in memory, and whoever differentiates keeps states
and currents only. Imported on first use only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import float64, int64, njit

from shake_env.kernels.lanes import (
    BLOCK,
    COLUMNS,
    SPOOL_LIMIT,
    IntArray,
    add_product,
    fill,
    jit,
    nonlinear,
    stamp,
    within,
)
from shake_env.kernels.table import RANKS, CompiledStep, gather, given
from shake_env.kernels.table_adjoint import pull
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import SPOOL_POSITION


@jit
def _transposed(matrix: FloatArray, target: FloatArray) -> None:
    """Write a matrix (columns, rows, depth) to (rows, columns, depth)."""
    for j in range(matrix.shape[0]):
        for i in range(matrix.shape[1]):
            for n in range(matrix.shape[2]):
                target[i, j, n] = matrix[j, i, n]


@jit
def _record(
    taped: FloatArray,
    predicted: FloatArray,
    spool: FloatArray,
    later: FloatArray,
    arriving: FloatArray,
    transition: FloatArray,
    change: FloatArray,
    v: FloatArray,
    s: IntArray,
    friction: FloatArray,
    rate: FloatArray,
    w: int,
) -> None:
    """Run a period as :func:`shake_env.kernels.lanes.follow` does, and keep what the sweep needs.

    Parameters
    ----------
    taped
        (k + 1, order + 1 + columns of g, w): state, current and g at each step's start; the first state
        is given.
    predicted, spool
        (k, order, w) and (k, w): states before the change of g, and spool positions before their limit.
    """
    substeps, order, inputs = predicted.shape[0], predicted.shape[1], s[COLUMNS]
    for j in range(substeps + 1):
        x = taped[j]
        current, g = x[order], x[order + 1 :]
        for n in range(w):
            current[n] = arriving[min(j, substeps - 1), n]
        nonlinear(x, current, v, s, friction, rate, g, w)
        if j == substeps:
            break
        y, following = predicted[j], taped[j + 1]
        fill(y, 0.0, w)
        add_product(transition, x, y, w)
        nonlinear(y, current, v, s, friction, rate, later, w)
        for i in range(inputs):
            for n in range(w):
                later[i, n] -= g[i, n]
        for i in range(order):
            for n in range(w):
                following[i, n] = y[i, n]
        add_product(change, later, following[:order], w)
        for n in range(w):
            spool[j, n] = following[SPOOL_POSITION, n]
            following[SPOOL_POSITION, n] = within(following[SPOOL_POSITION, n], v[SPOOL_LIMIT])


@jit
def _sweep(
    taped: FloatArray,
    predicted: FloatArray,
    spool: FloatArray,
    xbar: FloatArray,
    gbar: FloatArray,
    cbar: FloatArray,
    hbar: FloatArray,
    sampled: FloatArray,
    back: FloatArray,
    change: FloatArray,
    outputs: FloatArray,
    v: FloatArray,
    s: IntArray,
    friction: FloatArray,
    rate: FloatArray,
    slopes: FloatArray,
    w: int,
) -> None:
    """Carry a cost's slopes from a period's end to its start.

    Parameters
    ----------
    taped, predicted, spool
        What `_record` kept.
    xbar
        (order + 1 + columns of g, w): slope along the state at the end, and in its place at the start;
        then room.
    gbar, hbar, seen
        (columns of g, w) and (2, w): room.
    cbar
        (k, w), written: slope along the current of each step.
    back, change, outputs
        (columns, rows, 1 or lanes): the transposed matrices of `follow`.
    slopes
        (2 k, w) along y_A after each step, then along f_s.
    """
    substeps, order, inputs = predicted.shape[0], predicted.shape[1], s[COLUMNS]
    limit = v[SPOOL_LIMIT]
    state, toward_g = xbar[:order], xbar[order + 1 :]
    fill(gbar, 0.0, w)
    fill(cbar, 0.0, w)
    for j in range(substeps - 1, -1, -1):
        # Outputs: y = C x + D g, after the step.
        for n in range(w):
            xbar[order, n] = 0.0
            sampled[0, n], sampled[1, n] = slopes[j, n], slopes[substeps + j, n]
        for i in range(inputs):
            for n in range(w):
                toward_g[i, n] = gbar[i, n]
        add_product(outputs, sampled, xbar, w)
        after, following = taped[j + 1], min(j + 1, substeps - 1)
        pull(after, after[order], v, s, friction, rate, toward_g, state, cbar[following], w)
        for n in range(w):
            state[SPOOL_POSITION, n] *= 1.0 if abs(spool[j, n]) <= limit else 0.0
        # The change of g over the step.
        fill(hbar, 0.0, w)
        add_product(change, state, hbar, w)
        now = taped[j][order]
        pull(predicted[j], now, v, s, friction, rate, hbar, state, cbar[j], w)
        # The prediction from [state, current, g].
        held = predicted[j]  # its last reader was the line above: room for the slope along it
        for i in range(order):
            for n in range(w):
                held[i, n] = state[i, n]
        fill(xbar, 0.0, w)
        add_product(back, held, xbar, w)
        for n in range(w):
            cbar[j, n] += xbar[order, n]
        for i in range(inputs):
            for n in range(w):
                gbar[i, n] = toward_g[i, n] - hbar[i, n]
    first = taped[0]
    pull(first, first[order], v, s, friction, rate, gbar, state, cbar[0], w)


_slope_ranks = (2, 2, 2)  # along the state, y_A and f_s
_made = float64[:, ::1]


def _cached(number: int) -> Any:
    """Return the sweep of N tables as numba keeps it on disk, for sources of this `stamp`."""

    @njit(
        int64(
            *map(given, RANKS), float64[::1], int64[::1], *map(given, _slope_ranks), _made, float64[::1]
        ),
        cache=True,
        error_model="numpy",
        nogil=True,
    )  # fmt: skip
    def sweep_tables(
        state: FloatArray,
        command: FloatArray,
        advance: FloatArray,
        slope: FloatArray,
        C: FloatArray,
        D: FloatArray,
        valve: FloatArray,
        coulomb: FloatArray,
        arrival: FloatArray,
        v: FloatArray,
        s: IntArray,
        state_slope: FloatArray,
        acceleration_slope: FloatArray,
        shear_slope: FloatArray,
        start_slope: FloatArray,
        command_slope: FloatArray,
    ) -> int:
        lanes, order, inputs = len(state), advance.shape[1], s[COLUMNS]
        substeps, commands = arrival.shape[1], arrival.shape[2] - 1
        own, tall = len(advance) > 1, order + 1 + inputs
        width = min(BLOCK, lanes)
        depth = width + 8 if own else 1
        transition, back = np.empty((tall, order, depth)), np.empty((order, tall, depth))
        change, unchange = np.empty((inputs, order, depth)), np.empty((order, inputs, depth))
        outputs, unseen = np.zeros((tall, 2, depth)), np.empty((2, tall, depth))
        taped, predicted = np.empty((substeps + 1, tall, width)), np.empty((substeps, order, width))
        spool, later = np.empty((substeps, width)), np.empty((inputs, width))
        arriving, friction, rate = np.empty((substeps, width)), np.empty(width), np.empty((3, width))
        xbar, gbar, cbar = (
            np.empty((tall, width)),
            np.empty((inputs, width)),
            np.empty((substeps, width)),
        )
        output_slopes, slopes = np.empty((2, width)), np.empty((2 * substeps, width))
        none = lanes - lanes  # a zero that is no literal: for one the helpers would be compiled again
        for first in range(0, lanes, width):
            w = min(width, lanes - first)
            if own or first == 0:
                count = w if own else 1
                gather(advance, first, count, s, order + 1, transition, none)
                gather(slope, first, count, s, none, change, none)
                gather(C, first, count, s, order, outputs, none)
                gather(D, first, count, s, none, outputs, order + 1)
                _transposed(transition, back)
                _transposed(change, unchange)
                _transposed(outputs, unseen)
            for n in range(w):
                lane = first + n
                for i in range(order):
                    taped[0, i, n], xbar[i, n] = state[lane, i], state_slope[lane, i]
                friction[n] = coulomb[lane if len(coulomb) > 1 else 0]
                for i in range(3):
                    rate[i, n] = valve[lane if len(valve) > 1 else 0, i]
                picks = arrival[lane if len(arrival) > 1 else 0]
                for j in range(substeps):
                    slopes[j, n] = acceleration_slope[lane, j]
                    slopes[substeps + j, n] = shear_slope[lane, j]
                    arriving[j, n] = picks[j, commands] * command[lane]
                    for i in range(commands):
                        arriving[j, n] += picks[j, i] * state[lane, order + i]
            _record(
                taped, predicted, spool, later, arriving, transition, change, v, s, friction, rate, w
            )
            _sweep(
                taped, predicted, spool, xbar, gbar, cbar, later, output_slopes, back, unchange,
                unseen, v, s, friction, rate, slopes, w,
            )  # fmt: skip
            for n in range(w):
                lane = first + n
                picks = arrival[lane if len(arrival) > 1 else 0]
                for i in range(order):
                    start_slope[lane, i] = xbar[i, n]
                # Of the queue [commands under way, command], the last ones are the next period's.
                for i in range(commands + 1):
                    along = state_slope[lane, order + i - 1] if i > 0 else 0.0
                    for j in range(substeps):
                        along += picks[j, i] * cbar[j, n]
                    if i < commands:
                        start_slope[lane, order + i] = along
                    else:
                        command_slope[lane] = along
        return number

    return sweep_tables


_back = _cached(stamp())


@dataclass(frozen=True)
class PeriodAdjoint:
    """A compiled control period and its slopes, for a batch (N,)."""

    step: CompiledStep

    def __call__(
        self,
        state: FloatArray,
        current: FloatArray,
        state_slope: FloatArray,
        acceleration_slope: FloatArray,
        shear_slope: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Return a cost's slopes along the state and current at a period's start.

        Parameters
        ----------
        state, current
            (N, m + commands) and (N,): what the period began with, as `CompiledStep` takes them.
        state_slope, acceleration_slope, shear_slope
            (N, m + commands), (N, k) and (N, k): slopes of the cost along what the period came to.

        Returns
        -------
        Slopes (N, m + commands) and (N,).
        """
        step = self.step
        start, command = np.empty(state.shape), np.empty(len(state))
        _back(
            state, current, step.advance, step.slope, step.C, step.D, step.valve, step.coulomb,
            step.arrival, step.values, step.on, state_slope, acceleration_slope, shear_slope, start,
            command,
        )  # fmt: skip
        return start, command
