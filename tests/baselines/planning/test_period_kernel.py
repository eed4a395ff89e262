"""The Jacobian of a period against its adjoint, for every nonlinear part."""

import numpy as np
import pytest

pytest.importorskip("numba")

from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_cases import EVERYTHING, PARTS

from baselines.estimation.estimator_model import ModelError
from baselines.planning.ilqr_kernel import period_with_jacobian
from baselines.planning.model import PlanningModel
from shake_env import make_scenario
from shake_env.dynamics.nonlinear import NonlinearDynamics
from shake_env.kernels.period_adjoint import PeriodAdjoint
from shake_env.kernels.table import CompiledStep


def table(parts, stories, delay):
    scenario = make_scenario("linear", {"stories": stories})
    return replace(scenario, nonlinearity=parts, delay=delay)


def adjoint_of(scenario):
    dynamics = NonlinearDynamics.from_plant(
        scenario.plant, scenario.parts, scenario.physics_step, scenario.substeps, delay=scenario.delay
    )
    step = dynamics._compiled
    assert isinstance(step, CompiledStep)
    return step, PeriodAdjoint(step)


def random_state(model, rng):
    parts = model.scenario.nonlinearity
    x = rng.uniform(-1.0, 1.0, model.states) * model.scale
    x[1] *= min(1.0, 1.02 * parts.stops.gap / model.scale[1])
    n = model.scenario.specimen.stories
    if parts.yielding.active:
        x[4 : 4 + 3 * n] = 0.0
        x[4 : 4 + n] = np.cumsum(rng.uniform(-1.1, 1.1, n)) * parts.yielding.yield_drift
        x[4 + n : 4 + 2 * n] = rng.normal(0.0, 0.3, n)
    return x


@settings(max_examples=15, deadline=None)
@given(PARTS, st.integers(1, 3), st.sampled_from([0.0, 2.5, 7.0]), st.integers(0, 2**32 - 1))
def test_the_jacobian_is_that_of_the_adjoint(parts, stories, delay, seed):
    scenario = table(parts, stories, delay)
    model, (step, adjoint) = PlanningModel.of(scenario), adjoint_of(scenario)
    rng = np.random.default_rng(seed)
    n, k = model.states, model.substeps
    for _ in range(3):
        x, u = random_state(model, rng), rng.normal(0.0, 0.02)
        moved, response, A, B, C, D = period_with_jacobian(x, u, model.arrays, model.scale)
        expected = step(x[None], np.array([u]))
        np.testing.assert_allclose(moved / model.scale, expected[0][0] / model.scale, atol=1e-12)
        np.testing.assert_allclose(response, np.r_[expected[1][0], expected[2][0]], rtol=1e-9, atol=1e-7)
        J = n + 2 * k
        seeds = np.eye(J)
        split = [np.ascontiguousarray(seeds[:, a:b]) for a, b in ((0, n), (n, n + k), (n + k, J))]
        slopes, along = adjoint(np.tile(x, (J, 1)), np.full(J, u), *split)
        slopes *= model.scale
        # A current behind a limited valve moves nothing: relative to the state's slopes then.
        sizes = [np.abs(slopes[n:]).max(), np.abs(slopes[:n] / model.scale[:, None]).max()]
        for ours, theirs in (
            (A, slopes[:n] / model.scale[:, None]),
            (B, along[:n] / model.scale),
            (C, slopes[n:]),
            (D, along[n:]),
        ):
            size = max(np.abs(theirs).max(), sizes[theirs.shape[0] == n])
            np.testing.assert_allclose(ours, theirs, atol=1e-10 * size)


def test_with_disturbances_it_is_the_slope_of_the_period():
    scenario = table(EVERYTHING, 2, 2.5)
    model = PlanningModel.of(scenario, ModelError(force=300.0, flow=1e-6))
    assert model.disturbances == 2
    rng = np.random.default_rng(5)
    x, u = random_state(model, rng), 0.01
    _, _, A, _, C, _ = period_with_jacobian(x, u, model.arrays, model.scale)
    step = 1e-6
    for i in range(model.states):
        both = []
        for sign in (1.0, -1.0):
            moved_x = x.copy()
            moved_x[i] += sign * step * model.scale[i]
            both.append(period_with_jacobian(moved_x, u, model.arrays, model.scale)[:2])
        slope = (both[0][0] - both[1][0]) / (2 * step) / model.scale
        np.testing.assert_allclose(A[:, i], slope, atol=2e-5 * np.abs(A).max())
        output = (both[0][1] - both[1][1]) / (2 * step)
        np.testing.assert_allclose(C[:, i], output, atol=2e-5 * np.abs(C).max())
