"""Predictive control: the preview LQR without limits, another solver's QP with them, and the limits."""

import numpy as np
import pytest
from scipy.optimize import nnls

from baselines.lqr.mpc import MPCSettings, PredictiveControl, feed_forward
from baselines.lqr.preview import PreviewFeedback, preview_lqr
from baselines.lqr.tracking_problem import TrackingProblem
from shake_env import Sensing, make_scenario
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.plant import REFERENCE_CURRENT
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.simulation.simulation import Simulation

LABORATORY = {
    "highpass_frequency": 0.5,
    "limits": "laboratory",
    "amplitude": 0.5,
    "current_limit": 0.04,
    "sensing": Sensing(preview=0.1, preview_spacing=0.005),
}


def tracking(scenario):
    return TrackingProblem.from_plant(scenario.discrete, scenario.stage_cost)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-7])
@pytest.mark.parametrize(
    "overrides",
    [{}, {"stories": 5, "highpass_frequency": 0.5}, {"control_rate": 500.0}],
    ids=str,
)
def test_without_an_active_limit_it_is_the_preview_lqr(overrides, tolerance):
    sensing = Sensing(preview=0.05, preview_spacing=0.002, last_action=True)
    scenario = make_scenario("linear", {**overrides, "sensing": sensing})
    settings = MPCSettings(
        current=1e4, velocity=1e5, displacement=1e5, solve_all=True, tolerance=tolerance, horizon=0.05
    )
    controller = PredictiveControl(scenario, settings)
    rng = np.random.default_rng(4)
    observation = (0.1 * rng.standard_normal((20, scenario.observation.size))).astype(np.float32)
    H = round(0.05 * scenario.control_rate)
    # Started from a wrong answer, so that the solver has to find the right one.
    memory = 3.0 * rng.standard_normal((20, H + 2)), rng.standard_normal((20, 5 * H + 2))
    action, memory = controller.predict(observation, memory)
    expected, _ = PreviewFeedback(scenario).predict(observation)
    assert np.max(np.abs(expected)) < 1.0 and np.std(expected) > 0.05
    # OSQP's residuals are the gradient c, in units of 25 mA; float32 actions add 6e-8.
    error = np.abs(action - expected) * scenario.current_limit / REFERENCE_CURRENT
    assert np.max(error) < 2.0 * tolerance + 1e-6
    assert controller.decision_times.unfinished == 0


def test_terminal_cost_is_the_whole_future():
    # However short the horizon, the law without limits does not change.
    scenario = make_scenario("linear", {"sensing": Sensing(preview=0.1)})
    rng = np.random.default_rng(8)
    observation = (0.1 * rng.standard_normal((9, scenario.observation.size))).astype(np.float32)
    actions = [
        PredictiveControl(scenario, MPCSettings(horizon=h)).predict(observation)[0]
        for h in (0.005, 0.05, 0.4)
    ]
    assert actions[1] == pytest.approx(actions[0], abs=1e-6)
    assert actions[2] == pytest.approx(actions[0], abs=1e-6)


def least_distance(P, q, J, room):
    """Minimise ``1/2 z'diag(P)z + q'z`` where ``J z + room >= 0``: Lawson and Hanson's LDP by NNLS."""
    root = np.sqrt(P)
    G, h = J / root, J @ (q / P) - room
    E, f = np.vstack([G.T, h]), np.append(np.zeros(len(P)), 1.0)
    u, _ = nnls(E, f, maxiter=3000)
    r = E @ u - f
    return -r[:-1] / r[-1] / root - q / P


