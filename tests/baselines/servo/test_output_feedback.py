"""The sampled nominal table, linear laws on measured signals, and PID."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.servo.output_feedback import LinearLaw, NominalTable, OutputFeedback, SampledClosedLoop
from baselines.servo.pid import PIDGains, PIDRule, pid, pid_law, ultimate_point
from baselines.servo.signals import SIGNALS, TABLE_SIGNALS, SignalReader
from shake_env.errors import NumericalError, ParameterError, ScenarioError
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.scenario.limits import Limits
from shake_env.scenario.observation import Sensing, Sensor
from shake_env.scenario.overrides import make_scenario
from shake_env.scenario.presets import laboratory
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.simulation import Simulation


def linear_laboratory(**changes):
    """The laboratory's delay, preview and target on a linear table without sensor errors."""
    quiet = Sensing(sensors=tuple(Sensor(signal=name) for name in TABLE_SIGNALS), preview=0.1)
    plain = replace(laboratory(), nonlinearity=Nonlinearity(), sensing=quiet, limits=Limits())
    return replace(plain, **changes)


@pytest.mark.parametrize("delay", [0.0, 2.5, 5.0, 7.3])
def test_nominal_table_is_the_simulated_one(delay):
    scenario = linear_laboratory(delay=delay)
    table, simulation = NominalTable.from_scenario(scenario), Simulation(scenario, 1)
    simulation.start([0], [np.random.default_rng(0)])
    rng, x = np.random.default_rng(1), np.zeros(len(table.G))
    for _ in range(50):
        action = rng.uniform(-1.0, 1.0, 1)
        result = simulation.step(action)
        x = table.F @ x + table.G * action[0] * scenario.current_limit
        y = table.C @ x
        outcome = result.outcome.response
        assert y[2] == pytest.approx(outcome.table_acceleration[0, -1], rel=1e-7, abs=1e-9)
        assert y[5] == pytest.approx(outcome.base_shear[0, -1], rel=1e-7, abs=1e-6)
        np.testing.assert_allclose(y[[3, 0, 1, 4]], outcome.state[0, :4], rtol=1e-7, atol=1e-9)


def test_measured_and_full_state_give_the_same_signals():
    measured = linear_laboratory(delay=0)
    full = replace(measured, sensing=Sensing())
    shown = [Simulation(s, 2) for s in (measured, full)]
    readers = [SignalReader(s) for s in (measured, full)]
    observations = [sim.start(range(2), [np.random.default_rng(i) for i in range(2)]) for sim in shown]
    rng = np.random.default_rng(5)
    for _ in range(100):
        one, two = (r.read(o, np.zeros((2, 2)))[0] for r, o in zip(readers, observations, strict=True))
        # Both come through float32 observations; the acceleration is a small sum of large terms.
        assert np.all(np.abs(one - two) <= 2e-4 * np.abs(one).max(axis=0) + 1e-6)
        action = rng.uniform(-0.5, 0.5, 2)
        observations = [sim.step(action).observation for sim in shown]


def test_target_signals_are_derivatives_of_each_other():
    for scenario in (linear_laboratory(), Scenario(delay=2)):
        simulation, reader = Simulation(scenario, 1), SignalReader(scenario)
        observation = simulation.start([0], [np.random.default_rng(3)])
        memory, found = np.zeros((1, 2)), []
        for _ in range(400):
            signals, memory = reader.read(observation, memory)
            found.append(signals[0])
            observation = simulation.step(np.zeros(1)).observation
        acceleration, velocity, displacement = np.array(found)[:, 5:].T
        period, amplitude = scenario.control_period, scenario.motion.amplitude
        for rate, value in ((acceleration, velocity), (velocity, displacement)):
            missed = np.diff(value) - 0.5 * period * (rate[1:] + rate[:-1])
            # The acceleration's slope is white noise of intensity s = 2 zeta omega: of each period the
            # trapezoid misses a Brownian bridge's integral, of variance s^2 T^3 / 12. Five of those.
            slope = 2.0 * scenario.ground.damping_ratio * scenario.ground.omega * amplitude
            bridge = slope * np.sqrt(period**3 / 12.0)
            assert np.max(np.abs(missed)) < 5.0 * bridge * (1.0 if rate is acceleration else period)


def test_a_signal_that_is_needed_must_be_measured():
    few = Sensing(sensors=(Sensor(signal="table_displacement"),))
    scenario = replace(laboratory(), sensing=few)
    with pytest.raises(ScenarioError, match="load_pressure"):
        SignalReader(scenario)
    gains = PIDGains(proportional=0.5, integral_time=1.0, derivative_time=0.0)
    assert pid(scenario, gains).predict(np.ones(scenario.observation.size))[0].shape == (1,)


