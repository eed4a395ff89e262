"""Kalman filter: its model against the simulation, its gain against other solvers, its statistics."""

from dataclasses import replace

import control
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import chi2

from baselines.estimation.estimator_model import EstimatorModel, ModelError
from baselines.estimation.kalman import KalmanFilter, stationary_filter
from shake_env import make_scenario
from shake_env.errors import NumericalError, ScenarioError
from shake_env.model.plant import TABLE_DISPLACEMENT
from shake_env.scenario.observation import Sensing, Sensor
from shake_env.simulation.simulation import Simulation

LEVEL = 1e-3  # of every statistical test here; seeds are fixed, so that it is met or not for good


def streams(lanes, seed=0):
    return [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(lanes)]


def every_signal(lowpass):
    names = (
        "load_pressure", "table_displacement", "table_velocity", "spool_position", "table_acceleration",
        "base_shear", "floor_accelerations",
    )  # fmt: skip
    return Sensing(sensors=tuple(Sensor(signal=name, lowpass_frequency=lowpass) for name in names))


def whiteness(innovations, lags):
    """Portmanteau statistic of Hosking (JASA 75, 1980) and its degrees of freedom; (lanes, steps, s)."""
    lanes, steps, s = innovations.shape
    scale = np.linalg.inv(np.einsum("lti,ltj->ij", innovations, innovations) / (lanes * steps))
    total = 0.0
    for lag in range(1, lags + 1):
        pairs = lanes * (steps - lag)
        C = np.einsum("lti,ltj->ij", innovations[:, lag:], innovations[:, :-lag]) / pairs
        total += pairs * np.trace(C.T @ scale @ C @ scale)
    return total, lags * s**2


@pytest.mark.parametrize("lowpass", [None, 80.0])
@pytest.mark.parametrize("delay", [0.0, 2.5, 5.0, 7.0, 12.3])
def test_the_model_is_the_simulation_without_its_noise(delay, lowpass):
    sensing = every_signal(lowpass)
    scenario = replace(make_scenario(), delay=delay, sensing=sensing)
    model = EstimatorModel.from_scenario(scenario, ModelError(force=1.0, flow=1e-8))
    simulation = Simulation(scenario, 3)
    observation = simulation.start(range(3), streams(3))
    rng = np.random.default_rng(1)
    x, given = np.zeros((3, model.order)), np.zeros((3, model.commands + 1))
    worst = size = 0.0
    for _ in range(200):
        action = rng.uniform(-0.2, 0.2, 3)
        given = np.concatenate([given[:, 1:], action[:, None]], axis=1)
        observation = simulation.step(action).observation
        x = x @ model.A.T + given @ model.B.T
        readings = observation[:, scenario.observation.readings]
        worst = max(worst, np.max(np.abs(x @ model.C.T - readings)))
        size = max(size, np.max(np.abs(readings)))
    # Readings come as float32, half a unit of whose last place is 6e-8.
    assert worst < 1e-6 * size


@pytest.mark.parametrize("delay", [0.0, 2.0, 2.5, 7.0, 10.0])
def test_ahead_is_the_simulation_up_to_the_delays_end(delay):
    # The state after `delay` physics steps, computed with a control period of one physics step.
    scenario = replace(make_scenario(), delay=delay, sensing=every_signal(None))
    model = EstimatorModel.from_scenario(scenario, ModelError(force=1.0, flow=1e-8))
    plant, rng = scenario.plant, np.random.default_rng(2)
    scale = plant.state_scale[plant.layout.controlled]
    n, k, dt = len(scale), scenario.substeps, scenario.physics_step
    x = rng.standard_normal(n)
    actions = rng.standard_normal(model.commands)
    believed = model.ahead @ np.concatenate([x, np.zeros(model.order - n), actions])
    # By hand: command i (negative: earlier) acts from i T + delay on; between changes, expm.
    A, B = plant.driven.A[:n, :n], plant.driven.B[:n, :1] * scenario.current_limit
    generator = np.zeros((n + 1, n + 1))
    generator[:n, :n], generator[:n, n:] = A * scale / scale[:, None], B / scale[:, None]
    time = 0.0
    for i in range(-model.commands, 0):
        end = (i + 1) * k + delay
        step = expm(generator * dt * max(end - max(time, 0.0), 0.0))
        x = step[:n, :n] @ x + step[:n, n] * actions[i]
        time = max(time, end)
    assert time == delay or (delay == 0.0 and model.commands == 0)
    assert believed == pytest.approx(x, rel=1e-9, abs=1e-9)


