"""Structures that are no chain of storeys: from mass and stiffness matrices or measured modes.

``M x_r'' + C x_r' + K x_r = -M 1 y_A``: floors move in the table's direction, relative to it. The base
shear is the sum of the inertia forces, ``f_s = 1'K x_r + 1'C x_r'``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy  # loads scipy.linalg on first use, which takes a third of a second
from numpy.typing import ArrayLike

from shake_env.errors import ParameterError
from shake_env.model.parameters import FloatArray, Specimen, replace_unchecked

COUPLING = 0.2  # largest share of one measured shape in another, in the masses' measure
_RESIDUAL = 3.0  # frequency of the modes that were not measured, over the highest that was


def specimen_from_matrices(
    mass: ArrayLike,
    stiffness: ArrayLike,
    damping: ArrayLike | None = None,
    *,
    damping_ratio: float | Sequence[float] | None = None,
    rayleigh: Sequence[tuple[float, float]] | None = None,
) -> Specimen:
    """Return the structure of given matrices; say its damping in one of three ways.

    Parameters
    ----------
    mass, stiffness, damping
        M, K and C, (floors, floors) [kg, N/m, N s/m]; M and C may be the diagonal, (floors,).
    damping_ratio
        Of every mode, or of each (floors,), by rising frequency [-].
    rayleigh
        Two pairs of frequency [Hz] and damping ratio [-]: ``C = a M + b K`` has these ratios there.

    Raises
    ------
    ParameterError
        If a matrix is not symmetric or stores no energy, a floor weighs nothing, or the damping is given
        twice or not at all.
    """
    M, K = _matrix(mass), _matrix(stiffness)
    if M.shape != K.shape or M.ndim != 2 or M.shape[0] != M.shape[1]:
        raise ParameterError("mass, stiffness", (M.shape, K.shape), "must be square and of one size")
    given = [value is not None for value in (damping, damping_ratio, rayleigh)]
    if sum(given) != 1:
        raise ParameterError("damping", given, "give one of damping, damping_ratio and rayleigh")
    omega, shapes = _modes(M, K)
    if damping is not None:
        C = _matrix(damping)
    elif damping_ratio is not None:
        C = _modal_matrix(M, shapes, 2.0 * np.broadcast_to(damping_ratio, omega.shape) * omega)
    else:
        (f_1, zeta_1), (f_2, zeta_2) = rayleigh or ()
        rows = np.array([[1.0 / (2.0 * w), w / 2.0] for w in 2.0 * np.pi * np.array([f_1, f_2])])
        if f_1 == f_2:
            raise ParameterError("rayleigh", rayleigh, "needs two different frequencies")
        a, b = np.linalg.solve(rows, [zeta_1, zeta_2])
        C = a * M + b * K
    return _coupled(M, K, C)


def specimen_from_modes(
    masses: ArrayLike,
    frequencies: ArrayLike,
    damping_ratios: ArrayLike,
    shapes: ArrayLike,
) -> Specimen:
    """Return a structure with measured modes.

    Parameters
    ----------
    masses
        (floors,) lumped at the floors where the shapes were measured [kg].
    frequencies, damping_ratios
        (modes,) [Hz, -], rising.
    shapes
        (floors, modes) of any size and sign.

    Notes
    -----
    Measured shapes are never quite orthogonal in the masses' measure: the nearest ones that are take
    their place (Lowdin). What as many modes as there are floors would have left is made stiff: modes of
    three times the highest measured frequency, with its damping ratio.

    Raises
    ------
    ParameterError
        If the sizes do not fit, a value is not above zero, or two shapes are far from orthogonal.
    """
    m, f = np.asarray(masses, dtype=float), np.asarray(frequencies, dtype=float)
    zeta, phi = np.asarray(damping_ratios, dtype=float), np.asarray(shapes, dtype=float)
    if m.ndim != 1 or f.ndim != 1 or phi.shape != (len(m), len(f)) or zeta.shape != f.shape:
        sizes = (m.shape, f.shape, zeta.shape, phi.shape)
        raise ParameterError("masses, frequencies, damping_ratios, shapes", sizes, "do not fit together")
    if not (len(f) and np.all(m > 0.0) and np.all(f > 0.0) and np.all(zeta >= 0.0)):
        raise ParameterError("masses, frequencies", (m, f), "must be above 0, damping ratios not below")
    root = np.sqrt(m)[:, None]
    unit = root * phi / np.linalg.norm(root * phi, axis=0)
    if not np.isfinite(unit).all():
        raise ParameterError("shapes", shapes, "must be finite, and none of them zero")
    overlap = np.abs(unit.T @ unit - np.eye(len(f)))
    if np.max(overlap) > COUPLING:
        raise ParameterError(
            "shapes",
            float(np.max(overlap)),
            f"is the share of one in another with these masses: at most {COUPLING}; check their order",
        )
    left, _, right = np.linalg.svd(unit)
    measured = left[:, : len(f)] @ right
    whole = np.hstack([measured, left[:, len(f) :]])
    rest = len(m) - len(f)
    omega = 2.0 * np.pi * np.append(f, np.full(rest, _RESIDUAL * f.max()))
    ratio = np.append(zeta, np.full(rest, zeta[np.argmax(f)]))
    K = (root * whole * omega**2) @ (root * whole).T
    C = (root * whole * 2.0 * ratio * omega) @ (root * whole).T
    return _coupled(np.diag(m), K, C)


def damped_specimen(specimen: Specimen) -> Specimen:
    """Return a specimen of which every storey, or every mode of a coupled one, has 1 % of damping."""
    if not specimen.coupled:
        critical = 2.0 * np.sqrt(np.multiply(specimen.masses, specimen.stiffnesses))
        return replace_unchecked(specimen, dampings=np.maximum(specimen.dampings, 0.01 * critical))
    M, C = specimen.mass_matrix, specimen.damping_matrix
    squares, shapes = scipy.linalg.eigh(specimen.stiffness_matrix, M)
    missing = 0.02 * np.sqrt(squares) - np.einsum("im,ij,jm->m", shapes, C, shapes)
    weighed = M @ shapes
    return replace_unchecked(
        specimen, coupled_dampings=C + (weighed * np.maximum(missing, 0.0)) @ weighed.T
    )


def _matrix(values: ArrayLike) -> FloatArray:
    try:
        matrix = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise ParameterError("matrix", values, "must be rows of numbers, all of one length") from None
    matrix = np.diag(matrix) if matrix.ndim == 1 else matrix
    if not matrix.size or not np.isfinite(matrix).all():
        raise ParameterError("matrix", values, "must be finite, and of one floor at least")
    return matrix


def _modes(M: FloatArray, K: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return frequencies (floors,) [rad/s] and mass-normalised shapes (floors, floors)."""
    try:
        squares, shapes = scipy.linalg.eigh(K, M)
    except np.linalg.LinAlgError as error:
        raise ParameterError("mass", M, f"is not positive definite: {error}") from None
    if not squares[0] > 0.0:
        raise ParameterError("stiffness", K, "lets the structure move without a force: hold its base")
    return np.sqrt(squares), shapes


