"""The compiled adjoint of a control period against torch's differentiation of the readable update."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_cases import EVERYTHING, PARTS, dynamics_of, scale_of

from agents.learning.apg.torch_plant import CompiledPeriod, torch_model
from agents.learning.apg.window_rollout import WindowRollout
from agents.learning.vec_env import ShakeTableVecEnv
from shake_env import make_scenario, numba_support
from shake_env.dynamics.nonlinear import NonlinearDynamics
from shake_env.kernels.lanes import BLOCK
from shake_env.model.nonlinearity import Yielding
from shake_env.simulation.transition import TableModel

torch = pytest.importorskip("torch")
LIKE = torch.zeros(1, dtype=torch.float64)
PARTS_OF_A_RESPONSE = ("state", "table_acceleration", "base_shear")


def both(dynamics):
    """Return the compiled period and the reference, for torch."""
    compiled = CompiledPeriod.from_dynamics(dynamics, LIKE)
    assert compiled is not None
    return compiled, dynamics.to(LIKE)


def random_start(dynamics, stories, rng, lanes=3):
    scale = scale_of(dynamics, stories)
    state = rng.uniform(-1.0, 1.0, (lanes, dynamics.states)) * scale
    # At most touching a stop: a table metres behind one has no digits left.
    state[:, 1] *= min(1.0, 1.02 * dynamics.parts.stops.gap / scale[1])
    if dynamics.parts.yielding.active:
        drift = dynamics.parts.yielding.yield_drift
        state[:, 4:] = 0.0
        state[:, 4 : 4 + stories] = np.cumsum(rng.uniform(-1.1, 1.1, (lanes, stories)), axis=1) * drift
        state[:, 4 + stories : 4 + 2 * stories] = rng.normal(0.0, 0.3, (lanes, stories))
    return state, rng.normal(0.0, 0.02, lanes)


def follow(dynamics, state, currents, weights):
    """Return a number that depends on every output of some periods, and its slopes."""
    state = torch.tensor(state, requires_grad=True)
    currents = torch.tensor(currents, requires_grad=True)
    now, total = state, torch.zeros((), dtype=torch.float64)
    for current, weight in zip(currents, weights, strict=True):
        response = dynamics.control_step(now, current)
        now = response.state
        for name, part in zip(PARTS_OF_A_RESPONSE, weight, strict=True):
            total = total + (part * getattr(response, name)).sum()
    slopes = torch.autograd.grad(total, (state, currents))
    return now.detach().numpy(), [slope.numpy() for slope in slopes]


def assert_same_slopes(dynamics, stories, lanes, periods, rng):
    state, _ = random_start(dynamics, stories, rng, lanes)
    currents = rng.normal(0.0, 0.02, (periods, lanes))
    scale = scale_of(dynamics, stories)
    outputs = np.abs(dynamics.C).reshape(-1, *dynamics.C.shape[-2:]).max(axis=0)
    sizes = (scale, *(outputs @ scale[: outputs.shape[1]]))
    k = dynamics.substeps
    weights = [
        [
            torch.as_tensor(rng.normal(size=(lanes, count)) / size)
            for count, size in zip((dynamics.states, k, k), sizes, strict=True)
        ]
        for _ in range(periods)
    ]
    ours, theirs = (follow(one, state, currents, weights) for one in both(dynamics))
    if not np.abs(theirs[0] / scale).max() < 1e3:
        return  # diverged: beyond where an episode ends
    np.testing.assert_allclose(ours[0] / scale, theirs[0] / scale, rtol=1e-10, atol=1e-10)
    along_state = [slopes[0] * scale for _, slopes in (ours, theirs)]
    along_current = [slopes[1] * 0.025 for _, slopes in (ours, theirs)]
    # Relative to a lane's steepest slope: a small one is a difference of such.
    steepest = np.maximum(np.abs(along_state[1]).max(axis=1), np.abs(along_current[1]).max(axis=0))
    assert np.isfinite(steepest).all() and (steepest > 0.0).all()
    difference = np.abs(along_state[0] - along_state[1]).max(axis=1)
    assert np.all(difference <= 1e-8 * steepest)
    difference = np.abs(along_current[0] - along_current[1]).max(axis=0)
    assert np.all(difference <= 1e-8 * steepest)


@settings(max_examples=150, deadline=None)
@given(
    parts=PARTS,
    stories=st.integers(1, 6),
    substeps=st.sampled_from([1, 2, 5]),
    delay=st.sampled_from([0, 1, 2.5, 7]),
    lanes=st.sampled_from([None, 1, 3]),
    seed=st.integers(0, 2**32 - 1),
)
def test_slopes_of_a_period_are_those_that_torch_finds(parts, stories, substeps, delay, lanes, seed):
    if not parts.active:
        parts = EVERYTHING
    dynamics = dynamics_of(parts, stories, substeps, delay, lanes)
    rng = np.random.default_rng(seed)
    assert_same_slopes(dynamics, stories, lanes or 3, 2, rng)


@pytest.mark.parametrize("own", [False, True])
def test_lanes_beyond_a_block_have_their_own_slopes(own):
    lanes = BLOCK + 7
    dynamics = dynamics_of(EVERYTHING, 2, 5, 2.5, lanes if own else None)
    assert_same_slopes(dynamics, 2, lanes, 3, np.random.default_rng(0))


@pytest.mark.parametrize("yields", [False, True])
def test_at_rest_and_on_a_bound_a_corner_has_torchs_slope(yields):
    parts = EVERYTHING if yields else replace(EVERYTHING, yielding=Yielding())
    dynamics = dynamics_of(parts, 2, 5, 2)
    state, currents = np.zeros((3, dynamics.states)), np.zeros((2, 3))
    state[1, 3] = parts.valve.spool_limit
    state[2, 1] = parts.stops.gap
    ones = [[torch.ones(3, n, dtype=torch.float64) for n in (dynamics.states, 5, 5)]] * 2
    ours, theirs = (follow(one, state, currents, ones) for one in both(dynamics))
    for found, expected in zip(ours[1], theirs[1], strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


UNCERTAIN = {"fields": {"uncertainty.mass_ratio": [0.1, 1.0], "uncertainty.delay": [1.0, 4.0]}}


@pytest.mark.parametrize(
    ("name", "overrides"),
    [("laboratory", {}), ("laboratory", UNCERTAIN), ("yielding", {}), ("records", {})],
    ids=str,
)
def test_a_window_through_the_compiled_plant_is_the_references(name, overrides, monkeypatch):
    env = ShakeTableVecEnv(make_scenario(name, overrides), 5)
    env.seed(3)
    env.reset()
    start = env.get_state()

    def window(compiled):
        monkeypatch.setattr(numba_support, "COMPILED", compiled)
        env.set_state(start)
        tables = WindowRollout(env)
        assert isinstance(tables.model.dynamics, CompiledPeriod) == compiled
        shown = env.observation.shape[1]
        weights = torch.linspace(-0.01, 0.01, shown, dtype=torch.float64, requires_grad=True)
        pushes = iter(0.3 * torch.sin(torch.arange(40, dtype=torch.float64) / 3.0))
        moved = tables.rollout(lambda seen, none: (seen @ weights + next(pushes), none, none), 40)
        (slope,) = torch.autograd.grad(moved.rewards.sum(), weights)
        return moved.rewards.detach().numpy(), moved.state.detach().numpy(), slope.numpy()

    ours, theirs = window(True), window(False)
    for found, expected in zip(ours[:2], theirs[:2], strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())
    np.testing.assert_allclose(ours[2], theirs[2], rtol=1e-8, atol=1e-8 * np.abs(theirs[2]).max())


def test_without_numba_in_single_precision_or_elsewhere_torch_takes_the_update_apart(monkeypatch):
    model = TableModel.from_scenario(make_scenario("laboratory"))
    assert isinstance(torch_model(model, LIKE).dynamics, CompiledPeriod)
    for other in (LIKE.float(), LIKE.to("meta")):
        assert CompiledPeriod.from_dynamics(model.dynamics, other) is None
    assert isinstance(torch_model(model, LIKE.float()).dynamics, NonlinearDynamics)
    monkeypatch.setattr(numba_support, "_load", lambda name: None)
    fresh = replace(model, dynamics=replace(model.dynamics))
    assert isinstance(torch_model(fresh, LIKE).dynamics, NonlinearDynamics)


def test_a_lost_table_spoils_no_other_lanes_slope():
    dynamics = dynamics_of(EVERYTHING, 2, 5, 2)
    adjoint = CompiledPeriod.from_dynamics(dynamics, LIKE).adjoint
    rng = np.random.default_rng(0)
    state, current = random_start(dynamics, 2, rng)
    slopes = [rng.normal(size=(3, n)) for n in (dynamics.states, 5, 5)]
    well = adjoint(state, current, *slopes)
    state[1] = np.nan
    ill = adjoint(state, current, *slopes)
    for found, expected in zip(ill, well, strict=True):
        np.testing.assert_array_equal(np.delete(found, 1, axis=0), np.delete(expected, 1, axis=0))