def test_process_noise_against_fine_steps():
    scenario = make_scenario("laboratory")
    error = ModelError(force=40.0, flow=1e-7, force_time=0.03, flow_time=0.08)
    model = EstimatorModel.from_scenario(scenario, error)
    # Acting alone, each disturbance has its stationary variance.
    places = [8, 9]
    A, Q = model.A[np.ix_(places, places)], model.Q[np.ix_(places, places)]
    stationary_variance = np.diag(Q) / (1.0 - np.diag(A) ** 2)
    plant = scenario.plant
    scale = plant.state_scale[plant.layout.controlled]
    sizes = np.array([scale[0] * plant.actuator.piston_area, scale[3]])
    assert np.sqrt(stationary_variance) * sizes == pytest.approx([40.0, 1e-7], rel=1e-9)
    # The covariance of a period is that of its tenths, carried on by the state matrix.
    whole = EstimatorModel.from_scenario(replace(scenario, delay=0.0), error)
    fine = replace(scenario, delay=0.0, control_rate=2000.0, physics_step=5e-4)
    part = EstimatorModel.from_scenario(fine, error)
    x = 10  # without low-pass and offset, whose periods differ
    P = np.zeros((x, x))
    for _ in range(10):
        P = part.A[:x, :x] @ P @ part.A[:x, :x].T + part.Q[:x, :x]
    assert whole.Q[:x, :x] == pytest.approx(P, rel=1e-6, abs=1e-12 * np.max(P))


@pytest.mark.parametrize(("name", "stories"), [("laboratory", 2), ("laboratory", 10), ("linear", 2)])
def test_stationary_gain_against_python_control_and_the_recursion(name, stories):
    scenario = make_scenario(name, {"stories": stories, "sensing": "laboratory"})
    model = EstimatorModel.from_scenario(scenario, ModelError.from_scenario(scenario))
    gain, P = stationary_filter(model)
    n = model.order
    predictor, P_control, _ = control.dlqe(
        model.A, np.eye(n), model.C, model.Q, np.diag(model.R), method="scipy"
    )
    # Both share scipy's Riccati solver, so that this checks forms and order; the recursion does not.
    assert model.A @ gain == pytest.approx(predictor, abs=1e-6 * np.max(np.abs(predictor)))
    assert pytest.approx(P_control, abs=1e-8 * np.max(P)) == P
    # The slowest pole of the filter (the offset's) is 0.999: 2e4 periods leave exp(-40) of the start.
    recursion = KalmanFilter.from_rest(model, 20_000)
    assert recursion.gains[-1] == pytest.approx(gain, abs=1e-6 * np.max(np.abs(gain)))


def test_innovations_are_white_at_the_design_noise_and_the_covariance_is_the_errors():
    scenario = make_scenario("laboratory")
    model = EstimatorModel.from_scenario(scenario, ModelError.from_scenario(scenario))
    kalman = KalmanFilter.from_model(model, warm_up=0)
    lanes, steps, s, rng = 400, 500, len(model.R), np.random.default_rng(2009)

    def draw(covariance, count):
        values, vectors = np.linalg.eigh(covariance)
        return rng.standard_normal((count, len(values))) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T

    estimate = np.zeros((lanes, model.order))
    truth = draw(kalman.covariance, lanes)  # error of a filter that has run for long
    innovations = np.empty((lanes, steps, s))
    for t in range(steps):
        # The actions move truth and estimate alike: any will do.
        actions = rng.standard_normal((lanes, model.commands + 1))
        truth = truth @ model.A.T + actions @ model.B.T + draw(model.Q, lanes)
        reading = truth @ model.C.T + rng.standard_normal((lanes, s)) * np.sqrt(model.R)
        predicted = kalman.predict(estimate, actions)
        innovations[:, t] = reading - predicted @ model.C.T
        estimate = kalman.correct(predicted, reading, np.zeros(lanes, dtype=int))
    inverse = np.linalg.inv(kalman.innovation)
    nis = np.einsum("lti,ij,ltj->", innovations, inverse, innovations)
    low, high = chi2.interval(1.0 - LEVEL, lanes * steps * s)
    assert low < nis < high
    assert not low < 1.01 * nis < high  # half a per cent more noise would have been seen
    statistic, freedom = whiteness(innovations, 20)
    assert statistic < chi2.ppf(1.0 - LEVEL, freedom)
    # Errors in the directions in which there are any: the spool is known exactly.
    values, vectors = np.linalg.eigh(kalman.covariance)
    kept = values > 1e-9 * values[-1]
    assert kept.sum() >= 8
    normal = ((truth - estimate) @ vectors[:, kept]) / np.sqrt(values[kept])
    low, high = chi2.interval(1.0 - LEVEL, normal.size)
    assert low < np.sum(normal**2) < high
    low, high = chi2.interval(1.0 - LEVEL / kept.sum(), lanes)  # and in each of them
    assert np.all((np.sum(normal**2, axis=0) > low) & (np.sum(normal**2, axis=0) < high))


