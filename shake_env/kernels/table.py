"""The update of :mod:`shake_env.dynamics.nonlinear`, compiled by numba: same equations, same results.

Lanes are stepped in blocks through a whole control period (:mod:`shake_env.kernels.lanes`). Imported on
first use only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import float64, int64, njit, types

from shake_env.kernels.lanes import (
    BLOCK,
    COLUMNS,
    SLIPS,
    IntArray,
    follow,
    jit,
    scalars,
    stamp,
    switches,
)
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.model.parameters import FloatArray


@jit
def gather(
    source: FloatArray, first: int, count: int, s: IntArray, plain: int, target: FloatArray, start: int
) -> None:
    """Copy matrices (lanes, rows, columns) from lane `first` on, transposed, to columns from `start` on.

    After `plain` columns come those of g, of which parts that are off are left out.
    """
    for n in range(count):
        for i in range(source.shape[1]):
            for j in range(plain):
                target[start + j, i, n] = source[first + n, i, j]
            at = start + plain
            for j in range(source.shape[2] - plain):
                if s[min(j, SLIPS)] >= 0:
                    target[at, i, n] = source[first + n, i, plain + j]
                    at += 1


def given(dimensions: int) -> types.Array:
    """Return the type of an array that is only read, of any layout."""
    return types.Array(float64, dimensions, "A", readonly=True)


RANKS = (2, 1, 3, 3, 3, 3, 2, 1, 3)  # of state to arrival, in one period
OF_PERIODS = (2, 2, *RANKS[2:])  # the same, with a command for each period and table
_made = float64[:, :, ::1]


def _cached(number: int) -> Any:
    """Return the update of N tables over some periods as numba keeps it, for sources of this `stamp`."""

    # A signature of its own, so that this compiles once, for arrays of any layout.
    @njit(
        int64(*map(given, OF_PERIODS), float64[::1], int64[::1], _made, _made, _made),
        cache=True,
        error_model="numpy",
        nogil=True,
    )
    def step_tables(
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
        moved: FloatArray,
        acceleration: FloatArray,
        shear: FloatArray,
    ) -> int:
        lanes, order, inputs = len(state), advance.shape[1], s[COLUMNS]
        substeps, commands = arrival.shape[1], arrival.shape[2] - 1
        own = len(advance) > 1
        width = min(BLOCK, lanes)
        depth = width + 8 if own else 1  # a stride off the powers of two, which share few cache lines
        transition = np.empty((order + 1 + inputs, order, depth))
        change = np.empty((inputs, order, depth))
        outputs = np.zeros((order + 1 + inputs, 2, depth))
        x = np.empty((order + 1 + inputs, width))  # state, current, g
        y, later, sampled = np.empty((order, width)), np.empty((inputs, width)), np.empty((2, width))
        response = np.empty((2 * substeps, width))
        arriving, friction, rate = np.empty((substeps, width)), np.empty(width), np.empty((3, width))
        queue = np.empty((commands + 1, width))  # commands under way, oldest first, and the period's own
        none = lanes - lanes  # a zero that is no literal: for one the helpers would be compiled again
        for first in range(0, lanes, width):
            w = min(width, lanes - first)
            if own or first == 0:
                count = w if own else 1
                gather(advance, first, count, s, order + 1, transition, none)
                gather(slope, first, count, s, none, change, none)
                gather(C, first, count, s, order, outputs, none)
                gather(D, first, count, s, none, outputs, order + 1)
            for n in range(w):
                lane = first + n
                for i in range(order):
                    x[i, n] = state[lane, i]
                friction[n] = coulomb[lane if len(coulomb) > 1 else 0]
                for i in range(3):
                    rate[i, n] = valve[lane if len(valve) > 1 else 0, i]
                for i in range(commands):
                    queue[i, n] = state[lane, order + i]
            for t in range(len(command)):
                for n in range(w):
                    lane = first + n
                    queue[commands, n] = command[t, lane]
                    picks = arrival[lane if len(arrival) > 1 else 0]
                    for j in range(substeps):
                        arriving[j, n] = picks[j, commands] * queue[commands, n]
                        for i in range(commands):
                            arriving[j, n] += picks[j, i] * queue[i, n]
                follow(
                    x, y, later, sampled, arriving, transition, change, outputs, v, s, friction, rate,
                    response, w,
                )  # fmt: skip
                for n in range(w):
                    lane = first + n
                    for i in range(order):
                        moved[t, lane, i] = x[i, n]
                    for j in range(substeps):
                        acceleration[t, lane, j] = response[j, n]
                        shear[t, lane, j] = response[substeps + j, n]
                    for i in range(commands):
                        queue[i, n] = queue[i + 1, n]
                        moved[t, lane, order + i] = queue[i, n]
        return number

    return step_tables


_step = _cached(stamp())


@dataclass(frozen=True)
class CompiledStep:
    """The matrices of a `NonlinearDynamics` as the compiled update takes them.

    They are views: what is written into the stacks of a fleet is seen.
    """

    advance: FloatArray  # (1 or N, m, m + 1 + inputs), and so on as in NonlinearDynamics
    slope: FloatArray
    C: FloatArray
    D: FloatArray
    valve: FloatArray  # (1 or N, 3)
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
        ranks = {"advance": 2, "slope": 2, "C": 2, "D": 2, "valve": 1, "coulomb": 0, "arrival": 2}
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
        moved, acceleration, shear = self.periods(
            state.reshape(-1, state.shape[-1]), current.reshape(1, -1)
        )
        steps = (*state.shape[:-1], acceleration.shape[-1])
        return moved.reshape(state.shape), acceleration.reshape(steps), shear.reshape(steps)

    def periods(
        self, state: FloatArray, current: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the states (P, N, ...), y_A (P, N, k) and f_s (P, N, k) of P periods in one call.

        Parameters
        ----------
        state
            (N, m + commands) at the start.
        current
            (P, N) command of each period [A].
        """
        (lanes, states), substeps, number = state.shape, self.arrival.shape[1], len(current)
        moved = np.empty((number, lanes, states))
        acceleration, shear = np.empty((2, number, lanes, substeps))
        _step(
            state, current, self.advance, self.slope, self.C, self.D, self.valve,
            self.coulomb, self.arrival, self.values, self.on, moved, acceleration, shear,
        )  # fmt: skip
        return moved, acceleration, shear
