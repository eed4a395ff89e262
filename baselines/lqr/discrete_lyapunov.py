"""Solution of a discrete Lyapunov equation with two sides (Stein's equation)."""

from __future__ import annotations

import numpy as np

from shake_env.errors import NumericalError
from shake_env.model.parameters import FloatArray

DOUBLINGS = 64  # of a Stein sum: more than any stable pole of float64 needs


def discrete_lyapunov(left: FloatArray, middle: FloatArray, right: FloatArray) -> FloatArray:
    """Return the solution of ``X = left X right + middle``, which is ``sum_j left^j middle right^j``.

    By doubling (Smith, SIAM J. Appl. Math. 16, 1968): no matrix is inverted, and terms are only added.

    Raises
    ------
    NumericalError
        If the sum does not settle.
    """
    total = middle
    for _ in range(DOUBLINGS):
        added = left @ total @ right
        total = total + added
        size = np.max(np.abs(total), initial=0.0)
        if np.max(np.abs(added), initial=0.0) <= 1e-17 * size:
            return total
        if not np.isfinite(size):
            break
        left, right = left @ left, right @ right
    raise NumericalError(
        "Stein sum", float(np.max(np.abs(total))), "does not settle: a factor is unstable"
    )
