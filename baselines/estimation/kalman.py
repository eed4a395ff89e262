"""Kalman filter of a table from measured signals: stationary, or from a known start.

Equations as in Anderson and Moore, Optimal Filtering, 1979, ch. 4 and 5. Predictor and corrector are
apart, for a reading is of the end of its period. The model is `baselines.estimation.estimator_model`'s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from baselines.estimation.estimator_model import EstimatorModel
from shake_env.errors import NumericalError
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import TABLE_DISPLACEMENT

WARM_UP = 400  # periods, 2 s at 200 Hz: most of a sensor's offset is learnt in them
_NO_SOLUTION = (
    "let every disturbance have a size and every sensor a noise, or measure the table's displacement"
)


@dataclass(frozen=True)
class KalmanFilter:
    """Predictor and corrector with a gain for each period since the start; the last one is stationary.

    ``x <- A x + B u`` and ``x <- x + L (y - C x)``.
    """

    model: EstimatorModel
    gains: FloatArray  # (periods, n, s) L; the last one serves ever after
    covariance: FloatArray  # (n, n) of the error that the last gain leaves after correction
    innovation: FloatArray  # (s, s) covariance of y - C x under the last gain

    @classmethod
    def from_model(cls, model: EstimatorModel, warm_up: int = WARM_UP) -> KalmanFilter:
        """Return the filter that starts at rest and is stationary after `warm_up` periods.

        Raises
        ------
        NumericalError
            If the Riccati equation has no stabilising solution.
        """
        gain, before = stationary_filter(model)
        gains = np.concatenate([_from_rest(model, warm_up)[0], gain[None]])
        S = model.C @ before @ model.C.T + np.diag(model.R)
        return cls(model, gains, before - gain @ S @ gain.T, S)

    @classmethod
    def from_rest(cls, model: EstimatorModel, periods: int) -> KalmanFilter:
        """Return the filter that runs its Riccati recursion for `periods` and keeps the last gain.

        It needs no stationary solution: with a perfect model it only learns the sensors' offsets.
        """
        gains, before = _from_rest(model, periods)
        S = model.C @ before @ model.C.T + np.diag(model.R)
        return cls(model, gains, before - gains[-1] @ S @ gains[-1].T, S)

    def predict(self, estimate: FloatArray, actions: FloatArray) -> FloatArray:
        """Return the estimate (..., n) a period on, under the actions (..., commands + 1)."""
        predicted: FloatArray = estimate @ self.model.A.T + actions @ self.model.B.T
        return predicted

    def correct(self, predicted: FloatArray, readings: FloatArray, age: NDArray[np.intp]) -> FloatArray:
        """Return the estimate (..., n) with readings (..., s) of `age` (...) periods from the start."""
        innovation = readings - predicted @ self.model.C.T
        index = np.minimum(age, len(self.gains) - 1)
        if np.all(index == index.flat[0]):  # tables in step share one gain
            corrected: FloatArray = predicted + innovation @ self.gains[index.flat[0]].T
            return corrected
        return predicted + (self.gains[index] @ innovation[..., None])[..., 0]


def stationary_filter(model: EstimatorModel) -> tuple[FloatArray, FloatArray]:
    """Return L (n, s) and the covariance before correction (n, n) of the stationary Kalman filter.

    Raises
    ------
    NumericalError
        If the Riccati equation has no stabilising solution, or it fails its residual check.
    """
    # A position that no reading feels would be a pole on the unit circle that nothing corrects.
    unseen = (
        not np.any(model.C[:, TABLE_DISPLACEMENT])
        and np.count_nonzero(model.A[:, TABLE_DISPLACEMENT]) == 1
    )
    observable = np.delete(np.arange(model.order), TABLE_DISPLACEMENT if unseen else [])
    A, C, Q = (
        model.A[np.ix_(observable, observable)],
        model.C[:, observable],
        model.Q[np.ix_(observable, observable)],
    )
    try:
        P = solve_discrete_are(A.T, C.T, Q, np.diag(model.R))
    except (ValueError, np.linalg.LinAlgError) as error:  # scipy raises either
        raise NumericalError("filter's Riccati equation", str(error), _NO_SOLUTION) from error
    S = C @ P @ C.T + np.diag(model.R)
    L = np.linalg.solve(S, C @ P).T
    residual = A @ (P - L @ C @ P) @ A.T - P + Q
    if not np.max(np.abs(residual)) <= 1e-8 * np.max(np.abs(P)):
        raise NumericalError("filter's Riccati residual", float(np.max(np.abs(residual))), _NO_SOLUTION)
    radius = float(np.max(np.abs(np.linalg.eigvals(A - L @ C @ A))))
    # A pole on the unit circle that no noise reaches is moved off it by the root of rounding.
    if not radius < 1.0 - 1e-7:
        raise NumericalError("filter's spectral radius", radius, _NO_SOLUTION)
    gain, before = np.zeros((model.order, len(C))), np.zeros((model.order, model.order))
    gain[observable], before[np.ix_(observable, observable)] = L, P
    return gain, before


def _from_rest(model: EstimatorModel, periods: int) -> tuple[FloatArray, FloatArray]:
    """Return the gains (periods, n, s) from an episode's start on, and the last P before correction."""
    gains = np.empty((periods, *model.C.shape[::-1]))
    P = before = model.start
    R, C, identity = np.diag(model.R), model.C, np.eye(model.order)
    for t in range(periods):
        before = P if t == 0 else model.A @ P @ model.A.T + model.Q
        L = np.linalg.solve(C @ before @ C.T + R, C @ before).T
        gains[t] = L
        left = identity - L @ C  # Joseph's form stays symmetric and positive
        P = left @ before @ left.T + L @ R @ L.T
    return gains, before