def test_each_qp_against_another_solver():
    scenario = make_scenario("linear", LABORATORY)
    settings = MPCSettings(horizon=0.05, tolerance=1e-7, velocity=0.3, iterations=100_000)
    controller = PredictiveControl(scenario, settings)
    R_u, H = tracking(scenario).R_u, 10
    rng = np.random.default_rng(6)
    observation = (0.5 * rng.standard_normal((12, scenario.observation.size))).astype(np.float32)
    displacement = scenario.plant.layout.table_displacement
    observation[::3, displacement] = 0.068 / scenario.plant.state_scale[displacement]
    action, (x, _) = controller.predict(observation)
    R = controller.prediction.response
    excess, soft = np.repeat(np.eye(2), H, axis=0), 0
    J = np.block(
        [
            [-R[:H], np.zeros((H, 2))],
            [R[:H], np.zeros((H, 2))],
            [-R[H:], excess],
            [R[H:], excess],
            [np.zeros((2, H)), np.eye(2)],
        ]
    )
    P, q = np.append(np.full(H, 2.0 * R_u), [2000.0] * 2), np.append(np.zeros(H), [100.0] * 2)
    for lane, free in enumerate(observation @ controller.prediction.rows.T):
        current, rest = free[:H], free[H:]
        room = np.concatenate([1.0 - current, 1.0 + current, 1.0 - rest, 1.0 + rest, np.zeros(2)])
        z = least_distance(P, q, J, room)
        assert np.min(J @ z + room) > -1e-7
        assert x[lane] == pytest.approx(z, abs=1e-4)
        expected = np.clip(current[0] + z[0] * R[0, 0], -1.0, 1.0)
        assert action[lane, 0] == pytest.approx(expected, abs=1e-5)
        soft += np.any(z[H:] > 1e-3)
    assert controller.decision_times.solved >= 8 and soft >= 2  # limits did act, and gave


def test_predicted_signals_are_those_of_the_table():
    scenario = make_scenario("linear", {**LABORATORY, "amplitude": 0.0, "current_limit": 1.0})
    controller, law = PredictiveControl(scenario), PreviewFeedback(scenario)
    simulation = Simulation(scenario, 3)
    simulation.start(range(3), [np.random.default_rng(i) for i in range(3)])
    layout = scenario.plant.layout
    rng = np.random.default_rng(1)
    scale = scenario.plant.state_scale[layout.controlled]
    simulation.state = 0.3 * rng.standard_normal((3, len(scale))) * scale
    observation = np.zeros((3, scenario.observation.size))
    observation[:, layout.controlled] = simulation.state / scale
    H = 40
    free = (observation @ controller.prediction.rows.T).reshape(3, 3, H)
    for j in range(H):
        action, _ = law.predict(observation)
        assert free[:, 0, j] == pytest.approx(action[:, 0], abs=1e-5)
        observation = simulation.step(action[:, 0].astype(float)).observation
        velocity, displacement = simulation.state[:, 2], simulation.state[:, 1]
        assert 0.92 * 0.65 * free[:, 1, j] == pytest.approx(velocity, abs=1e-5)
        assert 0.92 * 0.076 * free[:, 2, j] == pytest.approx(displacement, abs=1e-6)


@pytest.mark.parametrize("spacing", [0.002, 0.005])
def test_feed_forward_expected_now_is_the_mean_of_the_one_expected_then(spacing):
    sensing = Sensing(preview=0.04, preview_spacing=spacing)
    scenario = make_scenario("linear", {"sensing": sensing, "highpass_frequency": 0.5})
    feed = feed_forward(scenario, tracking(scenario), 4)
    design = preview_lqr(scenario.discrete, scenario.stage_cost, 0.04, spacing)
    size = np.sqrt(scenario.plant.target_variance) / REFERENCE_CURRENT
    assert feed[0, scenario.observation.preview] == pytest.approx(design.preview_gain * size, abs=1e-9)
    lanes = 4000
    simulation = Simulation(scenario, lanes)
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(3).spawn(lanes)]
    seen = [simulation.start(range(lanes), streams)]
    for _ in range(203):
        seen.append(simulation.step(np.zeros(lanes)).observation)
    n = scenario.plant.layout.controlled
    for back in (1, 2, 3):
        now, then = seen[-1 - back], seen[-1]
        surprise = then @ feed[0] - now @ feed[back]
        known = np.delete(now, np.r_[n], axis=1)
        correlation = (known * surprise[:, None]).mean(axis=0) / (known.std(axis=0) * surprise.std())
        # 30 correlations that are zero: 4.5 standard deviations are passed once in 5000 such tests.
        assert np.max(np.abs(correlation)) < 4.5 / np.sqrt(lanes)
        assert abs(surprise.mean()) < 4.5 * surprise.std() / np.sqrt(lanes)


