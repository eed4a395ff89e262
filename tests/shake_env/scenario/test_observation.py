"""What a controller is shown: readings against signals, preview against what comes, lanes as alone."""

from dataclasses import replace
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from scipy.signal import lfilter

from shake_env import SCENARIO_NAMES, FilteredNoise, RecordedMotion, Sensing, Sensor, make_scenario
from shake_env.dynamics.linear import as_like
from shake_env.dynamics.low_pass import LowPass, with_low_passes
from shake_env.dynamics.nonlinear import NonlinearDynamics, arrival
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.discretization import zero_order_hold
from shake_env.model.nonlinearity import Friction, Nonlinearity, Yielding
from shake_env.model.plant import StateSpace
from shake_env.scenario.observation import UNITS
from shake_env.simulation.simulation import Simulation
from shake_env.simulation.transition import TableModel


def sensed(*sensors, scenario="linear", duration=2.0, **shown):
    sensing = Sensing(sensors=sensors or None, **shown)
    return make_scenario(scenario, {"sensing": sensing, "duration": duration})


def follow(scenario, steps, lanes=1, seeds=None, motions=None, size=0.05):
    """Step tables under seeded random actions; return observations, results and first observation."""
    simulation = Simulation(scenario, lanes)
    seeds = range(lanes) if seeds is None else seeds
    streams = [np.random.default_rng(seed) for seed in seeds]
    first = simulation.start(range(lanes), streams, motions)
    rng = np.random.default_rng(99)
    results, actions = [], []
    for _ in range(steps):
        actions.append(rng.uniform(-size, size))
        result = simulation.step(np.full(lanes, actions[-1]))
        # The ground is a view that later steps write over.
        ground = replace(result.ground, target=result.ground.target.copy())
        kept = {name: getattr(result, name) for name in ("observation", "reward", "outcome")}
        results.append(SimpleNamespace(**kept, ground=ground))
    observations = np.array([result.observation for result in results], dtype=float)
    return simulation, first, observations, results, np.array(actions)


ALL = tuple(Sensor(signal=name) for name in UNITS)


def test_readings_without_errors_are_the_signals():
    scenario = sensed(*ALL)
    _, _, seen, results, _ = follow(scenario, 60)
    layout = scenario.observation
    readings = seen[:, 0, layout.readings] * layout.reading_scale
    response = [result.outcome.response for result in results]
    state = np.array([r.state[0] for r in response])
    expected = {
        "load_pressure": state[:, 0],
        "table_displacement": state[:, 1],
        "table_velocity": state[:, 2],
        "spool_position": state[:, 3],
        "table_acceleration": np.array([r.table_acceleration[0, -1] for r in response]),
        "base_shear": np.array([r.base_shear[0, -1] for r in response]),
    }
    for name, values in expected.items():
        found = readings[:, layout.reading_names.index(name)]
        np.testing.assert_allclose(found, values, atol=3e-7 * np.max(np.abs(values)), err_msg=name)


@pytest.mark.parametrize("parts", [Nonlinearity(), Nonlinearity(yielding=Yielding(yield_drift=0.002))])
def test_floor_accelerations_carry_the_base_shear(parts):
    """Newton for the specimen: what its floors' masses need is what the table gives, f_s = -sum m a."""
    sensing = Sensing(sensors=(Sensor(signal="floor_accelerations"), Sensor(signal="base_shear")))
    options = {"sensing": sensing, "stories": 3, "nonlinearity": parts, "duration": 2.0}
    scenario = make_scenario("linear", options)
    _, _, seen, results, _ = follow(scenario, 100, size=0.3)
    layout = scenario.observation
    readings = seen[:, 0, layout.readings] * layout.reading_scale
    force = readings[:, :3] @ np.asarray(scenario.specimen.masses)
    shear = np.array([result.outcome.response.base_shear[0, -1] for result in results])
    assert np.max(np.abs(shear)) > 100.0
    np.testing.assert_allclose(-force, shear, atol=1e-5 * np.max(np.abs(shear)))


