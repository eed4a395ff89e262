"""The compiled update against the array-API kernel that it repeats."""

import math
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_cases import EVERYTHING, PARTS, dynamics_of, scale_of

from shake_env import make_scenario, numba_support
from shake_env.dynamics.nonlinear import ARRAYS
from shake_env.kernels.lanes import BLOCK, expm1, tanh
from shake_env.scenario.uncertainty import Uncertainty, Uniform
from shake_env.simulation.simulation import Simulation


def both(dynamics, state, current):
    """Return the responses of the compiled update and of the reference."""
    assert dynamics._compiled is not None and dynamics._compiled.fits(state, current)
    compiled = dynamics.control_step(state, current)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(numba_support, "COMPILED", False)
        return compiled, dynamics.control_step(state, current)


@settings(max_examples=150, deadline=None)
@given(
    parts=PARTS,
    stories=st.integers(1, 6),
    substeps=st.sampled_from([1, 2, 5]),
    delay=st.sampled_from([0, 1, 2.5, 7]),
    lanes=st.sampled_from([None, 1, 3]),
    seed=st.integers(0, 2**32 - 1),
)
def test_compiled_and_reference_agree(parts, stories, substeps, delay, lanes, seed):
    dynamics = dynamics_of(parts, stories, substeps, delay, lanes)
    scale = scale_of(dynamics, stories)
    rng = np.random.default_rng(seed)
    state = np.zeros((lanes or 3, dynamics.states))
    state[:, :4] = rng.uniform(-1.0, 1.0, (len(state), 4)) * scale[:4]
    state[:, 1] *= min(1.0, parts.stops.gap / scale[1])  # at most touching a stop, and moving into it
    acceleration_scale, shear_scale = (
        np.abs(dynamics.C).max(axis=tuple(range(dynamics.C.ndim - 2))) @ (scale[: dynamics.C.shape[-1]])
    )
    for _ in range(10):
        current = rng.normal(0.0, 0.03, len(state))
        ours, theirs = both(dynamics, state, current)
        # Relative to the largest scaled state of a lane: the force of a stiff stop or of an overstrained
        # storey reaches every state, and its rounding with it.
        size = np.maximum(np.abs(theirs.state / scale).max(axis=-1), 1.0)[:, None]
        tolerance = 1e-12
        assert np.all(np.abs(ours.state - theirs.state) <= tolerance * size * scale)
        peak = np.maximum(np.abs(theirs.table_acceleration).max(axis=-1)[:, None], acceleration_scale)
        assert np.all(np.abs(ours.table_acceleration - theirs.table_acceleration) <= tolerance * peak)
        peak = np.maximum(np.abs(theirs.base_shear).max(axis=-1)[:, None], shear_scale)
        assert np.all(np.abs(ours.base_shear - theirs.base_shear) <= tolerance * peak)
        state = theirs.state
        if not np.abs(state / scale).max() < 1e3:
            break  # diverged: beyond where an episode ends


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("lanes", [None, BLOCK + 7])
@pytest.mark.parametrize("delay", [0, 7])
def test_periods_in_one_call_are_periods_one_by_one(delay, lanes, compiled, monkeypatch):
    monkeypatch.setattr(numba_support, "COMPILED", compiled)
    dynamics = dynamics_of(EVERYTHING, 2, 5, delay, lanes)
    rng = np.random.default_rng(2)
    state = 0.1 * rng.normal(size=(BLOCK + 7, dynamics.states)) * scale_of(dynamics, 2)
    current = rng.normal(0.0, 0.02, (6, len(state)))
    together = dynamics.control_periods(state, current)
    for period, command in enumerate(current):
        alone = dynamics.control_step(state, command)
        state = alone.state
        np.testing.assert_array_equal(together.state[period], state)
        np.testing.assert_array_equal(together.table_acceleration[period], alone.table_acceleration)
        np.testing.assert_array_equal(together.base_shear[period], alone.base_shear)


@pytest.mark.parametrize("lanes", [None, BLOCK + 7])
def test_a_lane_does_not_depend_on_its_batch(lanes):
    dynamics = dynamics_of(EVERYTHING, 2, 5, 2, lanes)
    scale = scale_of(dynamics, 2)
    rng = np.random.default_rng(0)
    state = rng.normal(size=(BLOCK + 7, dynamics.states)) * scale
    current = rng.normal(0.0, 0.02, len(state))
    together = dynamics.control_step(state, current)
    for lane in range(len(state)):
        alone = dynamics
        if lanes is not None:
            own = {name: np.asarray(getattr(dynamics, name)[lane]) for name in ARRAYS}
            alone = replace(dynamics, **own)
        assert alone._compiled.fits(state[lane], current[lane])
        response = alone.control_step(state[lane], current[lane])
        np.testing.assert_array_equal(response.state, together.state[lane])
        np.testing.assert_array_equal(response.table_acceleration, together.table_acceleration[lane])
        np.testing.assert_array_equal(response.base_shear, together.base_shear[lane])


def test_a_diverged_lane_stays_so_and_spoils_no_other():
    dynamics = dynamics_of(EVERYTHING, 2, 5, 2)
    state, current = np.zeros((5, dynamics.states)), np.full(5, 0.01)
    well = dynamics.control_step(state, current)
    state[2] = np.nan
    ill = dynamics.control_step(state, current)
    assert np.isnan(ill.state[2, :-1]).all() and np.isnan(ill.table_acceleration[2]).all()
    np.testing.assert_array_equal(np.delete(ill.state, 2, axis=0), np.delete(well.state, 2, axis=0))