def test_limits_are_kept_where_the_preview_lqr_breaks_them():
    scenario = make_scenario("linear", {**LABORATORY, "duration": 5.0})
    quakes = noise_earthquakes(scenario, 4)
    controller = PredictiveControl(scenario)
    kept, _ = rollout(controller, scenario, quakes)
    broken, _ = rollout(PreviewFeedback(scenario), scenario, quakes)
    assert sum(m.broken_limit == "table_displacement" for m in broken) >= 2
    for m, other in zip(kept, broken, strict=True):
        assert m.broken_limit is None
        assert m.peak_displacement < 0.0705 and m.peak_velocity < 0.61
        assert m.peak_current <= 0.04 * (1.0 + 1e-7)
        assert m.cost < 0.05 * other.cost or other.broken_limit is None
    times = controller.decision_times
    assert times.decisions == 4000 and 0 < times.solved < 1000 and times.unfinished == 0
    assert 0.0 < times.median <= times.p95 <= times.longest < 1.0


def test_the_current_limit_is_hard_and_may_be_lower_than_the_scenarios():
    scenario = make_scenario("linear", {"sensing": Sensing(preview=0.05), "duration": 2.0})
    controller = PredictiveControl(scenario, MPCSettings(current=0.02, horizon=0.05))
    metrics, _ = rollout(controller, scenario, noise_earthquakes(scenario, 2))
    assert max(m.peak_current for m in metrics) == pytest.approx(0.02, rel=1e-6)
    assert controller.decision_times.solved > 0


def test_a_table_far_outside_its_limits_is_brought_back():
    scenario = make_scenario("linear", {**LABORATORY, "amplitude": 0.0, "limits": "off"})
    settings = MPCSettings(velocity=0.6, displacement=0.07)
    controller, simulation = PredictiveControl(scenario, settings), Simulation(scenario, 1)
    observation = simulation.start([0], [np.random.default_rng(0)])
    place = scenario.plant.layout.table_displacement
    state = simulation.state
    state[0, 1] = 0.12
    simulation.state = state
    observation[0, place] = 0.12 / scenario.plant.state_scale[place]
    memory = None
    for _ in range(200):
        action, memory = controller.predict(observation, memory)
        observation = simulation.step(action[:, 0].astype(float)).observation
    assert controller.decision_times.solved > 0 and controller.decision_times.unfinished == 0
    assert abs(simulation.state[0, 1]) < 0.0705


def test_memory_is_the_passed_state_lane_by_lane():
    scenario = make_scenario("linear", LABORATORY)
    one, other = (PredictiveControl(scenario, MPCSettings(horizon=0.1)) for _ in range(2))
    rng = np.random.default_rng(2)
    observations = (0.6 * rng.standard_normal((3, 4, scenario.observation.size))).astype(np.float32)
    starts = np.zeros((3, 4), bool)
    starts[0], starts[2, 1] = True, True
    together, alone = None, [None] * 4
    for x, start in zip(observations, starts, strict=True):
        action, together = one.predict(x, together, start)
        for lane in range(4):
            single, alone[lane] = other.predict(x[lane], alone[lane], start[lane : lane + 1])
            assert single.shape == (1,)
            # The same QP from the same start; only the order of sums in the product differs.
            assert single[0] == pytest.approx(action[lane, 0], abs=2e-5)
    fresh, _ = one.predict(observations[2])
    assert fresh[1, 0] == pytest.approx(action[1, 0], abs=2e-5)


def test_what_cannot_be_set_says_why():
    with pytest.raises(ParameterError, match="horizon"):
        MPCSettings(horizon=0.0)
    with pytest.raises(ParameterError, match="velocity"):
        MPCSettings(velocity=-1.0)
    with pytest.raises(ScenarioError, match="full state"):
        PredictiveControl(make_scenario("linear", {"sensing": "laboratory"}))
    with pytest.raises(ScenarioError, match="corrected"):
        PredictiveControl(make_scenario("as-printed"))
