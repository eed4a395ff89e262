"""LQR with integral action: no steady error, a stable position, and its analytic cost."""

import control
import numpy as np
import pytest

from baselines.lqr.integral import DisplacementWeights, IntegralFeedback, lqr_integral
from baselines.lqr.sampled import LinearFeedback, lqr, sampled_lqr
from shake_env import make_scenario
from shake_env.errors import ParameterError
from shake_env.model.plant import REFERENCE_CURRENT
from shake_env.simulation.simulation import Simulation

HIGHPASS = {"highpass_frequency": 0.5}


def design(scenario, **weights):
    return lqr_integral(scenario.discrete, scenario.stage_cost, DisplacementWeights(**weights))


def settle(scenario, controller, bias, seconds=60.0):
    """Displacements (steps,) [m] of a table without a motion whose valve has a null shift [A]."""
    simulation = Simulation(scenario, 1)
    observation = simulation.start([0], [np.random.default_rng(0)])
    memory, found = None, []
    for t in range(round(seconds / scenario.control_period)):
        action, memory = controller.predict(observation, memory, np.array([t == 0]))
        observation = simulation.step(action[:, 0] + bias / scenario.current_limit).observation
        found.append(simulation.state[0, 1])
    return np.array(found)


@pytest.mark.parametrize("overrides", [{}, {**HIGHPASS, "stories": 5}], ids=str)
def test_no_steady_error_under_a_constant_offset_of_the_valve(overrides):
    scenario = make_scenario("linear", {**overrides, "amplitude": 0.0})
    bias = 0.5e-3
    found = design(scenario)
    position = settle(scenario, IntegralFeedback(scenario, found), bias)
    assert np.max(np.abs(position)) > 5e-3  # there was something to bring back
    # exp(-0.84 * 60) of it is left; float32 observations and actions leave 1e-7 of their own.
    assert abs(position[-1]) < 1e-8
    # The same feedback without the integral rests where the position's gain cancels the offset.
    proportional = settle(scenario, LinearFeedback(scenario, found.gain), bias)
    k = found.gain[scenario.plant.layout.table_displacement]
    assert proportional[-1] == pytest.approx(bias / k, rel=1e-4)
    # And the plain LQR drifts away.
    drifting = settle(scenario, lqr(scenario), bias)
    assert abs(drifting[-1] - drifting[-1000]) > 1e-2


@pytest.mark.parametrize(
    "overrides", [{}, HIGHPASS, {**HIGHPASS, "stories": 10}, {"control_rate": 1000.0}], ids=str
)
def test_the_closed_loop_with_position_and_integral_is_stable(overrides):
    scenario = make_scenario("linear", overrides)
    found, lifted = design(scenario), scenario.discrete.lifted
    n, scale = scenario.plant.layout.order, scenario.plant.state_scale
    F, G = lifted.state[:, :n], lifted.state[:, n : n + 1]
    loop = np.block(
        [
            [F - G * found.gain, -G * found.integral_gain],
            [found.period * found.error_row, np.ones((1, 1))],
        ]
    )
    size = np.append(scale, 1.0)
    radius = np.max(np.abs(np.linalg.eigvals(loop * size / size[:, None])))
    assert radius == pytest.approx(found.spectral_radius, abs=1e-9)
    # The slowest is the specimen's own first mode, which nothing here damps: at ten storeys, 1.046 Hz
    # damped by 0.05 * 1.046 / 7, that is 0.049 1/s.
    assert radius < 1.0 - 0.045 * scenario.control_period


def test_riccati_solution_against_python_control():
    # Written again in units of its own: seconds, decimetres, the lifted model's outputs.
    scenario = make_scenario("linear", HIGHPASS)
    w = DisplacementWeights(position=0.02, integral=0.05, displacement=0.05)
    lifted, cost, k = scenario.discrete.lifted, scenario.stage_cost, scenario.substeps
    n, layout = scenario.plant.layout.order, scenario.plant.layout
    unit = np.concatenate([scenario.plant.state_scale, [0.1]])
    F = np.zeros((n + 1, n + 1))
    F[:n, :n], F[n, n] = lifted.state[:, :n], 1.0
    F[n, layout.table_displacement], F[n, 2] = scenario.control_period, -scenario.control_period
    G = np.append(lifted.state[:, n], 0.0)[:, None] * REFERENCE_CURRENT / unit[:, None]
    F = F * unit / unit[:, None]
    rows = []
    for output in lifted.outputs:
        for weight, row in (
            (cost.acceleration, output[0] - output[2]),
            (cost.force, output[1] - output[3]),
        ):
            z = np.concatenate([row[:n], [0.0]]) * unit
            rows.append(np.sqrt(weight / k) * np.append(z, row[n] * REFERENCE_CURRENT))
    e = np.zeros(n + 2)
    e[layout.table_displacement], e[2] = unit[layout.table_displacement], -unit[2]
    xi = np.zeros(n + 2)
    xi[n] = unit[n]
    rows += [np.sqrt(w.position) / w.displacement * e, np.sqrt(w.integral) / w.displacement * xi]
    whole = np.array(rows).T @ np.array(rows)
    R = whole[-1:, -1:] + cost.current * REFERENCE_CURRENT**2
    _, _, K = control.dare(F, G, whole[:-1, :-1], R, whole[:-1, -1:], method="scipy")
    found = lqr_integral(scenario.discrete, cost, w)
    gain = np.append(found.gain, found.integral_gain) * unit / REFERENCE_CURRENT
    # Well conditioned: other units, the same gain to the Riccati solver's own digits.
    assert np.max(np.abs(gain - K[0])) < 1e-7 * np.max(np.abs(gain))


