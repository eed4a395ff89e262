"""Friction and orifice feed-forward: against least squares, against simulation, and what it is worth."""

import numpy as np
import pytest

from baselines.lqr.feedforward import Compensation, DisturbancePreview, FeedforwardLQR
from baselines.lqr.preview import PreviewFeedback
from baselines.lqr.sampled import lqr
from shake_env import Friction, Nonlinearity, Sensing, ServoValve, make_scenario
from shake_env.dynamics.nonlinear import NonlinearDynamics
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.plant import REFERENCE_CURRENT
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.simulation.simulation import Simulation


def with_parts(coulomb=0.0, supply=np.inf, **overrides):
    parts = Nonlinearity(friction=Friction(coulomb=coulomb), valve=ServoValve(supply_pressure=supply))
    return make_scenario("linear", {"nonlinearity": parts, **overrides})


def mean_cost(controller, scenario, number=16):
    metrics, _ = rollout(controller, scenario, noise_earthquakes(scenario, number))
    assert not any(m.broken_limit for m in metrics)
    return np.mean([m.cost for m in metrics])


def batch_reply(scenario, column, horizon, times):
    """First current that least squares over a whole horizon finds for disturbances at `times`.

    Responses come from running the nonlinear plant's own physics step, with the disturbance put in
    where a nonlinear part would be, on one current and one disturbance at a time.
    """
    plant = NonlinearDynamics.from_plant(scenario.plant, Nonlinearity(), 1e-3, scenario.substeps)
    k, cost, states = scenario.substeps, scenario.stage_cost, plant.advance.shape[0]
    level = plant.advance[:, states + 1 :]
    weights = np.sqrt(np.array([cost.acceleration, cost.force]) / k)

    def errors(currents, disturbance):
        state, rows = np.zeros(states), []
        for t in range(horizon * k):
            now, then = disturbance[t], disturbance[t + 1]
            joined = np.concatenate([state, [currents[t // k]], np.zeros(level.shape[1])])
            state = (
                plant.advance @ joined + level[:, column] * now + plant.slope[:, column] * (then - now)
            )
            rows.append(weights * (plant.C @ state + plant.D[:, column] * then))
        return np.concatenate([np.ravel(rows), np.sqrt(cost.current) * np.asarray(currents)])

    none = np.zeros(horizon * k + 1)
    one = errors(np.eye(horizon)[0] * REFERENCE_CURRENT, none)
    size = 2 * horizon * k
    A = np.zeros((len(one), horizon))
    for i in range(horizon):  # later currents do the same later
        A[2 * k * i : size, i] = one[: size - 2 * k * i]
        A[size + i, i] = one[size]
    first = -np.linalg.pinv(A)[0] * REFERENCE_CURRENT
    return np.array([first @ errors(np.zeros(horizon), np.eye(len(none))[t]) for t in times])


@pytest.mark.parametrize(("column", "name"), [(0, "flow_row"), (1, "force_row")])
def test_reply_to_a_coming_disturbance_is_that_of_least_squares(column, name):
    scenario = make_scenario("linear", {"current_weight": 1.0})
    found = getattr(DisturbancePreview.from_scenario(scenario, 6), name)
    assert found.shape == (31,)
    times = np.array([0, 1, 4, 5, 6, 10, 17, 25, 29])
    expected = batch_reply(scenario, column, 200, times)
    # Cut at 1 s, where the slowest pole leaves 0.978^200 = 0.01 of a part that is itself small.
    assert found[times] == pytest.approx(expected, abs=1e-3 * np.max(np.abs(expected)))


def test_predicted_velocity_is_right_on_average_and_as_wrong_as_it_says():
    scenario = make_scenario("linear", {"highpass_frequency": 0.5})
    p, lanes, ahead = DisturbancePreview.from_scenario(scenario, 10), 3000, 10
    controller, simulation = lqr(scenario), Simulation(scenario, lanes)
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(5).spawn(lanes)]
    observation = simulation.start(range(lanes), streams)
    for t in range(400 + ahead):
        if t == 400:
            start = observation
        observation = simulation.step(controller.predict(observation)[0][:, 0]).observation
        if t >= 400 and (t - 399) in (2, 5, 10):
            j = (t - 399) * scenario.substeps
            for row, place, size in ((0, 0, None), (1, 2, p.velocity_spread[j]), (2, 3, None)):
                predicted = start @ p.rows[row, j]
                error = simulation.state[:, place] - predicted
                assert abs(np.mean(error)) < 4.0 * np.std(error) / np.sqrt(lanes)
                assert abs(np.corrcoef(error, predicted)[0, 1]) < 4.5 / np.sqrt(lanes)
                if size is not None:
                    # A variance of 3000 normal values is known to sqrt(2 / 3000) = 2.6 %.
                    assert np.var(error) == pytest.approx(size**2, rel=0.12)


def test_a_linear_table_needs_none():
    scenario = make_scenario()
    rng = np.random.default_rng(0)
    observation = rng.standard_normal((5, 14)).astype(np.float32)
    ours, theirs = FeedforwardLQR(scenario), lqr(scenario)
    assert np.array_equal(ours.predict(observation)[0], theirs.predict(observation)[0])


@pytest.mark.parametrize(("coulomb", "unaware_loss"), [(150.0, 0.03), (300.0, 0.13)])
def test_friction_costs_almost_nothing_once_it_is_expected(coulomb, unaware_loss):
    scenario = with_parts(coulomb, duration=5.0)
    unaware = mean_cost(lqr(scenario), scenario)
    ours = mean_cost(FeedforwardLQR(scenario), scenario)
    linear = make_scenario("linear", {"duration": 5.0})
    frictionless = mean_cost(lqr(linear), linear)
    assert unaware > (1.0 + unaware_loss) * frictionless
    # The same earthquakes: what is left of the loss, a twentieth, is no chance of the draw.
    assert ours - frictionless < 0.05 * (unaware - frictionless)


def test_friction_rules_a_small_motion_and_is_compensated_there_too():
    motion = {"duration": 5.0, "highpass_frequency": 0.5, "amplitude": 0.34}
    scenario = with_parts(300.0, **motion)
    linear = make_scenario("linear", motion)
    unaware, ours = mean_cost(lqr(scenario), scenario), mean_cost(FeedforwardLQR(scenario), scenario)
    frictionless = mean_cost(lqr(linear), linear)
    assert unaware > 2.0 * frictionless and ours < 1.1 * frictionless


def test_compensation_without_foresight_comes_too_late():
    scenario = with_parts(300.0, duration=5.0)
    blind = FeedforwardLQR(scenario, Compensation(horizon=0.005))
    assert mean_cost(blind, scenario) > mean_cost(lqr(scenario), scenario)


def test_the_orifice_is_made_up_for():
    scenario = with_parts(supply=21e6, duration=5.0)
    unaware = mean_cost(lqr(scenario), scenario)
    divided = mean_cost(FeedforwardLQR(scenario, Compensation(orifice="present")), scenario)
    foreseen = mean_cost(FeedforwardLQR(scenario), scenario)
    linear = make_scenario("linear", {"duration": 5.0})
    flawless = mean_cost(lqr(linear), linear)
    assert divided < 0.96 * unaware
    assert foreseen < 1.01 * flawless < 0.9 * unaware


def test_stribeck_and_viscous_friction_are_expected_too():
    friction = Friction(coulomb=200.0, static=300.0, viscous=200.0)
    scenario = make_scenario(
        "linear", {"duration": 5.0, "nonlinearity": Nonlinearity(friction=friction)}
    )
    linear = make_scenario("linear", {"duration": 5.0})
    unaware, ours = mean_cost(lqr(scenario), scenario), mean_cost(FeedforwardLQR(scenario), scenario)
    frictionless = mean_cost(lqr(linear), linear)
    assert ours - frictionless < 0.1 * (unaware - frictionless)


@pytest.mark.parametrize("orifice", ["preview", "present"])
def test_shapes_and_what_is_not_read(orifice):
    sensing = Sensing(preview=0.02, last_action=True)
    scenario = with_parts(300.0, 21e6, sensing=sensing)
    controller = FeedforwardLQR(scenario, Compensation(orifice=orifice))
    rng = np.random.default_rng(3)
    observation = (0.3 * rng.standard_normal((6, scenario.observation.size))).astype(np.float32)
    action, memory = controller.predict(observation)
    assert action.shape == (6, 1) and action.dtype == np.float32 and memory is None
    single, _ = controller.predict(observation[2])
    assert single.shape == (1,) and single[0] == pytest.approx(action[2, 0], abs=1e-6)
    observation[:, scenario.observation.last_action] += 1.0
    assert np.array_equal(controller.predict(observation)[0], action)
    assert np.max(np.abs(controller.predict(1e3 * observation)[0])) == 1.0
    unaware, _ = PreviewFeedback(scenario).predict(observation)
    assert np.max(np.abs(action - unaware)) > 1e-3


def test_present_division_is_the_inverse_orifice():
    scenario = with_parts(supply=10e6, current_limit=1.0)
    controller = FeedforwardLQR(scenario, Compensation(orifice="present"))
    observation = np.zeros((2, 14), np.float32)
    pressure = scenario.plant.layout.actuator.start
    observation[:, pressure] = 4e6 / scenario.plant.state_scale[pressure]
    observation[0, pressure + 3], observation[1, pressure + 3] = -2.0, 2.0  # spool: which way to go
    linear, _ = lqr(scenario).predict(observation)
    assert linear[0] > 0.0 > linear[1]
    action, _ = controller.predict(observation)
    assert action[0] == pytest.approx(linear[0] / np.sqrt(0.6), rel=1e-6)
    assert action[1] == pytest.approx(linear[1] / np.sqrt(1.4), rel=1e-6)


def test_what_cannot_be_set_says_why():
    with pytest.raises(ParameterError, match="horizon"):
        Compensation(horizon=0.0)
    with pytest.raises(ParameterError, match="floor"):
        Compensation(floor=1.5)
    with pytest.raises(ParameterError, match="orifice"):
        Compensation(orifice="sometimes")
    with pytest.raises(ScenarioError, match="full state"):
        FeedforwardLQR(make_scenario("laboratory"))