def _modal_matrix(M: FloatArray, shapes: FloatArray, values: FloatArray) -> FloatArray:
    weighed = M @ shapes
    matrix: FloatArray = (weighed * values) @ weighed.T
    return matrix


def _coupled(M: FloatArray, K: FloatArray, C: FloatArray) -> Specimen:
    """Return the structure, with the storeys of a similar shear building.

    Their stiffness is the force above over the drift, under the floors' own weight turned sideways;
    their damping that stiffness times the first mode's ``2 zeta / omega``.
    """
    M, K, C = (0.5 * (matrix + matrix.T) if _square(matrix) else matrix for matrix in (M, K, C))
    omega, shapes = _modes(M, K)
    masses = M.sum(axis=1)
    if not np.all(masses > 0.0):
        raise ParameterError("mass", masses, "leaves a floor that weighs nothing: its row's sum")
    carried = np.cumsum(masses[::-1])[::-1]
    drift = np.abs(np.diff(np.linalg.solve(K, masses), prepend=0.0))
    stiffnesses = carried / np.maximum(drift, 1e-3 * drift.max())
    per_stiffness = max(float(shapes[:, 0] @ C @ shapes[:, 0]), 0.0) / omega[0] ** 2
    lumped = np.allclose(M, np.diag(masses), rtol=0.0, atol=1e-12 * masses.max())

    def rows(matrix: FloatArray) -> tuple[tuple[float, ...], ...]:
        return tuple(tuple(float(value) for value in row) for row in matrix)

    return Specimen(
        masses=tuple(masses.tolist()),
        stiffnesses=tuple(stiffnesses.tolist()),
        dampings=tuple((per_stiffness * stiffnesses).tolist()),
        coupled_masses=None if lumped else rows(M),
        coupled_stiffnesses=rows(K),
        coupled_dampings=rows(C),
    )


def _square(matrix: FloatArray) -> bool:
    """Whether a matrix may be made symmetric to the last bit: it is so to rounding."""
    size = np.max(np.abs(matrix))
    return matrix.shape[0] == matrix.shape[1] and np.allclose(matrix, matrix.T, rtol=0, atol=1e-9 * size)