@pytest.mark.parametrize("frequency", [20.0, 40.0, 80.0])
def test_a_sinusoid_comes_out_with_the_low_passs_gain_and_phase(frequency):
    omega = 2.0 * np.pi * frequency
    A = np.zeros((4, 4))  # an oscillator for the table's place and velocity
    A[1, 2], A[2, 1] = 1.0, -(omega**2)
    table = StateSpace(A, np.zeros((4, 1)), np.zeros((2, 4)), np.zeros((2, 1)))
    model = zero_order_hold(
        with_low_passes(table, [LowPass("table_displacement", 80.0, 1.0)], 4), 1e-3, np.ones(5)
    )
    state, out = np.array([0.0, 0.0, omega, 0.0, 0.0]), []
    for _ in range(400):
        state = model.A @ state
        out.append(state[4])
    time = 1e-3 * np.arange(1, 401)
    response = 1.0 / (1.0 + 1j * frequency / 80.0)
    expected = np.abs(response) * np.sin(omega * time + np.angle(response))
    np.testing.assert_allclose(out[200:], expected[200:], atol=1e-9)  # the start has died away


@pytest.mark.parametrize("name", ["table_acceleration", "base_shear"])
def test_the_low_pass_is_an_analogue_filter_of_the_signal_between_samples(name):
    """Against the filter on a grid of 10 us under the table's own response, straight between its steps.

    Sampled at the control rate only, as it was, the filter was off by 0.2 m/s^2 rms in this run.
    """
    sensing = Sensing(sensors=(Sensor(signal=name, lowpass_frequency=80.0),))
    scenario = make_scenario("laboratory", {"sensing": sensing, "duration": 3.0})
    _, _, seen, results, _ = follow(scenario, 600, size=0.3)
    response = np.concatenate([getattr(each.outcome.response, name)[0] for each in results])
    fine = 100
    signal = np.interp(np.arange(1, 3000 * fine + 1) / fine, np.arange(3001), [0.0, *response])
    share = 1e-5 * 2.0 * np.pi * 80.0  # trapezoids
    filtered = lfilter(
        np.array([share, share]) / (2.0 + share), [1.0, -(2.0 - share) / (2.0 + share)], signal
    )
    expected = filtered[5 * fine - 1 :: 5 * fine]
    reading = seen[:, 0, scenario.observation.readings.start] * scenario.observation.reading_scale[0]
    error = np.sqrt(np.mean((reading - expected) ** 2)) / np.sqrt(np.mean(expected**2))
    assert error < 5e-3  # the response is not straight between its steps: its stiff oil column
    held = np.sqrt(np.mean((response[4::5] - expected) ** 2)) / np.sqrt(np.mean(expected**2))
    assert held > 20.0 * error


@pytest.mark.parametrize("name", ["spool_position", "load_pressure", "floor_accelerations"])
def test_low_passes_of_other_signals_too(name):
    quick, slow = (sensed(Sensor(signal=name, lowpass_frequency=f)) for f in (1e5, 20.0))
    plain = sensed(Sensor(signal=name))
    first = plain.observation.readings.start
    readings = [follow(each, 120, size=0.3)[2][:, 0, first] for each in (plain, quick, slow)]
    np.testing.assert_allclose(readings[1], readings[0], atol=5e-3 * np.abs(readings[0]).max())
    omega = 2.0 * np.pi * 20.0
    # f' = omega (s - f), by differences of what is read: close, as the signal is smooth beside 5 ms.
    slope = np.diff(readings[2]) / 5e-3
    pull = omega * (readings[0] - readings[2])
    middle = 0.5 * (pull[1:] + pull[:-1])
    assert np.corrcoef(slope, middle)[0, 1] > 0.97


