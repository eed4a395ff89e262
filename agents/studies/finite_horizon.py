"""Cost of a finite horizon: what a discount or a short window adds to the optimal cost.

On a linear plant the law that a learner converges to is a linear one, whose stationary cost is exact.
Under a discount it solves a Riccati equation. Under gradients through windows it is where the expected
gradient of a window's cost vanishes: an action at the window's start is judged by all of it, one at its
end by nothing that comes after, and a policy that does not know where it stands gets the mean, weighed
by the discount of its places.
"""

from __future__ import annotations

import math

import numpy as np

from agents.training.config import TrainConfig
from baselines.lqr.sampled import ScaledProblem, riccati, sampled_lqr, stationary_performance
from shake_env.errors import NumericalError
from shake_env.model.parameters import FloatArray
from shake_env.scenario.scenario import Scenario

ROUNDS = 200


def discounted_cost(scenario: Scenario, horizon: float) -> float:
    """Return the cost, over the optimum, of the law that is optimal under a discount.

    Parameters
    ----------
    scenario
        Linear and fully seen.
    horizon
        Of the discount ``exp(-control period / horizon)`` [s].

    Raises
    ------
    NumericalError
        If the discounted law does not hold the table.
    """
    p, (Q, R, S) = _problem(scenario)
    share = math.exp(-0.5 * scenario.control_period / horizon)
    _, K = riccati(share * p.F, share * p.G, Q, R, S)
    return _ratio(scenario, p, K)


def windowed_law(scenario: Scenario, window: int, discount: float) -> FloatArray:
    """Return the gain (1, m) on the states of `ScaledProblem` at which gradients through windows vanish.

    Parameters
    ----------
    scenario
        Linear and fully seen.
    window
        Control periods of a window, with no value at its end.
    discount
        Of a control period.

    Raises
    ------
    NumericalError
        If the iteration towards that law does not settle.
    """
    p, (Q, R, S) = _problem(scenario)
    _, K = riccati(p.F, p.G, Q, R, S)
    for _ in range(ROUNDS):
        closed = p.F - p.G @ K
        stage = Q - S @ K - K.T @ S.T + K.T @ R @ K
        to_go, total, weights = np.zeros_like(Q), np.zeros_like(Q), 0.0
        # Of each place, by the periods that follow it; its own cost is discounted from the start.
        for left in range(window):
            weight = discount ** (window - 1 - left)
            total, weights = total + weight * to_go, weights + weight
            to_go = stage + discount * closed.T @ to_go @ closed
        P = discount * total / weights  # what follows an action, over its places in the window
        better = np.linalg.solve(R + p.G.T @ P @ p.G, p.G.T @ P @ p.F + S.T).astype(np.float64)
        change = np.max(np.abs(better - K)) / np.max(np.abs(K))
        K = better
        if change < 1e-9:
            return K
    raise NumericalError("windowed law", change, f"still changes after {ROUNDS} rounds: a longer window")


def windowed_cost(scenario: Scenario, window: int, discount: float | None = None) -> float:
    """Return the cost, over the optimum, of the law that gradients through windows lead to.

    Parameters
    ----------
    scenario
        Linear and fully seen.
    window
        Control periods of a window, with no value at its end.
    discount
        Of a control period; None: as the analytic policy gradient has it.

    Raises
    ------
    NumericalError
        As `windowed_law` does, or if that law does not hold the table.
    """
    if discount is None:
        discount = TrainConfig(algorithm="apg").discount(scenario.control_period)
    return _ratio(
        scenario, ScaledProblem.from_plant(scenario.discrete), windowed_law(scenario, window, discount)
    )


def _problem(scenario: Scenario) -> tuple[ScaledProblem, tuple[FloatArray, FloatArray, FloatArray]]:
    """Return the scaled problem, m states, and its stage Q, R, S: (m, m), (1, 1), (m, 1)."""
    p = ScaledProblem.from_plant(scenario.discrete)
    return p, p.stage(scenario.stage_cost)


def _ratio(scenario: Scenario, p: ScaledProblem, K: FloatArray) -> float:
    cost = stationary_performance(scenario.discrete, scenario.stage_cost, p.gain(K)).cost
    return cost / sampled_lqr(scenario.discrete, scenario.stage_cost).analytic_cost
