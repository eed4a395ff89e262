"""H-infinity norm of a stable discrete-time system, by bisection on a symplectic pencil.

A level gamma above ``sigma_max(D)`` is a singular value of ``G(e^(j theta)) = C (e^(j theta) I - A)^-1 B
+ D`` exactly where ``e^(j theta)`` is an eigenvalue of a symplectic pencil (Bruinsma and Steinbuch,
Systems and Control Letters 14, 1990; discrete time as in Zhou, Doyle and Glover, Robust and Optimal
Control, 1996, section 21.3). Between the angles that the pencil gives, the gain exceeds gamma: the
largest gain at the middle of each stretch is the next lower bound, and convergence is quadratic.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigvals

from shake_env.errors import NumericalError
from shake_env.model.parameters import FloatArray

TOLERANCE = 1e-10  # relative, of the norm
ON_THE_CIRCLE = 1e-7  # distance of an eigenvalue's modulus from 1; a double one is off by sqrt(epsilon)
STEPS = 60


def discrete_h_infinity_norm(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> float:
    """Return the largest gain over all frequencies of ``x+ = A x + B u, y = C x + D u``.

    Parameters
    ----------
    A, B, C, D
        (n, n), (n, m), (p, n), (p, m), in units that scale the states alike.

    Raises
    ------
    NumericalError
        If a pole lies on or outside the unit circle, or the bisection does not end.
    """
    poles = np.linalg.eigvals(A)
    radius = float(np.max(np.abs(poles), initial=0.0))
    if not radius < 1.0:
        raise NumericalError("pole radius", radius, "must be below 1: only a stable system has a norm")
    grid = np.concatenate([np.linspace(0.0, np.pi, 65), np.abs(np.angle(poles))])
    low = max(_gain(A, B, C, D, angle) for angle in grid)
    if low == 0.0:
        return 0.0
    for _ in range(STEPS):
        level = low * (1.0 + TOLERANCE)
        angles = _crossings(A, B, C, D, level)
        if len(angles) == 0:
            return low
        ends = np.concatenate([angles, [angles[0] + 2.0 * np.pi]])
        highest = max(_gain(A, B, C, D, angle) for angle in 0.5 * (ends[1:] + ends[:-1]))
        if highest <= level:  # the stretches are as narrow as rounding lets them be
            return max(low, highest)
        low = highest
    raise NumericalError("H-infinity norm", low, f"not found in {STEPS} steps")


def _gain(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, angle: float) -> float:
    response = C @ np.linalg.solve(np.exp(1j * angle) * np.eye(len(A)) - A, B) + D
    return float(np.linalg.norm(response, 2))


def _crossings(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, level: float) -> FloatArray:
    """Return the angles (k,) in rising order at which a singular value of G equals `level`."""
    n = len(A)
    R = level**2 * np.eye(B.shape[1]) - D.T @ D
    if not np.linalg.eigvalsh(R)[0] > 0.0:  # the feed-through alone reaches the level
        return np.array([0.0])
    A_R = A + B @ np.linalg.solve(R, D.T @ C)
    weight = C.T @ (C + D @ np.linalg.solve(R, D.T @ C))
    after = np.block([[np.eye(n), -B @ np.linalg.solve(R, B.T)], [np.zeros((n, n)), A_R.T]])
    before = np.block([[A_R, np.zeros((n, n))], [-weight, np.eye(n)]])
    values = eigvals(before, after)
    values = values[np.isfinite(values)]
    on_circle = values[np.abs(np.abs(values) - 1.0) < ON_THE_CIRCLE]
    angles: FloatArray = np.sort(np.angle(on_circle))
    return angles