def test_noise_offset_and_rounding_are_as_stated():
    sensor = Sensor(signal="table_velocity", noise=0.01, bias=0.05)
    lanes, steps = 400, 200
    scenario = sensed(sensor)
    _, _, seen, results, _ = follow(scenario, steps, lanes)
    layout = scenario.observation
    velocity = np.array([result.outcome.response.state[:, 2] for result in results])
    error = seen[:, :, layout.readings.start] * layout.reading_scale[0] - velocity
    offset = error.mean(axis=0)
    # Standard errors: of the offset's spread 1 / sqrt(2 lanes), of the noise's 1 / sqrt(2 samples).
    assert np.std(offset) == pytest.approx(0.05, rel=4.0 / np.sqrt(2 * lanes))
    noise = error - offset
    assert np.std(noise) == pytest.approx(0.01, rel=0.01)
    white = np.mean(noise[1:] * noise[:-1]) / np.var(noise)
    assert abs(white) < 4.0 / np.sqrt(lanes * steps) + 1.0 / steps  # 1/steps: the offset is estimated
    rounded = sensed(Sensor(signal="table_velocity", noise=0.01, resolution=0.004))
    _, _, seen, _, _ = follow(rounded, 50)
    counts = seen[:, 0, layout.readings.start] * layout.reading_scale[0] / 0.004
    assert len(set(np.round(counts))) > 5
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-4)  # float32 observations


def test_sensors_leave_ground_and_table_alone():
    plain = make_scenario("linear", {"duration": 2.0})
    noisy = sensed(Sensor(signal="table_velocity", noise=0.1, bias=0.1), last_action=True)
    *_, one, _ = follow(plain, 150, 3)
    *_, two, _ = follow(noisy, 150, 3)
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.outcome.response.state, b.outcome.response.state)
        np.testing.assert_array_equal(a.reward, b.reward)


@pytest.mark.parametrize(
    ("preview", "spacing"), [(0.1, None), (0.03, 0.002), (0.4, 0.05), (0.005, 0.001)]
)
@pytest.mark.parametrize("shown", ["full", "measured"])
def test_preview_is_the_target_that_comes(preview, spacing, shown):
    sensors = () if shown == "full" else (Sensor(signal="load_pressure"),)
    scenario = sensed(*sensors, preview=preview, preview_spacing=spacing)
    motions = [FilteredNoise(duration=2.0), RecordedMotion(record="napa2014_68150_hne", duration=2.0)]
    _, first, seen, results, _ = follow(scenario, 300, 2, motions=motions)
    layout = scenario.observation
    target = np.concatenate([result.ground.target.T for result in results])
    unit = np.sqrt(scenario.plant.target_variance)
    shown_ahead = np.concatenate([first[None], seen])[:, :, layout.preview] * unit
    stride = round((spacing or 0.001) / 0.001)  # None: the physics step
    assert shown_ahead.shape[-1] == round(preview / (spacing or 0.001))
    for step in range(0, 200):
        for sample in range(shown_ahead.shape[-1]):
            at = step * 5 + (sample + 1) * stride - 1
            expected = target[at]
            assert np.max(np.abs(shown_ahead[step, :, sample] - expected)) < 1e-5


def test_preview_survives_a_reset_of_one_lane():
    """A lane that restarts anywhere in the block sees and gets what it does alone."""
    scenario = sensed(preview=0.2, duration=5.0)
    alone = Simulation(scenario, 1)
    expected = [alone.start([0], [np.random.default_rng(5)])[0]]
    for _ in range(90):
        expected.append(alone.step(np.zeros(1)).observation[0])
    for wait in (0, 1, 40, 63, 64, 65, 127, 128):
        simulation = Simulation(scenario, 3)
        simulation.start(range(3), [np.random.default_rng(i) for i in range(3)])
        for _ in range(wait):
            simulation.step(np.zeros(3))
        found = [simulation.start([1], [np.random.default_rng(5)])[0]]
        for _ in range(90):
            found.append(simulation.step(np.zeros(3)).observation[1])
        np.testing.assert_allclose(found, expected, atol=1e-5)