def test_small_weights_leave_the_lqr_and_large_ones_hold_the_table():
    scenario = make_scenario("linear", HIGHPASS)
    best = sampled_lqr(scenario.discrete, scenario.stage_cost).analytic_cost
    found = [design(scenario, position=w, integral=w) for w in (1e-9, 1e-6, 1e-3, 1.0)]
    costs = [d.performance.cost for d in found]
    held = [d.displacement_error_rms for d in found]
    assert best < costs[0] and np.all(np.diff(costs) > 0.0) and np.all(np.diff(held) < 0.0)
    # Holding a table within 3.5 mm rms of the ground costs 4 % where the ground itself stays in place.
    assert costs[-1] < 1.05 * best and held[-1] < 4e-3


def test_simulated_cost_agrees_with_the_analytic_one():
    scenario = make_scenario("linear", {**HIGHPASS, "duration": 20.0})
    found, lanes = design(scenario), 1000
    controller, simulation = IntegralFeedback(scenario, found), Simulation(scenario, lanes)
    seeds = np.random.SeedSequence(7).spawn(lanes)
    observation = simulation.start(range(lanes), [np.random.default_rng(s) for s in seeds])
    memory, cost, square = None, 0.0, 0.0
    row = found.error_row * scenario.plant.state_scale
    for t in range(4000):
        action, memory = controller.predict(observation, memory, np.full(lanes, t == 0))
        result = simulation.step(action[:, 0])
        if t >= 1200:
            square = square + (observation @ row) ** 2 / 2800
            cost = cost - result.reward / 2800
        observation = result.observation
    for values, expected, limit in (
        (cost, found.performance.cost, 0.005),
        (square, found.displacement_error_rms**2, 0.025),  # slow, so that fewer of its values count
    ):
        half_width = 1.96 * np.std(values, ddof=1) / np.sqrt(lanes)
        assert half_width < limit * expected
        assert abs(np.mean(values) - expected) < half_width


def test_memory_is_the_passed_state_lane_by_lane():
    scenario = make_scenario()
    found = design(scenario)
    controller = IntegralFeedback(scenario, found)
    n = scenario.plant.layout.order
    rng = np.random.default_rng(2)
    observations = (0.05 * rng.standard_normal((4, 3, n))).astype(np.float32)
    together = None
    alone = [None] * 3
    starts = np.zeros((4, 3), bool)
    starts[0], starts[2, 1] = True, True
    for x, start in zip(observations, starts, strict=True):
        action, together = controller.predict(x, together, start)
        for lane in range(3):
            single, alone[lane] = controller.predict(x[lane], alone[lane], start[lane : lane + 1])
            assert single.shape == (1,) and single[0] == pytest.approx(action[lane, 0], abs=1e-6)
    e = observations[:, :, scenario.plant.layout.table_displacement]
    e = e * scenario.plant.state_scale[scenario.plant.layout.table_displacement] * 5e-3
    assert together[0][[0, 2]] == pytest.approx(e[:, [0, 2]].sum(axis=0), rel=1e-6)
    assert together[0][1] == pytest.approx(e[2:, 1].sum(), rel=1e-6)
    again, _ = controller.predict(observations[0])  # nothing stayed inside the controller
    first, _ = controller.predict(observations[0], None, starts[0])
    assert np.array_equal(again, first)


def test_the_integral_does_not_wind_up():
    scenario = make_scenario("linear", {"current_limit": 1e-3})
    controller = IntegralFeedback(scenario, design(scenario))
    observation = np.zeros((2, 14), np.float32)
    observation[:, scenario.plant.layout.table_displacement] = 3.0, -3.0
    memory = None
    for _ in range(10):
        action, memory = controller.predict(observation, memory)
    assert list(action[:, 0]) == [-1.0, 1.0]
    assert list(memory[0]) == [0.0, 0.0]


@pytest.mark.parametrize(
    "weights", [{"integral": 0.0}, {"position": -1.0}, {"displacement": 0.0}], ids=str
)
def test_weights_are_checked(weights):
    with pytest.raises(ParameterError):
        DisplacementWeights(**weights)
