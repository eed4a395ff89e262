"""The extended Kalman filter: the project's own on a linear table, white innovations on a real one."""

import numpy as np
import pytest

pytest.importorskip("numba")

from dataclasses import replace

from baselines.estimation.estimator_model import EstimatorModel, ModelError
from baselines.estimation.kalman import KalmanFilter
from baselines.planning.ekf import ExtendedKalmanFilter
from shake_env import make_scenario
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.rollout import noise_earthquakes
from shake_env.simulation.simulation import Simulation

SIGNALS = ("load_pressure", "base_shear", "floor_accelerations")


def driven_by_noise(scenario, steps, seed):
    """Currents (T) [A], and observations (T + 1, n) of one table that they drive."""
    quake = noise_earthquakes(scenario, 1, seed)[0]
    simulation = Simulation(scenario, 1)
    shown = [simulation.start([0], [np.random.default_rng(quake.seed)], [quake.motion])[0]]
    rng = np.random.default_rng(seed)
    action = np.convolve(rng.normal(0.0, 0.12, steps + 20), np.ones(20) / 4.0, "valid")[:steps]
    states = []
    for each in action:
        shown.append(simulation.step(np.array([each])).observation[0])
        states.append(simulation.state[0].copy())
    return action * scenario.current_limit, np.array(shown, dtype=float), np.array(states)


def linear_laboratory():
    scenario = make_scenario("laboratory", {"duration": 3.0})
    return replace(scenario, nonlinearity=Nonlinearity())


@pytest.mark.parametrize("sensing", ["laboratory", "full"])
def test_on_a_linear_table_it_is_the_kalman_filter(sensing):
    scenario = linear_laboratory()
    if sensing == "full":
        scenario = replace(scenario, sensing=make_scenario("linear").sensing)
    error = ModelError.from_scenario(scenario)
    steps = 150
    current, shown, _ = driven_by_noise(scenario, steps, seed=3)
    linear = KalmanFilter.from_rest(EstimatorModel.from_scenario(scenario, error), steps + 1)
    nonlinear = ExtendedKalmanFilter.from_scenario(scenario, error)
    full = scenario.sensing.full_state
    layout = scenario.plant.layout
    readings = shown[:, layout.controlled if full else scenario.observation.readings]
    table = linear.correct(np.zeros((1, linear.model.order)), readings[:1], np.zeros(1, dtype=int))
    found = nonlinear.advance(nonlinear.rest(1), np.zeros(1), readings[:1], np.array([True]))
    actions = np.zeros((1, linear.model.commands + 1))
    model = nonlinear.model
    for t in range(steps):
        actions = np.append(actions[:, 1:], current[t : t + 1, None] / scenario.current_limit, axis=1)
        table = linear.correct(
            linear.predict(table, actions), readings[t + 1 : t + 2], np.array([t + 1])
        )
        found = nonlinear.advance(found, current[t : t + 1], readings[t + 1 : t + 2], np.array([False]))
        m = model.order
        ours = np.append(found.state[0, :m] / model.scale[:m], found.rest[0])
        f = len(scenario.observation.low_passes)  # there behind the disturbances, here before
        ours[m - 2 - f : m] = np.roll(ours[m - 2 - f : m], -f)
        np.testing.assert_allclose(ours, table[0], atol=1e-9 * max(1.0, np.abs(table).max()))


def test_innovations_are_white_in_the_laboratory():
    """Unit size, and no correlation from period to period beyond what a sample of this length has."""
    scenario = make_scenario("laboratory", {"duration": 12.0})
    steps = 2000
    # Without doubt in a model that is the truth; its noise is the sensors' alone.
    nonlinear = ExtendedKalmanFilter.from_scenario(scenario, ModelError(force=0.3, flow=1e-10))
    innovations, errors = [], []
    for seed in (3, 4):
        current, shown, states = driven_by_noise(scenario, steps, seed)
        readings = shown[:, scenario.observation.readings]
        found = nonlinear.advance(nonlinear.rest(1), np.zeros(1), readings[:1], np.array([True]))
        for t in range(steps):
            found = nonlinear.advance(
                found, current[t : t + 1], readings[t + 1 : t + 2], np.array([False])
            )
            innovations.append(found.innovation[0])
            m = 4 + 2 * scenario.specimen.stories
            errors.append((found.state[0, :m] - states[t, :m]) / nonlinear.model.scale[:m])
    e = np.array(innovations)
    assert np.sqrt(np.mean(e**2, axis=0)) == pytest.approx(np.ones(5), abs=0.06)
    lagged = np.mean(e[1:] * e[:-1], axis=0) / np.mean(e**2, axis=0)
    assert (np.abs(lagged) < 4.0 / np.sqrt(len(e))).all()
    assert (np.sqrt(np.mean(np.square(errors), axis=0)) < 0.01).all()


def test_every_kind_of_sensor_is_predicted():
    from shake_env.scenario.observation import Sensing, Sensor

    scenario = make_scenario("laboratory", {"duration": 3.0})
    sensors = tuple(Sensor(signal=name, noise=1e-3, lowpass_frequency=60.0) for name in SIGNALS)
    plain = tuple(Sensor(signal=name, noise=1e-3) for name in SIGNALS)
    for chosen in (sensors, plain):
        measured = replace(scenario, sensing=Sensing(sensors=chosen))
        nonlinear = ExtendedKalmanFilter.from_scenario(measured, ModelError(force=0.3, flow=1e-10))
        current, shown, states = driven_by_noise(measured, 200, 5)
        readings = shown[:, measured.observation.readings]
        found = nonlinear.advance(nonlinear.rest(1), np.zeros(1), readings[:1], np.array([True]))
        for t in range(200):
            found = nonlinear.advance(
                found, current[t : t + 1], readings[t + 1 : t + 2], np.array([False])
            )
        at = [0, 2, 3, 4, 5, 6, 7]  # the place itself has no sensor
        scale = nonlinear.model.scale
        assert np.abs((found.state[0, at] - states[-1, at]) / scale[at]).max() < 0.02
