"""A discrete linear model under many inputs at once, in blocks of samples: what a closed loop does.

A closed loop under a linear law is linear, so that a thousand earthquakes are a few matrix products:
states are followed from block to block only, and all outputs of a block come from its inputs and the
state at its start in one product. Python is called once a block, and the states between are never made.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from shake_env.errors import ParameterError
from shake_env.model.discretization import DiscreteStateSpace
from shake_env.model.parameters import FloatArray

BLOCKS = range(8, 13)  # samples; where the arithmetic that short blocks save meets what calls cost
REGISTER = 8  # rows that matrix libraries take at once: a product of 40 rows costs less than one of 37


def forced_response(
    system: DiscreteStateSpace,
    inputs: FloatArray,
    initial: FloatArray | None = None,
    block: int | None = None,
) -> FloatArray:
    """Return the outputs (samples, outputs, N) of N forced runs of linear models, side by side.

    Parameters
    ----------
    system
        ``x[j+1] = A x[j] + B u[j]``, ``y[j] = C x[j] + D u[j]``; a batch of plants is refused.
    inputs
        (samples, inputs, N) u; runs lie innermost.
    initial
        (n, N) states at the start; None: at rest.
    block
        Samples taken at once; None: what makes products of a convenient size.

    Raises
    ------
    ParameterError
        If shapes do not fit, or the block is no whole number of at least 1.
    """
    return np.concatenate([part.copy() for part in _blocks(system, inputs, initial, block)])


def mean_squares(
    system: DiscreteStateSpace,
    inputs: FloatArray,
    initial: FloatArray | None = None,
    block: int | None = None,
) -> FloatArray:
    """Return the mean square of each output over the samples, (outputs, N); as for `forced_response`.

    The outputs themselves, a hundred megabytes for a thousand earthquakes, are never kept.
    """
    total = np.zeros((system.C.shape[-2], inputs.shape[-1]))
    for part in _blocks(system, inputs, initial, block):
        total += np.einsum("jin,jin->in", part, part)
    return total / len(inputs)


def _felt(system: DiscreteStateSpace) -> NDArray[np.bool_]:
    """Return which states (n,) reach an output, by themselves or through others.

    The place of a table that nothing asks for its place does not, under any law that ignores it.
    """
    felt: NDArray[np.bool_] = np.any(system.C != 0.0, axis=0)
    for _ in range(system.order):
        felt = felt | np.any(system.A[felt] != 0.0, axis=0)
    return felt


def _convenient(states: int, outputs: int) -> int:
    """Return the samples of a block whose rows leave least of a register's last round idle."""
    return min(BLOCKS, key=lambda block: (-(states + block * outputs) % REGISTER, block))


def _blocks(
    system: DiscreteStateSpace, inputs: FloatArray, initial: FloatArray | None, block: int | None
) -> Iterator[FloatArray]:
    """Yield the outputs (block, outputs, N) in turn, valid until the next."""
    n, m, p = system.order, system.B.shape[-1], system.C.shape[-2]
    if system.A.ndim != 2:
        raise ParameterError("system", system.A.shape, "must be one model, not a batch")
    if inputs.ndim != 3 or inputs.shape[1] != m:
        raise ParameterError("inputs shape", inputs.shape, f"must be (samples, {m}, N)")
    if block is not None and block < 1:
        raise ParameterError("block", block, "must be at least 1 sample")
    samples, _, runs = inputs.shape
    x = np.zeros((n, runs)) if initial is None else np.asarray(initial, dtype=float)
    if x.shape != (n, runs):
        raise ParameterError("initial shape", x.shape, f"must be ({n}, {runs})")
    felt = _felt(system)
    A, B, C, x = system.A[np.ix_(felt, felt)], system.B[felt], system.C[:, felt], x[felt]
    n, block = len(A), block or _convenient(len(A), p)
    # Rows: the outputs of each sample in turn, then the state at the end; columns: state, then inputs.
    running, rows = np.eye(n, n + block * m), []
    for j in range(block):
        row = C @ running
        row[:, n + j * m : n + (j + 1) * m] += system.D
        rows.append(row)
        running = A @ running
        running[:, n + j * m : n + (j + 1) * m] += B
    step = np.concatenate([*rows, running])
    given = inputs.reshape(samples * m, runs)
    # Two in turn, of outputs, state and inputs: the state that a product leaves is where the next one
    # begins to read.
    now, later = np.zeros((2, block * p + n + block * m, runs))
    begin, end = block * p, block * p + n
    now[begin:end] = x
    for start in range(0, samples, block):
        part = min(block, samples - start)
        # The last block may be short: what its missing inputs would reach is not handed out.
        now[end : end + part * m] = given[start * m : (start + part) * m]
        now[end + part * m :] = 0.0
        np.matmul(step, now[begin:], out=later[:end])
        now, later = later, now
        yield now[: part * p].reshape(part, p, runs)
