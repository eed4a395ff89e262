"""The compiled engine against the readable one that it repeats, and what it must not break."""

import copy
import pickle
import sys
from dataclasses import fields, replace

import gymnasium
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shake_env import (
    Envelope,
    FilteredNoise,
    RecordedMotion,
    Sensing,
    Sensor,
    make_scenario,
    numba_support,
)
from shake_env.dynamics.nonlinear import controlled_scale
from shake_env.env import INFO_KEYS
from shake_env.errors import ScenarioError
from shake_env.kernels.vectors import BLOCK
from shake_env.model.nonlinearity import Friction, Nonlinearity, ServoValve, StrokeStops, Yielding
from shake_env.scenario.limits import Limits
from shake_env.scenario.uncertainty import Uncertainty, Uniform
from shake_env.simulation.reference_engine import ReferenceEngine
from shake_env.simulation.simulation import Simulation

LABORATORY = Nonlinearity(
    friction=Friction(coulomb=150.0),
    valve=ServoValve(supply_pressure=21e6, spool_limit=2e-5),
    stops=StrokeStops(gap=0.076),
)
NOISY = tuple(
    Sensor(
        signal=name,
        noise=noise,
        bias=noise,
        resolution=resolution,
        lowpass_frequency=lowpass,
        gain_error=0.03 if lowpass else 0.0,
    )
    for name, noise, resolution, lowpass in (
        ("floor_accelerations", 0.02, 0.0, None),
        ("table_acceleration", 0.05, 0.01, 80.0),
        ("base_shear", 1.0, 0.0, 40.0),
        ("spool_position", 0.0, 1e-9, None),
        ("load_pressure", 1e3, 640.0, None),
    )
)
SCENARIOS = st.fixed_dictionaries(
    {
        "stories": st.integers(1, 6),
        "physics_step": st.sampled_from([1e-3, 5e-4]),
        "control_rate": st.sampled_from([100.0, 200.0, 500.0]),
        "fields": st.sampled_from([{}, {"noise_directions": 1}, {"noise_directions": None}]),
        "nonlinearity": st.sampled_from(
            [Nonlinearity(), LABORATORY, Nonlinearity(yielding=Yielding(yield_drift=0.002))]
        ),
        "delay": st.sampled_from([0, 2, 2.5, 13]),
        "uncertainty": st.sampled_from(
            [
                Uncertainty(),
                Uncertainty(
                    mass_ratio=Uniform(0.1, 1.0),
                    coulomb_friction=Uniform(50.0, 300.0),
                    delay=Uniform(0.0, 4.0),
                ),
            ]
        ),
        "sensing": st.sampled_from(
            [
                Sensing(),
                Sensing(preview=0.1, last_action=True),
                Sensing.laboratory(),
                Sensing(sensors=NOISY, preview=0.05, preview_spacing=0.001, history=3),
                Sensing(sensors=NOISY[1:2], last_action=True, history=2),
            ]
        ),
        "limits": st.sampled_from(
            [
                Limits(),
                Limits.laboratory(),
                Limits(table_velocity=0.05, current=0.05, soft_weight=2.0, cost_horizon=0.2),
                Limits(specimen_acceleration=1.0, table_acceleration=2.0, state_limit=5.0),
            ]
        ),
        "motion": st.sampled_from(
            [
                FilteredNoise(duration=0.5),
                FilteredNoise(duration=0.4, amplitude=0.3, envelope=Envelope(rise=0.2, hold=0.1)),
                RecordedMotion(record="ridgecrest2019_ccc_90", duration=0.6),
            ]
        ),
    }
)


def pair(scenario, lanes):
    """Return a simulation that steps compiled, and one that steps the readable model."""
    compiled = Simulation(scenario, lanes)
    assert not isinstance(compiled.engine, ReferenceEngine)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(numba_support, "COMPILED", False)
        plain = Simulation(scenario, lanes)
    assert isinstance(plain.engine, ReferenceEngine)
    if (
        compiled.plant_batch is not None
    ):  # whose plants dynamics/test_drawn_plants.py holds equal to arrays'
        compiled.plant_batch._compiled = None
    return compiled, plain


def uncompiled(call):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(numba_support, "COMPILED", False)
        return call()


def streams(lanes, seed):
    return [np.random.default_rng([seed, lane]) for lane in lanes]