def test_history_and_last_action_are_what_was_shown_before():
    sensors = (Sensor(signal="table_velocity", noise=0.01), Sensor(signal="load_pressure"))
    scenario = sensed(*sensors, last_action=True, history=3)
    layout = scenario.observation
    _, first, seen, _, actions = follow(scenario, 40)
    assert layout.size == 2 + 2 + 1 + 3 * 3
    shown = np.concatenate([first, seen[:, 0]])
    np.testing.assert_allclose(shown[1:, layout.last_action.start], actions, atol=1e-7)
    entries = np.concatenate([shown[:, layout.readings], shown[:, layout.last_action]], axis=1)
    for step in range(4, 41):
        expected = np.concatenate([entries[step - back] for back in (1, 2, 3)])
        np.testing.assert_array_equal(shown[step, layout.history], expected)
    assert not shown[0, layout.history].any()
    assert len(layout.names) == layout.size
    assert layout.names[layout.history][3:6] == (
        "measured table_velocity, 2 periods ago [m/s]",
        "measured load_pressure, 2 periods ago [Pa]",
        "last action, 2 periods ago [-]",
    )


def test_a_lane_is_reproducible_on_its_own():
    scenario = make_scenario("laboratory", {"duration": 2.0})
    *_, wide, _, _ = follow(scenario, 200, 4, seeds=[3, 4, 5, 6])
    *_, alone, _, _ = follow(scenario, 200, 1, seeds=[5])
    np.testing.assert_allclose(wide[:, 2], alone[:, 0], atol=1e-6)  # float32 observations


def test_snapshot_goes_on_exactly():
    scenario = make_scenario("laboratory", {"duration": 4.0, "fields": {"sensing.history": 2}})
    simulation, *_ = follow(scenario, 70, 3)
    kept = simulation.get_state()
    once = [simulation.step(np.full(3, 0.05)).observation for _ in range(150)]
    other = Simulation(scenario, 3)
    other.set_state(kept)
    again = [other.step(np.full(3, 0.05)).observation for _ in range(150)]
    np.testing.assert_array_equal(once, again)


def test_torch_reads_what_numpy_reads_and_lets_gradients_through():
    sensing = Sensing(
        sensors=(
            Sensor(signal="table_acceleration", noise=0.05, resolution=0.01, lowpass_frequency=60.0),
            Sensor(signal="floor_accelerations"),
        ),
        preview=0.05,
        last_action=True,
        history=2,
    )
    friction = Nonlinearity(friction=Friction(coulomb=150.0))
    options = {"sensing": sensing, "nonlinearity": friction, "delay": 2.5}
    scenario = make_scenario("linear", options)
    simulation, *_ = follow(scenario, 20, 2)
    like = torch.zeros(1, dtype=torch.float64)
    model = TableModel.from_scenario(scenario).to(like)
    state, memory = as_like(simulation.state, like), simulation.memory.to(like)
    action = torch.full((2,), 0.03, dtype=torch.float64, requires_grad=True)
    ground, noise = simulation.advance_ground()
    ground, noise = ground.to(like), as_like(noise, like)
    outcome = model.transition(state, action, ground)
    seen, _ = model.observe(outcome, ground, action, memory, noise)
    plain = TableModel.from_scenario(scenario)
    theirs = plain.transition(simulation.state, np.full(2, 0.03), _numpy(ground))
    expected, _ = plain.observe(
        theirs, _numpy(ground), np.full(2, 0.03), simulation.memory, noise.numpy()
    )
    np.testing.assert_allclose(seen.detach().numpy(), expected, rtol=1e-9, atol=1e-12)
    seen.sum().backward()
    assert torch.isfinite(action.grad).all() and (action.grad != 0.0).all()


def _numpy(ground):
    names = ("ground", "reference", "target", "reference_shear", "preview")
    return replace(ground, **{name: getattr(ground, name).numpy() for name in names})


