"""Preview LQR: a batch least-squares solution, limits, the floor, and a simulation."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.lqr.discrete_lyapunov import discrete_lyapunov
from baselines.lqr.preview import PreviewFeedback, infinite_preview, preview_lqr, with_preview
from baselines.lqr.sampled import sampled_lqr
from shake_env import Actuator, Sensing, make_scenario
from shake_env.errors import NumericalError, ParameterError, ScenarioError
from shake_env.model.plant import REFERENCE_CURRENT
from shake_env.simulation.simulation import Simulation


def design(scenario, preview, spacing=None):
    return preview_lqr(scenario.discrete, scenario.stage_cost, preview, spacing)


def floor(scenario):
    return infinite_preview(scenario.discrete, scenario.stage_cost).cost


def batch_law(scenario, samples, stride, horizon):
    """First current of the least-squares problem over a whole horizon, written without a Riccati step.

    All errors are linear in the first state, the currents and the draws; what the samples tell of the
    draws is Gaussian conditioning by their covariance.
    """
    discrete, cost = scenario.discrete, scenario.stage_cost
    lifted, scale = discrete.lifted, discrete.plant.state_scale
    n, k, H = len(scale), discrete.substeps, horizon
    m = lifted.state.shape[1] - n - 1
    unit = np.concatenate([scale, [REFERENCE_CURRENT], np.ones(m)])
    weights = np.sqrt(np.array([cost.acceleration, cost.force]) / k)
    step = lifted.state * unit / scale[:, None]
    errors = ((lifted.outputs[:, :2] - lifted.outputs[:, 2:]) * weights[:, None]).reshape(
        2 * k, -1
    ) * unit
    target = lifted.outputs[:, 2] * unit
    X = np.eye(n, n + H + H * m)  # the state over [x_0, currents, draws]
    e, y = [], []
    for i in range(H):
        columns = np.r_[n + i, n + H + i * m : n + H + (i + 1) * m]
        for rows, found in ((errors, e), (target, y)):
            out = rows[:, :n] @ X
            out[:, columns] += rows[:, n:]
            found.append(out)
        X = step[:, :n] @ X
        X[:, columns] += step[:, n:]
    e, y = np.concatenate(e), np.concatenate(y)[stride - 1 :: stride][:samples]
    effort = np.sqrt(cost.current) * REFERENCE_CURRENT * np.eye(H)
    first = -np.linalg.pinv(np.vstack([e[:, n : n + H], effort]))[0, : len(e)] @ e
    on_draws, Y = first[n + H :], y[:, n + H :]
    b = np.linalg.solve(Y @ Y.T, Y @ on_draws)
    return -(first[:n] - b @ y[:, :n]) * REFERENCE_CURRENT / scale, b * REFERENCE_CURRENT


@pytest.mark.parametrize(("samples", "stride"), [(4, 5), (6, 3), (8, 1), (5, 7), (2, 10)])
@pytest.mark.parametrize("highpass", [None, 0.5])
def test_the_law_is_the_first_move_of_a_batch_least_squares_problem(samples, stride, highpass):
    # A dear current, so that the horizon's end, 1.4 s ahead, is forgotten: the slowest closed-loop pole
    # is 0.978 a period, and 0.978^280 = 2e-3 of what happens there, itself 1e-2 of the gain, is left.
    scenario = make_scenario("linear", {"current_weight": 1.0, "highpass_frequency": highpass})
    gain, preview_gain = batch_law(scenario, samples, stride, horizon=280)
    found = design(scenario, samples * stride * 1e-3, stride * 1e-3)
    scale = scenario.plant.state_scale
    assert np.max(np.abs(gain - found.gain) * scale) < 2e-5 * np.max(np.abs(gain * scale))
    assert np.max(np.abs(preview_gain - found.preview_gain)) < 2e-5 * np.max(np.abs(preview_gain))


@pytest.mark.parametrize(
    "overrides",
    [
        {},
        {"stories": 10, "control_rate": 500.0},
        {"control_rate": 1000.0, "highpass_frequency": 0.5},
        {"force_weight": 0.0, "control_rate": 50.0},
        {"acceleration_weight": 0.0},
    ],
    ids=str,
)
def test_without_preview_it_is_the_sampled_lqr(overrides):
    scenario = make_scenario("linear", overrides)
    found, known = design(scenario, 0.0), sampled_lqr(scenario.discrete, scenario.stage_cost)
    scale = scenario.plant.state_scale
    # Two Riccati equations, of x_c and of the whole state, carry the condition of their own pencils.
    assert np.max(np.abs(found.gain - known.gain) * scale) < 1e-8 * np.max(np.abs(known.gain * scale))
    assert found.preview_gain.shape == (0,)
    for field in vars(known.performance):
        expected = getattr(known.performance, field)
        assert getattr(found.performance, field) == pytest.approx(expected, rel=1e-8)


def test_a_table_on_springs_feeds_its_position_back():
    actuator = Actuator(table_stiffness=1e5, leakage=1e-11)
    scenario = replace(make_scenario(), actuator=actuator)
    found, known = design(scenario, 0.0), sampled_lqr(scenario.discrete, scenario.stage_cost)
    position = scenario.plant.layout.table_displacement
    assert found.gain[position] != 0.0
    assert found.gain[position] == pytest.approx(known.gain[position], rel=1e-8)
    assert design(scenario, 0.02).analytic_cost < 0.5 * found.analytic_cost


@pytest.mark.parametrize("rate", [200.0, 1000.0])
@pytest.mark.parametrize("highpass", [None, 0.5])
def test_cost_falls_with_preview_towards_the_floor(rate, highpass):
    scenario = make_scenario("linear", {"control_rate": rate, "highpass_frequency": highpass})
    previews = [0.0, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5]
    costs = [design(scenario, preview).analytic_cost for preview in previews]
    assert np.all(np.diff(costs) < 0.0)
    # One period of preview already takes the valve lag out (SPEC 4).
    assert design(scenario, 1.0 / rate).analytic_cost < 0.6 * costs[0]
    assert floor(scenario) < costs[-1]


def test_cost_falls_with_denser_samples():
    scenario = make_scenario("linear", {"highpass_frequency": 0.5})
    costs = [design(scenario, 0.06, s * 1e-3).analytic_cost for s in (1, 2, 3, 5, 6, 10, 20)]
    assert np.all(np.diff(costs) > 0.0) and floor(scenario) < costs[0]


def test_seeing_everything_for_long_enough_is_clairvoyance():
    # The target alone counts, and is sampled wherever it counts: preview then lacks only time.
    scenario = make_scenario(
        "linear",
        {"force_weight": 0.0, "current_weight": 1.0, "physics_step": 5e-3, "highpass_frequency": 0.5},
    )
    # The loop's slowest pole is 0.996 a period: 0.14 of what is there is left after another second.
    gaps = [
        design(scenario, preview).analytic_cost / floor(scenario) - 1.0 for preview in (0.1, 1.0, 2.0)
    ]
    assert 0.04 < gaps[0] < 0.07
    assert 0.0 < gaps[2] < 0.3 * gaps[1] and gaps[1] < 1e-5


def test_the_oracle_errors_are_those_of_the_fully_informed_previews():
    scenario = make_scenario(
        "linear",
        {"force_weight": 0.0, "current_weight": 1.0, "physics_step": 5e-3, "highpass_frequency": 0.5},
    )
    known = infinite_preview(scenario.discrete, scenario.stage_cost)
    found = design(scenario, 2.0).performance
    assert found.acceleration_rms == pytest.approx(known.acceleration_rms, rel=1e-5)
    assert found.current_rms == pytest.approx(known.current_rms, rel=1e-5)


@pytest.mark.parametrize(("preview", "spacing"), [(0.02, None), (0.021, 0.007), (0.03, 0.002)])
def test_simulated_cost_agrees_with_the_analytic_one(preview, spacing):
    sensing = Sensing(preview=preview, preview_spacing=spacing)
    scenario = make_scenario("linear", {"duration": 18.0, "sensing": sensing})
    found, lanes = design(scenario, preview, spacing), 1750
    controller, simulation = PreviewFeedback(scenario), Simulation(scenario, lanes)
    seeds = np.random.SeedSequence(2009).spawn(lanes)
    observation = simulation.start(range(lanes), [np.random.default_rng(s) for s in seeds])
    # The start is forgotten with the loop's slowest pole, 0.73 rad/s: exp(-2 * 0.73 * 6) = 2e-4 of it.
    costs = np.zeros(lanes)
    for t in range(3600):
        result = simulation.step(controller.predict(observation)[0][:, 0])
        observation = result.observation
        if t >= 1200:
            costs -= result.reward / 2400
    half_width = 1.96 * np.std(costs, ddof=1) / np.sqrt(len(costs))
    assert 2.0 * half_width < 0.01 * found.analytic_cost
    assert abs(np.mean(costs) - found.analytic_cost) < half_width


def test_the_controller_is_its_design_and_reads_no_further():
    sensing = Sensing(preview=0.04, preview_spacing=0.008, last_action=True)
    scenario = make_scenario("linear", {"stories": 5, "sensing": sensing})
    found = design(scenario, 0.04, 0.008)
    controller = PreviewFeedback(scenario, found)
    n, p = scenario.plant.layout.order, 5
    assert scenario.observation.size == n + p + 1
    assert found.preview_gain.shape == (p,) and found.spacing == pytest.approx(0.008)
    rng = np.random.default_rng(5)
    observation = (0.3 * rng.standard_normal((30, n + p + 1))).astype(np.float32)
    action, memory = controller.predict(observation)
    x = observation[:, :n] * scenario.plant.state_scale
    y = observation[:, n : n + p] * np.sqrt(scenario.plant.target_variance)
    expected = np.clip((y @ found.preview_gain - x @ found.gain) / scenario.current_limit, -1.0, 1.0)
    assert action.shape == (30, 1) and action.dtype == np.float32 and memory is None
    assert action[:, 0] == pytest.approx(expected, abs=2e-6)
    single, _ = controller.predict(observation[4])
    assert single.shape == (1,) and single[0] == pytest.approx(action[4, 0], abs=1e-6)


def test_stein_sum_solves_its_equation_and_refuses_an_unstable_one():
    rng = np.random.default_rng(1)
    left, right = 0.35 * rng.standard_normal((2, 5, 5))
    middle = rng.standard_normal((5, 5))
    X = discrete_lyapunov(left, middle, right)
    assert pytest.approx(left @ X @ right + middle, abs=1e-12) == X
    with np.errstate(over="ignore", invalid="ignore"), pytest.raises(NumericalError, match="settle"):
        discrete_lyapunov(3.0 * np.eye(5), middle, 3.0 * np.eye(5))


def test_what_cannot_be_designed_says_why():
    scenario = make_scenario()
    with pytest.raises(ParameterError, match="preview"):
        design(scenario, -0.01)
    with pytest.raises(ParameterError, match="whole number of physics steps"):
        design(scenario, 0.02, 0.0015)
    with pytest.raises(ScenarioError, match="corrected"):
        design(make_scenario("as-printed"), 0.02)
    with pytest.raises(NumericalError, match="stationary"):
        design(make_scenario("linear", {"damping_ratio": 0.0, "force_weight": 0.0}), 0.02)
    with pytest.raises(ScenarioError, match="must show 20 samples"):
        PreviewFeedback(scenario, design(scenario, 0.02))
    with pytest.raises(ScenarioError, match="must show 10 samples of the coming target"):
        PreviewFeedback(
            make_scenario("linear", {"sensing": Sensing(preview=0.05)}), design(scenario, 0.02, 0.002)
        )
    with pytest.raises(ScenarioError, match="full state"):
        PreviewFeedback(make_scenario("linear", {"sensing": "laboratory"}))


HIGHPASSED = make_scenario("linear", {"highpass_frequency": 0.5, "duration": 10.0})


def test_a_weighed_position_costs_little_and_keeps_the_table_in_its_place():
    discrete, cost = HIGHPASSED.discrete, HIGHPASSED.stage_cost
    free = preview_lqr(discrete, cost, 0.1)
    barely = preview_lqr(discrete, cost, 0.1, position=1e4)
    assert barely.analytic_cost == pytest.approx(free.analytic_cost, rel=1e-5)
    costs = [preview_lqr(discrete, cost, 0.1, position=d).analytic_cost for d in (3.0, 0.3, 0.03)]
    assert free.analytic_cost < costs[0] < costs[1] < costs[2]
    position = HIGHPASSED.plant.layout.table_displacement
    assert free.gain[position] == 0.0 and preview_lqr(discrete, cost, 0.1, position=0.3).gain[position]


def test_simulated_cost_and_place_under_a_weighed_position():
    scenario = replace(HIGHPASSED, sensing=Sensing(preview=0.1))
    spread = []
    for position in (None, 3.0, 0.05):
        law = preview_lqr(scenario.discrete, scenario.stage_cost, 0.1, position=position)
        controller, simulation = PreviewFeedback(scenario, law), Simulation(scenario, 200)
        observation = simulation.start(range(200), [np.random.default_rng(i) for i in range(200)])
        cost = []
        for _ in range(1999):
            action, _ = controller.predict(observation)
            result = simulation.step(action[:, 0].astype(float))
            observation = result.observation
            cost.append(-result.reward)
        # The ground filter settles within a second.
        assert np.mean(cost[200:]) == pytest.approx(law.analytic_cost, rel=0.01)
        off = result.outcome.response.state[:, 1] - result.ground.ground[:, 2]
        spread.append(np.sqrt(np.mean(off**2)))
    assert spread[1] < 0.3 * spread[0] and spread[2] < 0.1 * spread[1]


def test_a_weighed_position_needs_the_high_pass():
    scenario = make_scenario()
    with pytest.raises(ScenarioError, match="highpass_frequency"):
        preview_lqr(scenario.discrete, scenario.stage_cost, 0.1, position=0.1)


def test_a_blind_gain_with_preview_is_the_preview_law():
    scenario = make_scenario("linear", {"sensing": Sensing(preview=0.04)})
    blind = sampled_lqr(scenario.discrete, scenario.stage_cost).gain
    row = PreviewFeedback(scenario).row
    assert with_preview(scenario, blind).row == pytest.approx(row, rel=1e-7, abs=1e-9)
    detuned = with_preview(scenario, 0.9 * blind).row
    states, preview = scenario.plant.layout.order, scenario.observation.preview
    assert detuned[preview] == pytest.approx(row[preview]) and not np.allclose(
        detuned[:states], row[:states]
    )


@pytest.mark.parametrize("position", [0.0, -0.01, float("nan"), float("inf")])
def test_a_place_that_is_no_length_is_refused(position):
    scenario = make_scenario("laboratory")
    with pytest.raises(ParameterError, match="position"):
        preview_lqr(scenario.discrete, scenario.stage_cost, 0.1, position=position)