def close(ours, theirs, size=None):
    # Sums run in another order than BLAS's: 1e-15 a step, which 70 steps of a friction loop magnify.
    size = np.max(np.abs(theirs), initial=0.0) if size is None else size
    assert np.all(np.abs(ours - theirs) <= 1e-11 * np.maximum(np.abs(theirs), size))


@settings(max_examples=40, deadline=None)
@given(
    options=SCENARIOS,
    lanes=st.sampled_from([1, 2, 5, BLOCK + 3]),
    seed=st.integers(0, 2**16),
)
def test_compiled_and_readable_engine_agree(options, lanes, seed):
    scenario = make_scenario("linear", options)
    compiled, plain = pair(scenario, lanes)
    ours = compiled.start(range(lanes), streams(range(lanes), seed))
    theirs = uncompiled(lambda: plain.start(range(lanes), streams(range(lanes), seed)))
    np.testing.assert_array_max_ulp(ours, theirs, 1)
    scale = controlled_scale(scenario.plant, scenario.nonlinearity)
    scale = np.concatenate(
        [scale, np.full(compiled.state.shape[1] - len(scale), scenario.current_limit)]
    )
    rng = np.random.default_rng(seed)
    running = np.ones(lanes, dtype=bool)
    for t in range(70):
        action = rng.normal(0.0, 0.3, lanes)
        mine = compiled.step(action)
        model = uncompiled(lambda action=action: plain.step(action))
        np.testing.assert_array_equal(mine.terminated, model.terminated)
        np.testing.assert_array_equal(mine.truncated, model.truncated)
        for name in ("reward", "limit_cost"):
            close(getattr(mine, name)[running], getattr(model, name)[running])
        a, b = mine.outcome, model.outcome
        np.testing.assert_array_equal(a.broken[running], b.broken[running])
        for name in ("acceleration", "force", "current"):
            close(getattr(a.cost, name)[running], getattr(b.cost, name)[running])
        for name in ("state", "table_acceleration", "base_shear"):
            x, y = getattr(a.response, name), getattr(b.response, name)
            assert x.shape == y.shape
            # A sum of large terms may cross zero: beside the size of what is summed.
            size = scale if name == "state" else np.abs(y).max(axis=-1, keepdims=True)[running]
            strained = np.maximum(np.abs(b.response.state[running] / scale).max(axis=-1), 1.0)
            close(x[running], y[running], size * strained[:, None])
        assert (a.floors is None) == (b.floors is None)
        for name in ("ground", "target", "reference_shear", "preview"):
            x, y = getattr(mine.ground, name), getattr(model.ground, name)
            assert (x is None) == (y is None)
            if x is not None:
                close(x, y)
        # A value at the middle of two floats, or of two steps of a sensor, may fall to either side.
        apart = np.abs(mine.observation - model.observation)[running]
        assert np.all(apart <= 2e-6 * (1.0 + np.abs(model.observation[running])))
        running &= ~(mine.terminated | mine.truncated)
        if t == 40:  # some begin anew, in the middle of a block
            anew = list(range(0, lanes, 2))
            compiled.start(anew, streams(anew, seed + 1))
            uncompiled(lambda anew=anew: plain.start(anew, streams(anew, seed + 1)))
            running[anew] = True
        # What has ended is put to rest, as by a roll-out: a table far beyond its limits may overflow.
        for one in (compiled, plain):
            one.rest(~running)