@pytest.mark.parametrize("name", SCENARIO_NAMES)
def test_every_named_scenario_is_a_sound_environment(name):
    for env_id in ("shake_env:ShakeTable-v0", f"shake_env:ShakeTable-{name}-v0"):
        options = {"scenario": name} if env_id.endswith("ShakeTable-v0") else {}
        env = gymnasium.make(env_id, **options)
        assert env.unwrapped.scenario.name == name
        assert len(env.unwrapped.scenario.observation.names) == env.observation_space.shape[0]
        check_env(env.unwrapped, skip_render_check=True)
    envs = gymnasium.make_vec(
        f"shake_env:ShakeTable-{name}-v0", num_envs=3, vectorization_mode="vector_entry_point"
    )
    observation, _ = envs.reset(seed=1)
    for _ in range(80):
        observation, *_ = envs.step(np.full((3, 1), 0.02, dtype=np.float32))
    assert envs.observation_space.contains(observation)


def test_laboratory_is_what_the_specification_says():
    scenario = make_scenario("laboratory")
    assert scenario.nonlinearity.friction.coulomb == 150.0
    assert scenario.nonlinearity.valve.supply_pressure == 21e6
    assert scenario.delay * scenario.physics_step == pytest.approx(0.0025)
    assert scenario.sensing.preview == 0.1 and not scenario.sensing.full_state
    assert scenario.limits.table_displacement == 0.076 and scenario.limits.soft_weight > 0.0


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: Sensor(signal="speed"), "signal"),
        (lambda: Sensor(signal="base_shear", noise=-1.0), "noise"),
        (lambda: Sensor(signal="base_shear", lowpass_frequency=0.0), "lowpass_frequency"),
        (lambda: Sensing(history=2), "history"),
        (lambda: Sensing(sensors=()), "sensors"),
        (lambda: Sensing(sensors=(Sensor(signal="base_shear"),) * 2), "sensors"),
        (lambda: Sensing(preview=-0.1), "preview"),
        (lambda: Sensing.named("blind"), "sensing"),
        (lambda: sensed(preview=0.0123), "preview"),
        (lambda: sensed(preview=0.1, preview_spacing=0.0015), "preview_spacing"),
    ],
)
def test_bad_sensing_is_named(make, field):
    with pytest.raises(ParameterError, match=field):
        make()


def test_a_full_state_law_refuses_measured_signals():
    from baselines.lqr.sampled import lqr

    with pytest.raises(ScenarioError, match="lqg"):
        lqr(make_scenario("laboratory"))


def test_a_fractional_delay_is_the_finer_steps_delay():
    """2.5 steps of 1 ms against 5 of 0.5 ms: taking the mean current leaves an error of second order."""
    plant = make_scenario().plant
    assert np.allclose(arrival(2.5, 5, 1).sum(axis=1), 1.0)
    errors = []
    for refine in (1, 2):  # the coarse step is 1 ms / refine, with a delay of a whole number and a half
        delay = 2.5 if refine == 1 else 4.5
        coarse = NonlinearDynamics.from_plant(
            plant, Nonlinearity(), 1e-3 / refine, 5 * refine, delay=delay
        )
        fine = NonlinearDynamics.from_plant(
            plant, Nonlinearity(), 5e-4 / refine, 10 * refine, delay=2 * delay
        )
        rng = np.random.default_rng(1)
        a, b = np.zeros(coarse.states), np.zeros(fine.states)
        worst = size = 0.0
        for _ in range(60):
            u = np.asarray(rng.normal(0.0, 0.01))
            a, b = coarse.control_step(a, u).state, fine.control_step(b, u).state
            scaled = np.abs(np.stack([a - b, b])[:, :4]) / plant.state_scale[plant.layout.actuator]
            worst, size = max(worst, np.max(scaled[0])), max(size, np.max(scaled[1]))
        errors.append(worst / size)
    # Of a jump of current h^2 / (8 T_v^2) = 1.3e-3 is missing in the spool, and the oil column rings.
    assert errors[0] < 1e-2
    assert errors[1] < errors[0] / 3.0