def steady_ramp_error(scenario, gains):
    """Error [m] after 15 s of a ramp of 0.1 m/s, through the controller and the simulated table."""
    controller, simulation = pid(scenario, gains), Simulation(scenario, 1)
    simulation.start([0], [np.random.default_rng(0)])
    velocity, ground = 0.1, scenario.ground
    scale = scenario.plant.state_scale
    x_w = velocity / (2.0 * ground.damping_ratio * ground.omega)
    full, memory = np.zeros(scenario.observation.size), None
    for step in range(3_000):
        full[:2] = x_w / scale[0], 0.0
        controlled = simulation.model.controlled
        full[2 : 2 + controlled] = simulation.state[0, :controlled] / scale[2 : 2 + controlled]
        action, memory = controller.predict(full, memory, np.array([step == 0]))
        simulation.step(action.astype(float))
    target = velocity * scenario.control_period * 3_000
    return target - simulation.state[0, 1]


def test_integral_action_leaves_no_steady_error_to_a_ramp():
    scenario = make_scenario("linear")
    k_p = 2.0 * np.pi * 1.0 / scenario.actuator.velocity_gain
    without = PIDGains(proportional=k_p, integral_time=np.inf, derivative_time=0.0)
    with_it = replace(without, integral_time=0.8)
    period = scenario.control_period
    # Type 1: the error that makes the ramp's velocity; the target is one trapezoid's half step and the
    # hold behind.
    assert steady_ramp_error(scenario, without) == pytest.approx(0.1 / (2.0 * np.pi), rel=0.04)
    # The last target that was acted on is one period old.
    assert abs(steady_ramp_error(scenario, with_it)) < 0.1 * period * 1.01


def test_ultimate_gain_is_where_the_closed_loop_begins_to_oscillate():
    scenario = linear_laboratory()
    point, table = ultimate_point(scenario), NominalTable.from_scenario(scenario)
    for factor, stable in ((0.999, True), (1.001, False)):
        D = np.zeros(SIGNALS)
        D[0], D[7] = -factor * point.gain, factor * point.gain
        assert (SampledClosedLoop(table, LinearLaw.static(D)).radius < 1.0) is stable
    # Nyquist at that frequency: the open loop passes through -1.
    open_loop = point.gain * table.response(np.array([1.0 / point.period]))[0, 0]
    assert open_loop == pytest.approx(-1.0, abs=1e-3)


def test_rules_make_stable_loops_or_say_so():
    scenario = linear_laboratory()
    table = NominalTable.from_scenario(scenario)
    for rule in (PIDRule(bandwidth=1.0), PIDRule(share=0.2)):
        law = pid_law(rule.gains(scenario), scenario.control_period)
        assert SampledClosedLoop(table, law).radius < 1.0
    with pytest.raises(NumericalError, match="lower share"):
        PIDRule(share=0.6).gains(scenario)  # Ziegler and Nichols' own share rings the oil column
    with pytest.raises(ParameterError, match="give one"):
        PIDRule()


def test_closed_loop_response_is_what_a_simulated_sine_shows():
    scenario = linear_laboratory()
    gains = PIDRule(bandwidth=1.0).gains(scenario)
    frequency = 6.0
    loop = SampledClosedLoop(
        NominalTable.from_scenario(scenario), pid_law(gains, scenario.control_period)
    )
    controller, simulation = pid(scenario, gains), Simulation(scenario, 1)
    simulation.start([0], [np.random.default_rng(0)])
    reader_rows = SignalReader(scenario).rows[:4, 5:]  # x_W to target signals
    omega, memory, found = 2.0 * np.pi * frequency, None, []
    observation = np.zeros((1, scenario.observation.size))
    steps, period = 3000, scenario.control_period
    for step in range(steps):
        phase = np.exp(1j * omega * step * period)
        target = np.array([phase, phase / (1j * omega), -phase / omega**2]).real
        observation[0, :4] = np.linalg.lstsq(reader_rows.T, target, rcond=None)[0]
        action, memory = controller.predict(observation, memory, np.array([step == 0]))
        result = simulation.step(action[:, 0].astype(float))
        observation = result.observation.copy()
        found.append(result.outcome.response.table_acceleration[0, -1])
    tail = np.array(found[-1000:])
    times = period * (np.arange(steps - 1000, steps) + 1)
    measured = 2.0 * np.mean(tail * np.exp(-1j * omega * times))
    assert measured == pytest.approx(loop.response(np.array([frequency]))[0], rel=2e-3)


def test_saturation_does_not_wind_the_integral_up():
    scenario = linear_laboratory()
    gains = PIDGains(proportional=0.5, integral_time=0.5, derivative_time=0.0)
    controller = OutputFeedback(scenario, pid_law(gains, scenario.control_period), ())
    far = np.zeros(scenario.observation.size)
    far[2] = 0.5 / scenario.plant.state_scale[2]  # half a metre: far beyond the current limit
    memory = None
    for _ in range(2000):
        action, memory = controller.predict(far, memory)
    assert action[0] == 1.0
    # Back-calculation settles where the integral's share and the excess balance: within the error's own
    # proportional command, not at 10 s of error.
    assert abs(memory[0][2]) < 0.6
