"""Norm-optimal iterative learning control: the best correction of a drive, on the nominal model.

After each test the drive is changed by the d that minimises ``|e - G d|_Q^2 + R |d|^2``: e what the
test missed of acceleration and base shear, weighed as the stage cost, and G the nominal table over the
whole test (Amann, Owens and Rogers, Int. J. Control 65, 1996). On a table that is the model the error's
norm falls in every repeat. G is never formed: the minimum is a linear-quadratic tracking problem, solved
by a Riccati recursion once, and by a co-state backwards and the model forwards in every repeat.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from baselines.iterative.drive_file import DisplacementHold, PeriodModel
from baselines.iterative.repeated_tests import Repeat, Tests, repeat_tests, run_test
from shake_env.controller import NoControl
from shake_env.errors import ParameterError
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import REFERENCE_CURRENT
from shake_env.rollout import Earthquake
from shake_env.scenario.objective import StageCost
from shake_env.scenario.scenario import Scenario


@dataclass(frozen=True)
class LearningLaw:
    """The correction of a drive by the errors of a test, for tests of a fixed number of steps.

    States are scaled, and currents in units of REFERENCE_CURRENT.
    """

    F: FloatArray  # (m, m)
    G: FloatArray  # (m,)
    z_x: FloatArray  # (2 k, m) outputs, weighed so that their squares sum to the stage cost
    z_u: FloatArray  # (2 k,)
    weights: FloatArray  # (2, 1) of acceleration [s^2/m] and base shear [1/N]
    gains: FloatArray  # (steps, m) feedback of the state that the correction builds up
    curvature: FloatArray  # (steps,) of the cost in each step's current

    @classmethod
    def from_model(
        cls, model: PeriodModel, cost: StageCost, step_weight: float, steps: int
    ) -> LearningLaw:
        """Solve the Riccati recursion over `steps`.

        Parameters
        ----------
        model
            The nominal table.
        cost
            Whose weights of acceleration and base shear Q takes.
        step_weight
            R: cost of a correction of REFERENCE_CURRENT in one period, in stage costs.
        steps
            Control periods of a test.
        """
        k = model.Z_u.shape[-1]
        weights = np.sqrt(np.array([[cost.acceleration], [cost.force]]) / k)
        size = _sizes(model)
        F, G = model.F * size / size[:, None], model.G * REFERENCE_CURRENT / size
        z_x = (model.Z_x * weights[..., None] * size).reshape(2 * k, -1)
        z_u = (model.Z_u * weights * REFERENCE_CURRENT).reshape(2 * k)
        gains, curvature = np.empty((steps, len(F))), np.empty(steps)
        P = np.zeros_like(F)
        for i in range(steps - 1, -1, -1):
            R_u = float(z_u @ z_u + G @ P @ G + step_weight)
            K = (z_u @ z_x + G @ P @ F) / R_u
            P = F.T @ P @ F + z_x.T @ z_x - R_u * np.outer(K, K)
            P = 0.5 * (P + P.T)
            gains[i], curvature[i] = K, R_u
        return cls(F, G, z_x, z_u, weights, gains, curvature)

    def correction(self, errors: FloatArray) -> FloatArray:
        """Return d, (N, steps) [A], for what was missed (N, steps, 2, k) of ``[y_A, f_s]``."""
        lanes, steps = errors.shape[:2]
        e = (errors * self.weights).reshape(lanes, steps, -1)
        feed = np.empty((lanes, steps))
        on_state, on_current = e @ self.z_x, e @ self.z_u
        b = np.zeros((lanes, len(self.F)))  # minus the co-state where the state is zero
        for i in range(steps - 1, -1, -1):
            feed[:, i] = (on_current[:, i] + b @ self.G) / self.curvature[i]
            b = on_state[:, i] + b @ self.F - (self.curvature[i] * feed[:, i])[:, None] * self.gains[i]
        d, x = np.empty((lanes, steps)), np.zeros((lanes, len(self.F)))
        for i in range(steps):
            d[:, i] = feed[:, i] - x @ self.gains[i]
            x = x @ self.F.T + d[:, i, None] * self.G
        return d * REFERENCE_CURRENT


def _sizes(model: PeriodModel, periods: int = 64) -> FloatArray:
    """Return the size of each state (m,): its largest response to one period of REFERENCE_CURRENT."""
    x, largest = model.G * REFERENCE_CURRENT, np.abs(model.G) * REFERENCE_CURRENT
    for _ in range(periods):
        x = model.F @ x
        largest = np.maximum(largest, np.abs(x))
    return np.where(largest > 0.0, largest, 1.0)


def norm_optimal_learning(
    scenario: Scenario,
    earthquakes: Sequence[Earthquake],
    *,
    repeats: int = 6,
    step_weight: float = 0.01,
) -> Tests:
    """Repeat each earthquake's test and learn its drive file; the best test's drive is kept.

    Parameters
    ----------
    scenario
        Whose true plants are tested; the law knows the nominal one, with its loop delay.
    earthquakes
        One a lane.
    repeats
        Tests.
    step_weight
        R, see `LearningLaw.from_model`: larger learns more slowly, and forgives a wrong model more.

    Raises
    ------
    ParameterError
        If there is no repeat, or the step's weight is not above 0.
    """
    if repeats < 1:
        raise ParameterError("repeats", repeats, "must be at least 1")
    if not 0.0 < step_weight < math.inf:
        raise ParameterError("step_weight", step_weight, "must be above 0, finite")
    hold = DisplacementHold(scenario)
    still = run_test(scenario, earthquakes, NoControl())
    model = PeriodModel.from_scenario(scenario, hold.gain)
    law = LearningLaw.from_model(model, scenario.stage_cost, step_weight, still.target.shape[1])
    return repeat_tests(
        scenario, earthquakes, still, lambda test: law.correction(tracking_error(test)), repeats, hold
    )


def tracking_error(test: Repeat) -> FloatArray:
    """Return a test's error of ``[y~, f~_s]``, from which ILC learns, (N, steps, 2, k)."""
    acceleration = test.target - test.acceleration
    return np.stack([acceleration, test.reference_shear - test.base_shear], axis=2)
