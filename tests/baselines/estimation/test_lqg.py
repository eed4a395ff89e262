"""LQG: prediction against a Riccati equation that knows the delay, memory, and who may use it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from lqg_loops import delayed_problem, streams
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from baselines.estimation.estimator_model import EstimatorModel, ModelError
from baselines.estimation.ground_estimate import ReferenceRecursion, predicted_ground
from baselines.estimation.kalman import KalmanFilter
from baselines.estimation.lqg import EstimatedState, estimated, full_state, lqg
from baselines.lqr.sampled import lqr, sampled_lqr
from shake_env import make_scenario
from shake_env.model.plant import REFERENCE_CURRENT
from shake_env.rollout import Earthquake, noise_earthquakes, recorded_earthquakes, rollout
from shake_env.scenario.observation import Sensing
from shake_env.simulation.simulation import Simulation

# -- the delay ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("delay", [1.0, 2.0, 5.0, 8.0, 10.0])
def test_prediction_makes_the_lqr_that_knows_the_delay(delay):
    scenario = replace(make_scenario(), delay=delay)
    F, G, Q, R, S, kept, _ = delayed_problem(scenario)
    P = solve_discrete_are(F, G, Q, R, s=S)
    K = np.linalg.solve(R + G.T @ P @ G, G.T @ P @ F + S.T)[0]
    # The wrapper's way: the gain without delay on the state ahead.
    plant, layout = scenario.plant, scenario.plant.layout
    law = sampled_lqr(scenario.discrete, scenario.stage_cost).gain * plant.state_scale
    law /= REFERENCE_CURRENT
    model = EstimatorModel.from_scenario(scenario, ModelError(force=1.0, flow=1e-8))
    c = layout.controlled.stop - layout.controlled.start
    ground, _ = predicted_ground(scenario, full_state(scenario))
    found = np.zeros(layout.order)
    w = layout.filter_states
    outside = np.r_[layout.ground, layout.reference]
    found[layout.controlled] = law[layout.controlled] @ model.ahead[:, :c]
    found[outside] = law[outside] @ ground
    # An action of 1 is the current limit, five times the reference current here.
    unit = REFERENCE_CURRENT / scenario.current_limit
    actions = law[layout.controlled] @ model.ahead[:, model.order :] * unit
    assert w == 2 and len(actions) == len(K) - len(kept)
    assert np.concatenate([found[kept], actions]) == pytest.approx(K, abs=1e-6 * np.max(np.abs(K)))


@pytest.mark.parametrize("delay", [2.0, 2.5, 5.0])
def test_a_delayed_table_is_repeated_as_well_as_its_delay_allows(delay):
    # The same ground on all: prediction knows all but the target's noise over the delay.
    scenario = replace(make_scenario("linear", {"duration": 4.0}), delay=delay)
    quakes = noise_earthquakes(scenario, 20, seed=11)

    def cost(controller):
        return np.mean([m.cost for m in rollout(controller, scenario, quakes)[0]])

    undelayed = replace(scenario, delay=0.0)
    best = np.mean([m.cost for m in rollout(lqr(undelayed), undelayed, quakes)[0]])
    assert best < cost(lqg(scenario)) < 0.5 * cost(lqr(scenario))


# -- target and reference ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["linear", "laboratory"])
def test_the_reference_specimen_is_known_from_the_filter_state(name):
    scenario = make_scenario(name)
    scale = scenario.plant.state_scale
    layout = scenario.plant.layout
    recursion = ReferenceRecursion.from_scenario(scenario)
    lanes = 200
    simulation = Simulation(scenario, lanes)
    simulation.start(range(lanes), streams(lanes, 5))
    before, guess = np.zeros((lanes, layout.filter_states)), np.zeros((lanes, 2 * layout.stories))
    errors = []
    for _ in range(400):
        ground = simulation.step(np.zeros(lanes)).ground
        now = ground.ground / scale[layout.ground]
        guess = recursion.advance(guess, before, now)
        before = now.copy()
        errors.append(guess - ground.reference / scale[layout.reference])
    spread = solve_discrete_lyapunov(recursion.S, recursion.unseen)
    # A thousandth of the reference's own size, and what the covariance says of unit intensity.
    rms = np.sqrt(np.mean(np.square(errors[200:]), axis=(0, 1)))
    assert np.all(rms < 1e-3)
    if name == "linear":
        # 200 lanes, correlated over about 0.1 s of 1 s: some 2000 values, 1.6 % of the rms each.
        assert rms == pytest.approx(np.sqrt(np.diag(spread)), rel=0.08)


def test_the_reference_specimen_is_known_under_records():
    scenario = make_scenario("records")
    motions = [replace(q.motion, duration=20.0) for q in recorded_earthquakes(scenario)]
    layout, scale = scenario.plant.layout, scenario.plant.state_scale
    recursion, lanes = ReferenceRecursion.from_scenario(scenario), len(motions)
    simulation = Simulation(scenario, lanes)
    before = simulation.start(range(lanes), streams(lanes), motions)[:, layout.ground]
    guess, errors, size = np.zeros((lanes, 2 * layout.stories)), 0.0, 0.0
    for _ in range(4000):
        result = simulation.step(np.zeros(lanes))
        now, truth = (
            result.observation[:, layout.ground],
            result.ground.reference / scale[layout.reference],
        )
        guess, before = recursion.advance(guess, before, now), now
        errors, size = errors + np.sum((guess - truth) ** 2, axis=1), size + np.sum(truth**2, axis=1)
    # The detrended integrals in x_W are not the filter's own: the longest records are 2 % off.
    assert np.all(np.sqrt(errors / size) < 0.03)
    assert np.median(np.sqrt(errors / size)) < 0.003


@pytest.mark.parametrize(
    ("delay", "preview", "spacing"), [(3.0, 0.0, None), (3.0, 0.02, None), (10.0, 0.02, 0.01)]
)
def test_foresight_is_the_conditional_mean(delay, preview, spacing):
    """Its errors have the covariance it says, and nothing in common with what was known."""
    sensing = Sensing(preview=preview, preview_spacing=spacing)
    scenario = replace(make_scenario(), delay=delay, sensing=sensing)
    layout, k = scenario.plant.layout, scenario.substeps
    scale, size = scenario.plant.state_scale, math.sqrt(scenario.plant.target_variance)
    ahead, covariance = predicted_ground(scenario, full_state(scenario))
    lanes, at, steps = 6000, 10, 10
    simulation = Simulation(scenario, lanes)
    simulation.start(range(lanes), streams(lanes, 6))
    history, known = [], None
    for t in range(at + steps):
        simulation.step(np.zeros(lanes))
        ground = simulation.engine.ground()
        if t == at - 1:
            parts = [ground.ground / scale[layout.ground], ground.reference / scale[layout.reference]]
            if ground.preview is not None:
                parts.append(ground.preview / size)
            known = np.concatenate(parts, axis=1)
        if t >= at:
            history.append(ground.target.copy() / size)
            if (t - at + 1) * k == delay:
                then = np.concatenate(
                    [ground.ground / scale[layout.ground], ground.reference / scale[layout.reference]],
                    axis=1,
                )
    target = np.concatenate(history, axis=1)  # at 1, 2, ... physics steps
    shown = full_state(scenario).observation
    places = int(delay) + shown.preview_spacing * np.arange(1, shown.preview_samples + 1) - 1
    truth, first = target[:, places], layout.filter_states + 2 * layout.stories
    rows = np.arange(first, first + len(places))
    if delay % k == 0:
        truth, rows = np.concatenate([then, truth], axis=1), np.arange(first + len(places))
    else:  # between control instants only the target is on record
        w = layout.filter_states
        row = scenario.plant.coupled.C[2, :w] * scale[:w] / size
        map_now, spread = row @ ahead[:w], row @ covariance[:w, :w] @ row
        error = target[:, int(delay) - 1] - known @ map_now
        assert np.mean(error**2) == pytest.approx(spread, rel=0.08, abs=1e-12)
        if spread > 1e-10:  # else it is a sample of the preview, and the error is rounding
            assert np.all(np.abs(np.corrcoef(error, known.T)[0, 1:]) < 4.5 / math.sqrt(lanes))
    if not len(rows):
        return
    error = truth - known @ ahead[rows].T
    expected = np.diag(covariance)[rows]
    # 6000 normal values: a variance to 1.8 %, a correlation to 0.013; at 4.5 of these.
    assert np.mean(error**2, axis=0) == pytest.approx(expected, rel=0.082, abs=1e-10)
    real = expected > 1e-10
    cross = np.corrcoef(error[:, real].T, known.T)[: real.sum(), real.sum() :]
    assert np.all(np.abs(cross) < 4.5 / math.sqrt(lanes))


def test_the_preview_on_the_physics_grid_keeps_what_is_known():
    laboratory = full_state(make_scenario("laboratory"))
    assert laboratory.observation.preview_samples == 100 and laboratory.delay == 0.0
    assert laboratory.observation.preview_spacing == 1
    whole = full_state(replace(make_scenario("laboratory"), delay=5.0))
    assert whole.observation.preview_samples == 100
    # Samples that are known come back as they are, from a delay of one period on.
    scenario = replace(make_scenario("laboratory"), delay=5.0)
    ahead, _ = predicted_ground(scenario, whole)
    first = scenario.plant.layout.filter_states + 2 * scenario.plant.layout.stories
    assert ahead[first : first + 95, first + 5 :] == pytest.approx(np.eye(95), abs=1e-6)


# -- manners -----------------------------------------------------------------------------------------


def test_one_table_is_a_batch_of_one_and_lanes_restart_alone():
    scenario = make_scenario("laboratory")
    controller = lqg(scenario)
    rng = np.random.default_rng(8)
    seen = rng.uniform(-0.05, 0.05, (12, 3, scenario.observation.size)).astype(np.float32)
    memory, actions = None, []
    for t in range(12):
        start = np.array([t == 0, t in (0, 5), t == 0])
        action, memory = controller.predict(seen[t], memory, start)
        actions.append(action)
    assert action.shape == (3, 1) and action.dtype == np.float32
    for lane, begin in ((0, 0), (1, 5), (2, 0)):
        memory = None
        for t in range(begin, 12):
            action, memory = controller.predict(seen[t, lane], memory, np.bool_(t == begin))
            assert action.shape == (1,)
            assert action == pytest.approx(actions[t][lane], rel=1e-5, abs=1e-6)


def test_memory_is_not_changed_in_place():
    scenario = make_scenario("laboratory")
    controller = lqg(scenario)
    seen = np.full((2, scenario.observation.size), 0.01, np.float32)
    _, memory = controller.predict(seen, None)
    first, _ = controller.predict(seen, memory)
    again, _ = controller.predict(seen, memory)
    assert np.array_equal(first, again)


def test_the_shown_action_counts_where_a_supervisor_changed_it():
    # With the same readings, a table that was held back is believed to be elsewhere.
    scenario = make_scenario("laboratory")
    controller = lqg(scenario)
    seen = np.full(scenario.observation.size, 0.01, np.float32)
    _, memory = controller.predict(seen, None)
    other = seen.copy()
    other[scenario.observation.last_action] = -0.3
    assert controller.predict(seen, memory)[0] != controller.predict(other, memory)[0]


def test_a_full_state_without_delay_passes_through():
    scenario = make_scenario("linear", {"duration": 2.0})
    quakes = noise_earthquakes(scenario, 4)
    direct = [m.cost for m in rollout(lqr(scenario), scenario, quakes)[0]]
    wrapped = [m.cost for m in rollout(lqg(scenario), scenario, quakes)[0]]
    # The filter leaves 1e-6 of the state's size (`ROUNDING`).
    assert wrapped == pytest.approx(direct, rel=1e-3)


@pytest.mark.parametrize("name", ["laboratory", "unknown-specimen", "records"])
def test_it_drives_what_is_measured(name):
    scenario = make_scenario(name, {} if name == "records" else {"duration": 4.0})
    quakes = noise_earthquakes(scenario, 3, seed=3)
    if name == "records":
        motions = [replace(q.motion, duration=5.0) for q in recorded_earthquakes(scenario)[:3]]
        quakes = [Earthquake("record", motion) for motion in motions]
    for controller in (lqg(scenario), estimated(scenario, lqr, accommodate=True)):
        metrics, _ = rollout(controller, scenario, quakes)
        for m in metrics:
            assert np.isfinite(m.cost)
            # What ends a test is the drift of a law that knows no position, never its force or speed.
            assert m.broken_limit in (None, "table_displacement")
            if name != "records":  # which begin with seconds too weak to overcome the friction
                assert m.acceleration_rms_error < 1.0


def test_friction_that_is_taken_out_of_the_state_no_longer_makes_the_table_compliant():
    scenario = make_scenario("laboratory", {"duration": 4.0})
    quakes = noise_earthquakes(scenario, 8, seed=21)

    def error(controller):
        metrics = rollout(controller, scenario, quakes)[0]
        return np.mean([m.base_shear_rms_error for m in metrics])

    assert error(estimated(scenario, lqr, accommodate=True)) < 0.7 * error(lqg(scenario))


def test_a_filter_of_ones_own_is_taken():
    scenario = make_scenario("laboratory")
    kalman = KalmanFilter.from_model(
        EstimatorModel.from_scenario(scenario, ModelError(force=1.0, flow=1e-9)), warm_up=3
    )
    controller = EstimatedState(scenario, lqr(full_state(scenario)), kalman)
    assert controller.estimator is kalman and len(kalman.gains) == 4
