"""What a finite look-ahead costs, against its limits and against the gradient that it should end."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from agents.studies.finite_horizon import discounted_cost, windowed_cost, windowed_law
from baselines.lqr.sampled import ScaledProblem, sampled_lqr
from shake_env import make_scenario
from shake_env.model.plant import REFERENCE_CURRENT

LINEAR = make_scenario("linear")


def test_looking_further_costs_less_and_ends_at_the_optimum():
    horizons = [discounted_cost(LINEAR, h) for h in (0.1, 0.25, 0.5, 2.0, 1e4)]
    windows = [windowed_cost(LINEAR, w) for w in (48, 96, 192, 384)]
    for costs in (horizons, windows):
        assert all(later < earlier for earlier, later in pairwise(costs))
        assert min(costs) >= 1.0 - 1e-9
    # The law's bias is of first order in 1 / horizon; the cost, flat at its optimum, of second.
    assert horizons[-1] == pytest.approx(1.0, abs=1e-8)


def test_the_training_page_has_these_numbers():
    page = (Path(__file__).parents[3] / "docs" / "training.md").read_text(encoding="utf-8").splitlines()

    def table(heading):
        row = next(i for i, line in enumerate(page) if line.startswith(f"| {heading}"))
        return [[cell.strip() for cell in page[i].strip("|").split("|")][1:] for i in (row, row + 2)]

    for horizon, cost in zip(*table("discount's horizon"), strict=True):
        assert cost == f"{discounted_cost(LINEAR, float(horizon)):.4f}"
    for window, cost in zip(*table("window [s]"), strict=True):
        periods = int(window.split("(")[1].rstrip(")"))
        assert float(window.split("(")[0]) == pytest.approx(periods * LINEAR.control_period)
        assert cost == f"{windowed_cost(LINEAR, periods):.4f}"


def window_cost(p, stage, start, K, window, discount):
    """Expected discounted cost of a window from a covariance of states, under a law."""
    Q, R, S = stage
    closed = p.F - p.G @ K
    weight = Q - S @ K - K.T @ S.T + K.T @ R @ K
    covariance, total = start, 0.0
    for place in range(window):
        total += discount**place * np.trace(weight @ covariance)
        covariance = closed @ covariance @ closed.T + p.N @ p.N.T
    return total


@pytest.mark.parametrize("discount", [1.0, 0.99])
def test_the_windowed_law_is_where_the_gradient_of_a_window_vanishes(discount):
    # As back-propagation sees it: where a window begins is given, and does not answer to the law.
    p = ScaledProblem.from_plant(LINEAR.discrete)
    stage, window = p.stage(LINEAR.stage_cost), 40

    def slope(K):
        start = solve_discrete_lyapunov(p.F - p.G @ K, p.N @ p.N.T)
        found = np.zeros(K.size)
        for i in range(K.size):
            step = np.zeros_like(K)
            step[0, i] = 1e-5 * np.abs(K).max()
            ahead, behind = (
                window_cost(p, stage, start, K + s, window, discount) for s in (step, -step)
            )
            found[i] = (ahead - behind) / (2.0 * step[0, i])
        return found

    law = windowed_law(LINEAR, window, discount)
    optimal = sampled_lqr(LINEAR.discrete, LINEAR.stage_cost).gain
    optimal = (optimal[p.indices] * p.scale / REFERENCE_CURRENT)[None]
    # Central differences of 1e-5: what remains of the slope is their rounding and curvature.
    assert np.abs(slope(law)).max() < 1e-4 * np.abs(slope(optimal)).max()
