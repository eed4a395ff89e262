"""Squared H2 norms of the tracking errors under white noise, by two independent methods.

From the white noise w of eq. 9 to ``y_A - y~`` (G~_1) and ``f_s - f~_s`` (G~_2), for a law
``u = -gain @ x`` (eqs. 16 to 18). `h2_lyapunov` works in the coordinates of
`baselines.lqr.continuous`; `h2_frequency` integrates the transfer functions of the plant's own scaled
states and shares neither the coordinates nor the equation solved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_lyapunov

from baselines.lqr.continuous import POSITION_TIME, SteadyCoordinates
from baselines.lqr.design_states import DesignStates
from shake_env.errors import NumericalError, ParameterError
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import CoupledPlant

ComplexArray = NDArray[np.complex128]

PANELS_PER_DECADE = 4
GAUSS_POINTS = 12  # per panel; 16 change no norm by more than 1e-9 of itself


@dataclass(frozen=True)
class TrackingNorms:
    """Squared H2 norms, which are the mean squares under unit-intensity filtered noise."""

    acceleration: float  # ||G~_1||^2 [(m/s^2)^2]
    base_shear: float  # ||G~_2||^2 [N^2]


def h2_lyapunov(plant: CoupledPlant, gain: FloatArray) -> TrackingNorms:
    """Return the closed loop's H2 norms from the controllability Gramian.

    Parameters
    ----------
    plant
        The coupled plant; ``equations`` chooses the corrected or the printed model.
    gain
        (n,) [A per SI unit of each state]. What the law ignores of a table that stands
        displaced is left out (`DesignStates`).

    Notes
    -----
    The methods agree to 1e-6 of a norm, and mostly to 1e-9, plus 5e-16 of the reference's mean square
    ``||f~_s||^2``. That last part is rounding of the model itself and no fault of a method: a force norm
    below 1e-10 of the reference loses digits, and one below 5e-16 (printed model, Table III, where
    f_s = f~_s at a table that stands still) is noise, of either sign here.

    Raises
    ------
    ParameterError
        If the gain has the wrong shape.
    NumericalError
        If the closed loop is not stable.
    """
    keep = _states(plant, gain).indices
    # The same unit of x_a as in the design, where the gain on it is sqrt(lambda) / r.
    stiffness = abs(float(gain[plant.layout.table_displacement]))
    xi = SteadyCoordinates.from_plant(plant, 1.0 / max(stiffness, 1.0 / POSITION_TIME))
    A = (xi.A - np.outer(xi.B[:, 0], xi.shifted_gain(gain)))[np.ix_(keep, keep)]
    slowest = float(np.max(np.linalg.eigvals(A).real))
    if not slowest < 0.0:
        raise NumericalError("closed-loop pole", slowest, "the closed loop is not stable")
    noise = xi.B[keep, 1:]
    gramian = solve_continuous_lyapunov(A, -noise @ noise.T)
    E = xi.E[:, keep]
    acceleration, shear = np.einsum("oi,ij,oj->o", E, gramian, E)
    return TrackingNorms(float(acceleration), float(shear))


def h2_frequency(plant: CoupledPlant, gain: FloatArray) -> TrackingNorms:
    """Return the closed loop's H2 norms as ``1/pi`` times the integral of ``|G(j omega)|^2``.

    Composite Gauss quadrature in log omega, with panels that end at every pole's frequency and at one,
    three and ten of its half-widths beside it, so that no resonance is stepped over. Below the lowest
    panel the response is taken as constant, above the highest as its first two terms in 1/omega^2, from
    the Markov parameters.

    Raises
    ------
    ParameterError
        If the gain has the wrong shape.
    NumericalError
        If the result is not finite.
    """
    A, b, E = _closed_loop(plant, gain)
    edges = _panel_edges(np.linalg.eigvals(A).astype(np.complex128))
    nodes, weights = _panels(edges)
    power = np.abs(_response(A, b, E, nodes)) ** 2  # (k, 2)
    below = power[0] * nodes[0]
    edge = float(np.exp(edges[-1]))
    m_0, m_1, m_2 = E @ b, E @ (A @ b), E @ (A @ (A @ b))
    above = m_0**2 / edge + (m_1**2 - 2.0 * m_0 * m_2) / (3.0 * edge**3)
    norms = (below + weights @ power + above) / np.pi
    if not np.all(np.isfinite(norms)):
        raise NumericalError("frequency integral", norms.tolist(), "is not finite")
    return TrackingNorms(float(norms[0]), float(norms[1]))


def tracking_response(plant: CoupledPlant, gain: FloatArray, omega: FloatArray) -> ComplexArray:
    """Return G~_1 and G~_2 of eq. 16 at ``omega``, complex (frequencies, 2).

    Parameters
    ----------
    omega
        (frequencies,) [rad/s].
    """
    return _response(*_closed_loop(plant, gain), np.asarray(omega, dtype=float))


def _states(plant: CoupledPlant, gain: FloatArray) -> DesignStates:
    """Return the states of the closed loop."""
    n = plant.layout.order
    if gain.shape != (n,):
        raise ParameterError("gain shape", gain.shape, f"must be ({n},)")
    return DesignStates.from_law(plant, gain)


def _closed_loop(plant: CoupledPlant, gain: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return A - B K, the noise column and the error rows on scaled physical states."""
    states = _states(plant, gain)
    keep = states.indices
    model, scale = plant.coupled, plant.state_scale[keep]
    closed = model.A - np.outer(model.B[:, 0], gain)
    E = np.stack([model.C[0] - model.C[2], model.C[1] - model.C[3]])
    A = states.rows(closed)[:, keep] * scale / scale[:, None]
    return A, states.rows(model.B)[:, 1] / scale, E[:, keep] * scale


def _response(A: FloatArray, b: FloatArray, E: FloatArray, omega: FloatArray) -> ComplexArray:
    identity = np.eye(len(b))
    blocks = []
    for part in np.array_split(omega, 1 + len(omega) // 256):  # keeps the stack of matrices small
        stack = 1j * part[:, None, None] * identity - A
        blocks.append(np.linalg.solve(stack, b[:, None] + 0j)[..., 0] @ E.T)
    response: ComplexArray = np.concatenate(blocks)
    return response


def _panel_edges(poles: ComplexArray) -> FloatArray:
    """Return the ends of the panels in log omega, rising."""
    size = np.abs(poles)
    # Poles below 1e-7 rad/s are rounding noise in these coordinates.
    low, high = max(1e-3 * float(np.min(size)), 1e-10), 1e3 * float(np.max(size))
    decades = np.log10(high / low)
    regular = np.linspace(np.log(low), np.log(high), 1 + int(np.ceil(PANELS_PER_DECADE * decades)))
    steps = np.array([-10.0, -3.0, -1.0, 0.0, 1.0, 3.0, 10.0])
    near = (np.abs(poles.imag)[:, None] + steps * np.abs(poles.real)[:, None]).ravel()
    near = near[(near > low) & (near < high)]
    edges = np.unique(np.concatenate([regular, np.log(near)]))
    return np.asarray(edges[np.append(True, np.diff(edges) > 1e-6)], dtype=np.float64)


def _panels(edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return nodes (k,) [rad/s] and weights (k,) for an integral over omega; edges in log omega."""
    x, w = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    nodes = np.exp(middle[:, None] + half[:, None] * x).ravel()
    weights: FloatArray = (half[:, None] * w).ravel() * nodes
    return nodes, weights