def test_innovations_in_the_simulation_are_white_at_the_sensors_noise():
    # With a perfect model only offsets are unknown. Noise, low-pass, offset, rounding and delay are
    # the environment's own here.
    scenario = make_scenario(
        "linear", {"sensing": "laboratory", "delay": 2.5, "fields": {"current_limit": 0.04}}
    )
    model = EstimatorModel.from_scenario(scenario, ModelError(force=0.0, flow=0.0, bias_time=1e12))
    lanes, steps = 60, 400
    kalman = KalmanFilter.from_rest(model, steps)
    simulation = Simulation(scenario, lanes)
    observation = simulation.start(range(lanes), streams(lanes, 7))
    rng = np.random.default_rng(3)
    estimate, given = np.zeros((lanes, model.order)), np.zeros((lanes, model.commands + 1))
    action, normal = np.zeros(lanes), np.empty((lanes, steps, len(model.R)))
    P = model.start
    for t in range(steps):
        if t:
            action = 0.9 * action + rng.uniform(-0.02, 0.02, lanes)
            given = np.concatenate([given[:, 1:], action[:, None]], axis=1)
            observation = simulation.step(action).observation
            P = model.A @ P @ model.A.T + model.Q
            estimate = kalman.predict(estimate, given)
        reading = observation[:, scenario.observation.readings].astype(float)
        S = model.C @ P @ model.C.T + np.diag(model.R)
        normal[:, t] = np.linalg.solve(np.linalg.cholesky(S), (reading - estimate @ model.C.T).T).T
        estimate = kalman.correct(estimate, reading, np.full(lanes, t))
        P = P - kalman.gains[t] @ S @ kalman.gains[t].T
    low, high = chi2.interval(1.0 - LEVEL, normal.size)
    assert low < np.sum(normal**2) < high
    statistic, freedom = whiteness(normal, 10)
    assert statistic < chi2.ppf(1.0 - LEVEL, freedom)


def test_lanes_of_different_age_take_their_own_gains():
    scenario = make_scenario("laboratory")
    kalman = KalmanFilter.from_model(
        EstimatorModel.from_scenario(scenario, ModelError.from_scenario(scenario)), warm_up=50
    )
    rng = np.random.default_rng(4)
    x, y = rng.standard_normal((3, kalman.model.order)), rng.standard_normal((3, len(kalman.model.R)))
    age = np.array([0, 20, 10_000])
    together = kalman.correct(x, y, age)
    for i in range(3):
        alone = kalman.correct(x[i], y[i], age[i])
        assert together[i] == pytest.approx(alone, rel=1e-12, abs=1e-12)
    assert not np.allclose(kalman.gains[0], kalman.gains[20])


def test_a_position_that_is_not_measured_is_integrated():
    sensors = tuple(s for s in Sensing.laboratory().sensors if s.signal != "table_displacement")
    scenario = replace(make_scenario("laboratory"), sensing=Sensing(sensors=sensors))
    model = EstimatorModel.from_scenario(scenario, ModelError.from_scenario(scenario))
    gain, _ = stationary_filter(model)
    assert not gain[TABLE_DISPLACEMENT].any() and gain[0].any()
    assert model.A[TABLE_DISPLACEMENT, TABLE_DISPLACEMENT] == pytest.approx(1.0, rel=1e-12)


def test_a_perfect_model_has_no_stationary_filter():
    scenario = make_scenario("laboratory")
    with pytest.raises(NumericalError, match="disturbance"):
        stationary_filter(EstimatorModel.from_scenario(scenario, ModelError(force=0.0, flow=0.0)))


def test_printed_equations_are_refused():
    with pytest.raises(ScenarioError, match=r"table_acceleration.lowpass_frequency = 80.*equations"):
        make_scenario("as-printed", {"sensing": "laboratory"})
    plain = Sensing(sensors=(Sensor(signal="table_displacement"),))
    scenario = make_scenario("as-printed", {"sensing": plain})
    with pytest.raises(ScenarioError, match="equations"):
        EstimatorModel.from_scenario(scenario, ModelError(force=1.0, flow=1e-8))
