"""Balanced truncation of a stable continuous model, its Hankel singular values and error bound.

The square-root method (Tombs and Postlethwaite, Int. J. Control 46, 1987; Laub et al., IEEE TAC 32,
1987): the Gramians are never formed. Hammarling's method gives their factors directly, and the
singular values of the product of the two factors are the Hankel singular values. The closed loops of
this project have poles from 1e-6 to 2e5 rad/s; a Gramian would have to hold the squares of numbers
that span as much, and its Cholesky factorisation fails.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matrix_balance, schur, solve_triangular
from scipy.optimize import minimize_scalar

from shake_env.errors import NumericalError, ParameterError
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import StateSpace

ComplexArray = NDArray[np.complex128]
Match = Literal["high", "low"]

GRID_PER_DECADE = 40  # frequencies before peaks are refined
REFINED_PEAKS = 12  # largest local maxima of the grid that are refined


@dataclass(frozen=True)
class Balancing:
    """Both ways into the coordinates in which every state is as reachable as it is observable."""

    hankel_singular_values: FloatArray  # (n,) falling
    left: FloatArray  # (n, n): balanced state = left.T @ x
    right: FloatArray  # (n, n): x = right @ balanced state


@dataclass(frozen=True)
class Reduction:
    """A reduced model with what is known about its error before any frequency is looked at."""

    system: StateSpace  # of the order asked for, in balanced coordinates
    hankel_singular_values: FloatArray  # (n,) of the full model, falling
    error_bound: float  # 2 * (sum of those left out): at least the H-infinity norm of the error


def gramian_factor(A: FloatArray, B: FloatArray) -> FloatArray:
    """Return L, (n, n), with ``A L L' + L L' A' + B B' = 0``, for a stable A, by Hammarling's method.

    Column by column on the complex Schur form (Hammarling, IMA J. Numer. Anal. 2, 1982). What is left
    of B after each column has as many columns as before, because the equation's rest is again a square.

    Raises
    ------
    NumericalError
        If A is not stable.
    """
    T, U = schur(A.astype(complex), output="complex")
    slowest = float(np.max(np.diag(T).real))
    if not slowest < 0.0:
        raise NumericalError("pole", slowest, "Gramians need a stable model")
    n = len(A)
    b = U.conj().T @ B.astype(complex)
    R = np.zeros((n, n), dtype=complex)
    for j in range(n - 1, -1, -1):
        size = float(np.linalg.norm(b[j]))
        if size == 0.0:
            continue  # this mode is not excited, and its column of the factor is zero
        R[j, j] = rho = size / np.sqrt(-2.0 * T[j, j].real)
        if j:
            shifted = T[:j, :j] + np.conj(T[j, j]) * np.eye(j)
            r = solve_triangular(shifted, -(b[:j] @ b[j].conj() / rho + T[:j, j] * rho))
            R[:j, j] = r
            b[:j] -= np.outer(r, b[j]) / rho
    factor = U @ R
    # The Gramian is real: the real and imaginary parts of a complex factor side by side are a real one.
    _, upper = np.linalg.qr(np.hstack([factor.real, factor.imag]).T)
    result: FloatArray = upper.T
    return result


def balancing_transformation(system: StateSpace) -> Balancing:
    """Return the balancing transformation of a stable model.

    Notes
    -----
    Directions whose Hankel singular value is zero to the last bit have no balanced coordinates; their
    columns of `left` and `right` are zero.

    Raises
    ------
    NumericalError
        If the model is not stable.
    """
    # Powers of two that even out rows and columns: no rounding, and smaller errors in the Schur form.
    A, (scale, _) = matrix_balance(system.A, permute=False, separate=1)
    reach = gramian_factor(A, system.B / scale[:, None])
    observe = gramian_factor(A.T, (system.C * scale).T)
    U, sigma, Vt = np.linalg.svd(observe.T @ reach)
    root = np.zeros_like(sigma)
    present = sigma > np.finfo(float).tiny
    root[present] = 1.0 / np.sqrt(sigma[present])
    left = observe @ U * root / scale[:, None]
    right = reach @ Vt.T * root * scale[:, None]
    return Balancing(sigma, left, right)


def hankel_singular_values(system: StateSpace) -> FloatArray:
    """Return the Hankel singular values of a stable model, (n,) falling, in output over input."""
    return balancing_transformation(system).hankel_singular_values


def order_within(values: FloatArray, bound: float) -> int:
    """Return the least reduced order whose bound ``2 * sum(values[order:])`` is at most `bound`."""
    tails = 2.0 * np.append(np.cumsum(values[::-1])[::-1], 0.0)
    return max(1, int(np.argmax(tails <= bound)))


def balanced_truncation(system: StateSpace, order: int, match: Match = "high") -> Reduction:
    """Return a stable model of `order` states nearest to `system` in the balanced sense.

    Parameters
    ----------
    system
        Stable model with n states.
    order
        1 to n; n gives the model itself in balanced coordinates.
    match
        What is kept exactly: ``"high"`` cuts the weak states off and keeps the response at infinite
        frequency; ``"low"`` lets them settle at once (their derivative is set to zero) and keeps the
        response at frequency zero. Both share the bound (Liu and Anderson, Int. J. Control 50, 1989).

    Raises
    ------
    ParameterError
        If `order` is outside its range.
    NumericalError
        If `system` is not stable, or has fewer than `order` states that input and output see.
    """
    n = system.order
    if not 1 <= order <= n:
        raise ParameterError("order", order, f"must lie in 1 to {n}")
    balanced = balancing_transformation(system)
    sigma = balanced.hankel_singular_values
    if sigma[order - 1] <= np.finfo(float).tiny:
        raise NumericalError("Hankel singular value", float(sigma[order - 1]), "leaves no such order")
    # The weakest states of a model that is not minimal cannot be told from rounding: their balanced
    # coordinates would only add noise, so that letting them settle means dropping them.
    retained = order if match == "high" else max(order, int(np.sum(sigma > 1e-14 * sigma[0])))
    left, right = balanced.left[:, :retained], balanced.right[:, :retained]
    A, B, C = left.T @ system.A @ right, left.T @ system.B, system.C @ right
    if match == "high" or retained == order:
        reduced = StateSpace(A, B, C, system.D)
    else:
        s, f = slice(0, order), slice(order, retained)
        settle = -np.linalg.solve(A[f, f], np.hstack([A[f, s], B[f]]))
        to_state, to_input = settle[:, :order], settle[:, order:]
        reduced = StateSpace(
            A[s, s] + A[s, f] @ to_state,
            B[s] + A[s, f] @ to_input,
            C[:, s] + C[:, f] @ to_state,
            system.D + C[:, f] @ to_input,
        )
    return Reduction(reduced, sigma, 2.0 * float(np.sum(sigma[order:])))


def gain_curve(system: StateSpace, omega: FloatArray, other: StateSpace | None = None) -> FloatArray:
    """Return the largest singular value of G, or of the difference of two models, at `omega` [rad/s].

    Returns
    -------
    (frequencies,) in units of output over input.
    """
    response = _response(system, omega)
    if other is not None:
        response = response - _response(other, omega)
    gain: FloatArray = np.linalg.norm(response, ord=2, axis=(1, 2))
    return gain


def h_infinity_norm(system: StateSpace, other: StateSpace | None = None) -> tuple[float, float]:
    """Return the largest gain over all frequencies, of G or of a difference, and where [rad/s].

    A sweep from a thousandth of the slowest pole to a thousand times the fastest, with points at every
    pole's frequency and beside it, then a bounded search around the largest local maxima. The value is
    a gain that the model has, so that it never exceeds the true norm.
    """
    models = [m for m in (system, other) if m is not None]
    poles = np.concatenate([np.linalg.eigvals(matrix_balance(m.A, permute=False)[0]) for m in models])
    size = np.abs(poles)
    low, high = 1e-3 * float(np.min(size)), 1e3 * float(np.max(size))
    points = 2 + int(GRID_PER_DECADE * np.log10(high / low))
    beside = np.abs(poles.imag)[:, None] + np.abs(poles.real)[:, None] * np.array([-1.0, 0.0, 1.0])
    near = np.concatenate([size, beside[beside > low]])
    omega = np.unique(np.concatenate([np.geomspace(low, high, points), near]))
    gain = gain_curve(system, omega, other)
    padded = np.concatenate([[-1.0], gain, [-1.0]])
    peaks = np.flatnonzero((gain >= padded[:-2]) & (gain >= padded[2:]))
    best, where = float(np.max(gain)), float(omega[np.argmax(gain)])
    for i in peaks[np.argsort(gain[peaks])[::-1][:REFINED_PEAKS]]:
        ends = np.log(omega[[max(i - 1, 0), min(i + 1, len(omega) - 1)]])
        peak = minimize_scalar(
            lambda x: -float(gain_curve(system, np.exp([x]), other)[0]), bounds=ends, method="bounded"
        )
        if -peak.fun > best:
            best, where = float(-peak.fun), float(np.exp(peak.x))
    return best, where


def _response(system: StateSpace, omega: FloatArray) -> ComplexArray:
    # Evened out, because steady coordinates mix poles of 1e-6 and 2e5 rad/s; in blocks for memory.
    A, (scale, _) = matrix_balance(system.A, permute=False, separate=1)
    even = StateSpace(A, system.B / scale[:, None], system.C * scale, system.D)
    parts = np.array_split(omega, 1 + len(omega) // 256)
    response: ComplexArray = np.concatenate([even.frequency_response(part) for part in parts])
    return response
