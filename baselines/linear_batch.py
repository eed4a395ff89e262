"""A discrete linear model under many inputs at once, in blocks of samples: what a closed loop does.

A closed loop under a linear law is linear, so that a thousand earthquakes are a few matrix products:
states are followed from block to block only, and all outputs of a block come from its inputs and the
state at its start in one product. Python is called once a block, and the states between are never made.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from shake_env.discretization import DiscreteStateSpace
from shake_env.errors import ParameterError
from shake_env.parameters import FloatArray

BLOCK = 10  # samples; about where the arithmetic saved by shorter blocks meets the cost of their calls


def respond(
    system: DiscreteStateSpace, inputs: FloatArray, initial: FloatArray | None = None, block: int = BLOCK
) -> FloatArray:
    """Return the outputs (samples, outputs, N) of N runs.

    Parameters
    ----------
    system
        ``x[j+1] = A x[j] + B u[j]``, ``y[j] = C x[j] + D u[j]``; a batch of plants is refused.
    inputs
        (samples, inputs, N) u; runs lie innermost.
    initial
        (n, N) states at the start; None: at rest.
    block
        Samples taken at once.

    Raises
    ------
    ParameterError
        If shapes do not fit, or the block is no whole number of at least 1.
    """
    return np.concatenate([part.copy() for part in _blocks(system, inputs, initial, block)])


def mean_squares(
    system: DiscreteStateSpace, inputs: FloatArray, initial: FloatArray | None = None, block: int = BLOCK
) -> FloatArray:
    """Return the mean square of each output over the samples, (outputs, N); as for `respond`.

    The outputs themselves, a hundred megabytes for a thousand earthquakes, are never kept.
    """
    total = np.zeros((system.C.shape[-2], inputs.shape[-1]))
    for part in _blocks(system, inputs, initial, block):
        np.multiply(part, part, out=part)
        total += part.sum(axis=0)
    return total / len(inputs)


def _blocks(
    system: DiscreteStateSpace, inputs: FloatArray, initial: FloatArray | None, block: int
) -> Iterator[FloatArray]:
    """Yield the outputs (block, outputs, N) in turn, valid until the next."""
    n, m, p = system.order, system.B.shape[-1], system.C.shape[-2]
    if system.A.ndim != 2:
        raise ParameterError("system", system.A.shape, "must be one model, not a batch")
    if inputs.ndim != 3 or inputs.shape[1] != m:
        raise ParameterError("inputs shape", inputs.shape, f"must be (samples, {m}, N)")
    if block < 1:
        raise ParameterError("block", block, "must be at least 1 sample")
    samples, _, runs = inputs.shape
    x = np.zeros((n, runs)) if initial is None else np.asarray(initial, dtype=float)
    if x.shape != (n, runs):
        raise ParameterError("initial shape", x.shape, f"must be ({n}, {runs})")
    # Rows: the outputs of each sample in turn, then the state at the end; columns: state, then inputs.
    running, rows = np.eye(n, n + block * m), []
    for j in range(block):
        row = system.C @ running
        row[:, n + j * m : n + (j + 1) * m] += system.D
        rows.append(row)
        running = system.A @ running
        running[:, n + j * m : n + (j + 1) * m] += system.B
    step = np.concatenate([*rows, running])
    given = inputs.reshape(samples * m, runs)
    joined, moved = np.empty((n + block * m, runs)), np.empty((block * p + n, runs))
    joined[:n] = x
    for start in range(0, samples, block):
        part = min(block, samples - start)
        # The last block may be short: what its missing inputs would reach is not handed out.
        joined[n : n + part * m] = given[start * m : (start + part) * m]
        joined[n + part * m :] = 0.0
        np.matmul(step, joined, out=moved)
        joined[:n] = moved[block * p :]
        yield moved[: part * p].reshape(part, p, runs)