def test_layout_and_leading_axes_are_the_callers():
    dynamics = dynamics_of(EVERYTHING, 2, 5, 7)
    rng = np.random.default_rng(1)
    state = rng.normal(size=(2, 3, dynamics.states)) * scale_of(dynamics, 2)
    current = rng.normal(0.0, 0.02, (2, 3))
    plain = dynamics.control_step(state, current)
    assert plain.state.shape == state.shape and plain.base_shear.shape == (2, 3, 5)
    kept = state.copy()
    state.flags.writeable = False
    spread = np.asfortranarray(state)
    for other in (state, spread):
        ours, theirs = both(dynamics, other, current)
        np.testing.assert_array_equal(ours.state, plain.state)
        assert ours.state.shape == theirs.state.shape
        assert ours.base_shear.shape == theirs.base_shear.shape
    np.testing.assert_array_equal(state, kept)


def test_what_does_not_fit_goes_to_the_reference():
    dynamics = dynamics_of(EVERYTHING, 2, 5, 2)
    state, current = np.zeros((3, dynamics.states)), np.zeros(3)
    step = dynamics._compiled
    assert step.fits(state, current)
    assert not step.fits(state.astype(np.float32), current)
    assert not step.fits(state[:, :-1], current)
    assert not step.fits(state, current[:2])
    assert not step.fits(state[:0], current[:0])
    assert not dynamics_of(EVERYTHING, 2, 5, 2, 4)._compiled.fits(state, current)
    with pytest.raises(ValueError):
        dynamics.control_step(state[:, :-1], current)


def test_a_fleet_steps_compiled_and_sees_its_redrawn_plants():
    spread = Uncertainty(mass_ratio=Uniform(0.1, 1.0), coulomb_friction=Uniform(100.0, 300.0))
    scenario = make_scenario(
        "linear", {"uncertainty": spread, "nonlinearity": EVERYTHING, "delay": 2, "duration": 1.0}
    )
    simulation = Simulation(scenario, 3)
    rng = np.random.default_rng(2)
    for draw in range(2):
        simulation.start(range(3), [np.random.default_rng(10 * draw + lane) for lane in range(3)])
        for _ in range(10):
            simulation.step(rng.normal(0.0, 0.1, 3))
        ours, theirs = both(simulation.model.dynamics, simulation.state, rng.normal(0.0, 0.02, 3))
        scale = scale_of(simulation.model.dynamics, 2)
        np.testing.assert_allclose(ours.state / scale, theirs.state / scale, rtol=1e-12, atol=1e-12)


def test_elementary_functions_are_good_to_rounding():
    x = np.concatenate([np.geomspace(1e-300, 60.0, 20001), [0.0, np.inf]])
    ours = np.array([tanh(value) for value in np.concatenate([x, -x])])
    np.testing.assert_allclose(ours, np.tanh(np.concatenate([x, -x])), rtol=3e-15, atol=0.0)
    np.testing.assert_allclose([expm1(-value) for value in x], np.expm1(-x), rtol=3e-15, atol=0.0)
    assert math.isnan(tanh(math.nan))


def test_numba_is_imported_only_for_a_nonlinear_step():
    script = (
        "import sys, numpy as np, shake_env\n"
        "from shake_env.model.nonlinearity import Friction, Nonlinearity\n"
        "def step(scenario):\n"
        "    from shake_env.simulation.transition import TableModel\n"
        "    dynamics = TableModel.from_scenario(scenario).dynamics\n"
        "    size = getattr(dynamics, 'states')\n"
        "    dynamics.control_step(np.zeros((2, size)), np.zeros(2))\n"
        "    return 'numba' in sys.modules\n"
        "parts = Nonlinearity(friction=Friction(coulomb=150.0))\n"
        "linear = step(shake_env.make_scenario())\n"
        "print(linear, step(shake_env.make_scenario('linear', {'nonlinearity': parts})))\n"
    )
    for switch, expected in (("1", "False True"), ("0", "False False")):
        environment = {**os.environ, "SHAKE_ENV_COMPILED": switch}
        found = subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, env=environment, check=True
        )
        assert found.stdout.strip() == expected


@pytest.fixture
def fresh_loader():
    """Modules are looked for anew, here and after."""
    numba_support._load.cache_clear()
    yield
    numba_support._load.cache_clear()


def test_without_numba_the_reference_steps(monkeypatch, fresh_loader):
    monkeypatch.setitem(sys.modules, "shake_env.kernels.table", None)
    dynamics = dynamics_of(EVERYTHING, 2, 5, 2)
    response = dynamics.control_step(np.zeros((2, dynamics.states)), np.full(2, 0.01))
    assert dynamics._compiled is None
    assert np.all(response.state[:, 3] > 0.0)


def test_a_numba_that_refuses_is_told(monkeypatch, fresh_loader):
    def refuse(name):
        raise ImportError("Numba needs NumPy 1.0 or less")

    monkeypatch.setattr(numba_support.importlib, "import_module", refuse)
    with pytest.warns(RuntimeWarning, match=r"Numba needs NumPy .* SHAKE_ENV_COMPILED=0"):
        assert numba_support.compiled_module("shake_env.kernels.table") is None
