"""Matrices of structures: diagonal, of a chain of storeys, and any that stores energy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shake_env.errors import ParameterError

FloatArray = NDArray[np.float64]


def diagonal(values: ArrayLike) -> FloatArray:
    """Return the diagonal matrix (..., n, n) of values (..., n)."""
    entries = np.asarray(values, dtype=float)
    matrix = np.zeros((*entries.shape, entries.shape[-1]))
    place = np.arange(entries.shape[-1])
    matrix[..., place, place] = entries
    return matrix


def chain_matrix(storeys: ArrayLike) -> FloatArray:
    """Return the tridiagonal matrix (..., n, n) of a chain of storeys fixed at its lower end.

    Parameters
    ----------
    storeys
        (..., n) stiffness or damping of the link below each floor.
    """
    link = np.asarray(storeys, dtype=float)
    matrix = diagonal(link)
    below = np.arange(link.shape[-1] - 1)
    matrix[..., below, below] += link[..., 1:]
    matrix[..., below, below + 1] = matrix[..., below + 1, below] = -link[..., 1:]
    return matrix


def symmetric_rows(field: str, values: Any, stories: int) -> tuple[tuple[float, ...], ...]:
    """Return a matrix as tuples; it must be symmetric, of `stories` rows, and not negative definite."""
    try:
        matrix = np.array(values, dtype=float)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.shape != (stories, stories) or not np.isfinite(matrix).all():
        raise ParameterError(field, values, f"must be {stories} rows of {stories} finite numbers")
    size = np.max(np.abs(matrix), initial=0.0)
    if not np.allclose(matrix, matrix.T, rtol=0.0, atol=1e-9 * size):
        raise ParameterError(field, values, "must be symmetric")
    lowest = float(np.linalg.eigvalsh(matrix)[0])
    if lowest < -1e-12 * size or (field != "coupled_dampings" and lowest <= 0.0):
        raise ParameterError(field, values, f"has the eigenvalue {lowest:.3g}: it stores no energy")
    return tuple(tuple(float(value) for value in row) for row in matrix)