def test_a_step_alone_says_what_a_step_says():
    scenario = make_scenario("laboratory", {"duration": 0.5})
    one, other = Simulation(scenario, 1), Simulation(scenario, 1)
    for sim in (one, other):
        sim.start([0], streams([0], 3))
    for t in range(100):
        action = 0.3 * (-1.0) ** (t // 10)
        seen, report, ended = one.engine.step_alone(action)
        result = other.step(np.array([action]))
        np.testing.assert_array_equal(seen, result.observation[0])
        assert report == result.report[:, 0].tolist() and ended == result.ended
        assert (ended == 2) == (t == 99)


@pytest.mark.parametrize("name", ["linear", "as-printed", "laboratory", "yielding", "records"])
def test_a_table_is_the_same_to_the_bit_in_any_batch(name):
    """Alone, in a block and in two; beside a table that begins anew in the middle of its episode."""
    scenario, lanes, lane = make_scenario(name, {}), BLOCK + 5, BLOCK + 1
    batch, alone = Simulation(scenario, lanes), Simulation(scenario, 1)
    few = Simulation(scenario, 3)
    first = batch.start(range(lanes), streams(range(lanes), 1))[lane]
    np.testing.assert_array_equal(alone.start([0], streams([lane], 1))[0], first)
    np.testing.assert_array_equal(few.start([2], streams([lane], 1))[0], first)
    rng = np.random.default_rng(0)
    for t in range(80):
        action = rng.normal(0.0, 0.2, lanes)
        if t == 30:
            batch.start([lane - 1, 0], streams([99, 98], 1))
        result, small = batch.step(action), few.step(np.full(3, action[lane]))
        seen, report, _ = alone.engine.step_alone(action[lane])
        np.testing.assert_array_equal(result.observation[lane], seen)
        np.testing.assert_array_equal(result.report[:, lane], report)
        np.testing.assert_array_equal(small.report[:, 2], report)


def test_a_result_of_an_earlier_period_is_refused():
    sim = Simulation(make_scenario("linear"), 3)
    sim.start(range(3), streams(range(3), 0))
    result = sim.step(np.zeros(3))
    sim.step(np.zeros(3))
    with pytest.raises(ScenarioError, match="before the next step"):
        _ = result.outcome


def test_a_snapshot_of_one_engine_goes_on_in_the_other():
    scenario = make_scenario("yielding", {"duration": 2.0})
    compiled, plain = pair(scenario, 3)
    compiled.start(range(3), streams(range(3), 0))
    for _ in range(30):
        compiled.step(np.full(3, 0.1))
    plain.set_state(pickle.loads(pickle.dumps(compiled.get_state())))
    for _ in range(30):
        ours, theirs = compiled.step(np.full(3, 0.1)), uncompiled(lambda: plain.step(np.full(3, 0.1)))
        np.testing.assert_allclose(ours.observation, theirs.observation, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
@pytest.mark.parametrize("name", ["linear", "laboratory", "unknown-specimen"])
def test_a_copy_goes_on_as_its_original_and_apart_from_it(name, duplicate):
    original = Simulation(make_scenario(name, {"duration": 1.0}), 3)
    original.start(range(3), streams(range(3), 0))
    for _ in range(70):
        original.step(np.full(3, 0.2))
    twin, still = duplicate(original), duplicate(original)
    for _ in range(70):
        ours, theirs = original.step(np.full(3, 0.2)), twin.step(np.full(3, 0.2))
        np.testing.assert_array_equal(ours.observation, theirs.observation)
    np.testing.assert_array_equal(still.step_count, 70)
    for sim in (original, twin):
        sim.start([1], streams([1], 5))
        sim.step(np.zeros(3))
    np.testing.assert_array_equal(original.state, twin.state)


def test_results_stay_what_they_were():
    sim = Simulation(make_scenario("laboratory"), 2)
    sim.start(range(2), streams(range(2), 0))
    result = sim.step(np.full(2, 0.3))
    parts = [result.reward, result.observation, result.terminated, result.outcome.response.state]
    kept = [part.copy() for part in parts]
    memory = {f.name: getattr(sim.memory, f.name) for f in fields(sim.memory)}
    before = copy.deepcopy(memory)
    sim.start([0], streams([0], 1))
    for _ in range(5):
        sim.step(np.full(2, -0.2))
    for part, was in zip(parts, kept, strict=True):
        np.testing.assert_array_equal(part, was)
    for key, was in before.items():
        np.testing.assert_array_equal(memory[key], was)


def test_info_has_its_keys_in_order():
    env = gymnasium.make("shake_env:ShakeTable-laboratory-v0")
    env.reset(seed=0)
    info = env.step(np.array([0.5], dtype=np.float32))[-1]
    assert tuple(info) == INFO_KEYS and all(type(value) is float for value in info.values())
    assert info["current"] == pytest.approx(0.5 * env.unwrapped.scenario.current_limit)


def test_without_numba_the_model_steps(monkeypatch):
    numba_support._load.cache_clear()
    monkeypatch.setitem(sys.modules, "shake_env.simulation.compiled_engine", None)
    try:
        sim = Simulation(make_scenario("laboratory"), 2)
        assert isinstance(sim.engine, ReferenceEngine)
        sim.start(range(2), streams(range(2), 0))
        assert np.all(sim.step(np.full(2, 0.3)).reward < 0.0)
    finally:
        numba_support._load.cache_clear()


@pytest.mark.parametrize("compiled", [True, False])
def test_an_action_of_single_precision_is_the_same_number(compiled, monkeypatch):
    """As the vector environments hand it over."""
    monkeypatch.setattr(numba_support, "COMPILED", compiled)
    action = np.array([0.1, -0.7, 0.3], dtype=np.float32)
    rewards = []
    for each in (action, action.astype(float)):
        sim = Simulation(make_scenario("laboratory"), 3)
        sim.start(range(3), [np.random.default_rng(i) for i in range(3)])
        rewards.append([sim.step(each).reward.copy() for _ in range(5)])
    np.testing.assert_array_equal(*rewards)


@pytest.mark.parametrize("compiled", [True, False])
def test_a_sharp_knee_stays_finite(compiled, monkeypatch):
    monkeypatch.setattr(numba_support, "COMPILED", compiled)
    law = Yielding(yield_drift=0.001, exponent=20.0)
    options = {"nonlinearity": Nonlinearity(yielding=law), "amplitude": 2.0, "duration": 5.0}
    scenario = replace(make_scenario("yielding", options), limits=Limits())
    sim = Simulation(scenario, 8)
    sim.start(range(8), streams(range(8), 0))
    rng = np.random.default_rng(0)
    largest = fastest = 0.0
    for _ in range(1000):
        result = sim.step(rng.normal(0.0, 1.0, 8))
        assert np.isfinite(result.ground.reference).all() and np.isfinite(result.reward).all()
        state = result.outcome.response.state
        drift = np.diff(state[:, 4:6], axis=1, prepend=0.0)
        largest = max(largest, np.abs(drift - state[:, 8:10]).max())
        fastest = max(fastest, np.abs(np.diff(state[:, 6:8], axis=1, prepend=0.0)).max())
    # Beyond the yield drift z stands still: it overshoots by what one step drifts, whose rate may be
    # somewhat above the largest seen at the periods' ends.
    assert law.yield_drift < largest < law.yield_drift + 1.5 * scenario.physics_step * fastest


def test_threads_do_not_change_a_bit():
    scenario, lanes = make_scenario("linear", {"duration": 0.1}), 1100
    one, two = Simulation(scenario, lanes), Simulation(scenario, lanes, threads=2)
    assert len(two.engine._helpers._turns) == 1 and not one.engine._helpers
    few = Simulation(scenario, 100, threads=2)
    assert not few.engine._helpers
    for sim in (one, two):
        sim.start(range(lanes), streams(range(lanes), 0))
    rng = np.random.default_rng(0)
    for _ in range(20):
        action = rng.normal(0.0, 0.2, lanes)
        ours, theirs = two.step(action), one.step(action)
        np.testing.assert_array_equal(ours.report, theirs.report)
        np.testing.assert_array_equal(ours.observation, theirs.observation)
        assert ours.ended == theirs.ended
    assert theirs.ended and ours.truncated.all()
    twin = pickle.loads(pickle.dumps(two))
    twin.start([1090], streams([5], 5))
    two.start([1090], streams([5], 5))
    np.testing.assert_array_equal(twin.step(action).report, two.step(action).report)


@pytest.mark.parametrize("lanes", [1, 5])
def test_the_fields_engines_agree(lanes):
    """Every lane has a supply, a valve, storeys and sensor gains of its own."""
    scenario = make_scenario("field", {"duration": 0.5})
    compiled, plain = pair(scenario, lanes)
    ours = compiled.start(range(lanes), streams(range(lanes), 3))
    theirs = uncompiled(lambda: plain.start(range(lanes), streams(range(lanes), 3)))
    np.testing.assert_array_max_ulp(ours, theirs, 1)
    assert (
        len({plant.nonlinearity.valve.supply_pressure for plant in compiled.plant_batch.plants}) == lanes
    )
    gain = compiled.memory.gain
    np.testing.assert_allclose(gain, plain.memory.gain)
    assert 0.0 < np.abs(gain).max() < 0.06
    rng = np.random.default_rng(1)
    for _ in range(90):
        action = rng.uniform(-0.3, 0.3, lanes)
        ours = compiled.step(action)
        theirs = uncompiled(lambda action=action: plain.step(action))
        close(compiled.state, plain.state, np.abs(plain.state).max(axis=0))
        close(ours.report, theirs.report, np.abs(theirs.report).max(axis=1, keepdims=True))
        np.testing.assert_allclose(ours.observation, theirs.observation, rtol=2e-6, atol=1e-6)
