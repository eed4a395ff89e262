"""Drive files, transfer-function iteration and norm-optimal learning."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from baselines.iterative.drive_file import DisplacementHold, DriveFile, PeriodModel
from baselines.iterative.ilc import LearningLaw, norm_optimal_learning, tracking_error
from baselines.iterative.repeated_tests import repeat_tests, run_test
from baselines.iterative.transfer_function_iteration import (
    IterationPlan,
    Lines,
    measured_response,
    nominal_response,
    regularised_inverse,
    transfer_function_iteration,
)
from baselines.lqr.sampled import lqr
from shake_env import NoControl, Specimen, make_scenario
from shake_env.errors import ParameterError
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.motion.targets import Envelope, FilteredNoise
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.scenario.limits import Limits


def short(duration=4.0, **changes):
    """A motion that rises and dies away within a few seconds, under a table with a loop delay."""
    scenario = make_scenario("yielding")
    envelope = Envelope(rise=1.0, hold=1.0, decay_rate=3.0)
    motion = FilteredNoise(duration=duration, amplitude=scenario.motion.amplitude, envelope=envelope)
    return replace(scenario, motion=motion, delay=2.5, **changes)


def banded(residual, lines):
    """Amplitudes of a residual (N, steps) at the lines of the band."""
    return np.abs(np.fft.rfft(residual, lines.length))[:, lines.inside]


@pytest.fixture(scope="module")
def linear():
    return short(nonlinearity=Nonlinearity())


def test_measured_response_is_the_models(linear):
    scenario = linear
    plan = IterationPlan()
    lines = Lines.from_plan(scenario, plan, 800)
    quakes = noise_earthquakes(scenario, 1)
    found, test = measured_response(scenario, quakes, plan, lines)
    expected = nominal_response(scenario, plan, lines.omega[lines.inside])
    # The second of two 9 s periods: the hold's and the specimen's transients have decayed to 1e-4.
    error = np.abs(found[0, lines.inside] - expected) / np.abs(expected)
    assert np.max(error) < 5e-3 and not found[0, ~lines.inside].any()
    assert not test.stopped.any()
    rms = np.std(test.acceleration) / np.sqrt(scenario.plant.target_variance)
    assert rms == pytest.approx(plan.level * scenario.motion.amplitude, rel=0.2)


def test_period_model_is_the_continuous_plants_under_a_hold():
    """Far below the control rate a held current is a current half a period late."""
    scenario = make_scenario("linear")
    omega = 2.0 * np.pi * np.array([0.5, 1.0, 2.0])
    found = PeriodModel.from_scenario(scenario).frequency_response(omega, scenario.control_period)
    exact = scenario.plant.driven.frequency_response(omega)[:, 0, 0]
    # Held for T, then averaged over the T that follows each sample's start: together sinc^2 without lag.
    x = 0.5 * omega * scenario.control_period
    np.testing.assert_allclose(np.abs(found), np.abs(exact) * (np.sin(x) / x) ** 2, rtol=5e-3)


def test_iteration_converges_geometrically_in_its_band_at_the_predicted_rate(linear):
    plan = IterationPlan(repeats=3, gain=0.6, measured=False)
    result = transfer_function_iteration(linear, noise_earthquakes(linear, 2, seed=5), plan)
    steps = linear.motion.duration / linear.control_period
    lines = Lines.from_plan(linear, plan, round(steps))
    omega = lines.omega[lines.inside]
    G = nominal_response(linear, plan, omega)
    rate = 1.0 - plan.gain * np.real(G * regularised_inverse(linear, plan, G, omega))
    target = np.mean(result.tests.repeats[0].target, axis=-1)
    before = banded(target, lines)
    for number, test in enumerate(result.tests.repeats, start=1):
        left = banded(np.mean(test.target - test.acceleration, axis=-1), lines)
        predicted = rate**number * before
        # Norms over the band: what the motion's start and end cut off moves single lines.
        np.testing.assert_allclose(
            np.linalg.norm(left, axis=-1), np.linalg.norm(predicted, axis=-1), rtol=0.1
        )


def test_regularisation_bounds_the_correction(linear):
    plan = IterationPlan(regularisation=0.3)
    omega = 2.0 * np.pi * np.geomspace(0.2, 25.0, 200)
    G = nominal_response(linear, plan, omega)
    actuator = linear.actuator
    eps = 0.3 * omega * actuator.flow_gain * actuator.valve_gain / actuator.piston_area
    H = regularised_inverse(linear, plan, G, omega)
    assert np.all(np.abs(H) <= 0.5 / eps * (1.0 + 1e-12))
    exact = regularised_inverse(linear, replace(plan, regularisation=0.0), G, omega)
    np.testing.assert_allclose(exact * G, 1.0, rtol=1e-12)
    assert np.all(np.abs(H) < np.abs(exact))


def test_repeats_damage_a_yielding_specimen():
    scenario = short()
    result = transfer_function_iteration(
        scenario, noise_earthquakes(scenario, 1, seed=5), IterationPlan(repeats=3)
    )
    first, last = result.tests.repeats[0], result.tests.repeats[-1]
    assert np.all(last.shear_error < 0.25 * first.shear_error)
    assert np.all(np.abs(last.peak_drift / last.reference_drift - 1.0) < 0.1)
    energies = sum(t.energy for t in result.tests.repeats) + result.identification.energy
    np.testing.assert_allclose(result.damage, energies / last.perfect_energy)
    assert np.all(result.damage > 2.0)


def test_energy_is_what_the_dampers_took():
    """Linear specimen, motion died away: input energy equals the dampers' integral."""
    scenario = replace(short(8.0, nonlinearity=Nonlinearity()), delay=0, limits=Limits())
    quakes = noise_earthquakes(scenario, 1, seed=2)
    test = run_test(scenario, quakes, lqr(scenario))
    _, histories = rollout(lqr(scenario), scenario, quakes, record=[0])
    floors = (histories[0].state[:, 6:8], histories[0].reference[:, 2:4])
    for energy, rates in zip((test.energy, test.perfect_energy), floors, strict=True):
        power = np.einsum("ti,ij,tj->t", rates, scenario.specimen.damping_matrix, rates)
        # Both sums at 200 Hz, the dampers' by rectangles: motions of a few hertz, a little off.
        assert energy[0] == pytest.approx(np.sum(power) * scenario.control_period, rel=0.03)


def test_learning_law_is_the_minimum_over_dense_matrices(linear):
    steps, weight = 40, 0.02
    model = PeriodModel.from_scenario(linear, hold=0.07)
    law = LearningLaw.from_model(model, linear.stage_cost, weight, steps)
    k, m = linear.substeps, len(model.F)
    scale = np.sqrt(np.array([linear.stage_cost.acceleration, linear.stage_cost.force]) / k)
    dense = np.zeros((steps, 2, k, steps))
    for column in range(steps):
        x = np.zeros(m)
        for row in range(column, steps):
            u = 0.025 * (row == column)
            dense[row, :, :, column] = model.Z_x @ x + model.Z_u * u
            x = model.F @ x + model.G * u
    dense = (dense * scale[:, None, None]).reshape(-1, steps)
    errors = np.random.default_rng(0).standard_normal((1, steps, 2, k)) * [[1.0], [500.0]]
    e = (errors[0] * scale[:, None]).reshape(-1)
    expected = 0.025 * np.linalg.solve(dense.T @ dense + weight * np.eye(steps), dense.T @ e)
    np.testing.assert_allclose(law.correction(errors)[0], expected, rtol=1e-6, atol=1e-12)


def test_learning_lowers_the_errors_norm_in_every_repeat(linear):
    tests = norm_optimal_learning(
        linear, noise_earthquakes(linear, 2, seed=5), repeats=4, step_weight=0.1
    )
    cost = linear.stage_cost
    weights = np.array([cost.acceleration, cost.force])
    norms = [np.einsum("ntok,o->n", tracking_error(test) ** 2, weights) for test in tests.repeats]
    for before, after in pairwise(norms):
        assert np.all(after < before)
    np.testing.assert_array_equal(tests.drive, tests.controller.drive)


def test_a_wrong_model_costs_repeats_and_does_not_run_away(linear):
    """Learning for a specimen five times as heavy: some corrections overshoot, and are halved."""
    light = replace(linear, specimen=Specimen.uniform(mass_ratio=0.15, storey_frequency=9.0))
    quakes = noise_earthquakes(light, 1, seed=5)
    still, hold = run_test(light, quakes, NoControl()), DisplacementHold(light, 0.2)
    steps = still.target.shape[1]
    heavy = replace(linear, specimen=Specimen.uniform(mass_ratio=0.8, storey_frequency=6.0))
    law = LearningLaw.from_model(
        PeriodModel.from_scenario(heavy, hold.gain), light.stage_cost, 0.1, steps
    )
    tests = repeat_tests(
        light, quakes, still, lambda test: law.correction(tracking_error(test)), 4, hold
    )
    costs = np.array([test.cost[0] for test in tests.repeats])
    assert np.any(np.diff(costs) > 0.0)  # or the case is too easy to tell anything
    again = run_test(light, quakes, tests.controller)
    assert again.cost[0] == pytest.approx(costs.min()) and costs.min() < still.cost[0]
    # Uncorrected, each repeat would more than double the error at the specimen's modes, its cost thus
    # quadruple. How far one overshoots is the earthquake's; no rise follows another.
    rises = np.flatnonzero(np.diff(costs) > 0.0)
    assert np.all(np.diff(rises) > 1) and costs[-1] < costs[0]


def test_drive_file_plays_each_lane_from_its_own_start():
    drive = np.array([[0.1, 0.2, 0.3], [-0.1, -0.2, -0.3]])
    controller = DriveFile(drive)
    observation = np.zeros((2, 5), dtype=np.float32)
    action, memory = controller.predict(observation, None, np.ones(2, dtype=bool))
    np.testing.assert_allclose(action[:, 0], [0.1, -0.1], rtol=1e-6)
    action, memory = controller.predict(observation, memory, np.zeros(2, dtype=bool))
    np.testing.assert_allclose(action[:, 0], [0.2, -0.2], rtol=1e-6)
    action, memory = controller.predict(observation, memory, np.array([False, True]))
    np.testing.assert_allclose(action[:, 0], [0.3, -0.1], rtol=1e-6)
    action, memory = controller.predict(observation, memory)
    np.testing.assert_allclose(action[:, 0], [0.0, -0.2], rtol=1e-6)


def test_drive_file_for_one_table_and_with_a_feedback():
    scenario = make_scenario("laboratory")
    hold = DisplacementHold(scenario, 0.2)
    controller = DriveFile(np.array([0.1, 0.2]), hold)
    observation = np.zeros(scenario.observation.size, dtype=np.float32)
    place = scenario.observation.readings.start
    observation[place] = 0.01 / scenario.observation.reading_scale[0]
    memory = None
    for expected in (0.1, 0.2, 0.0, 0.0):
        action, memory = controller.predict(observation, memory)
        back = hold.gain * 0.01 / scenario.current_limit
        assert action.shape == (1,) and action[0] == pytest.approx(expected - back, rel=1e-5)
    batch, _ = controller.predict(np.tile(observation, (3, 1)))
    assert batch.shape == (3, 1) and np.ptp(batch) == 0.0


def test_wrong_plans_and_drives_are_refused():
    for change in ({"gain": 2.0}, {"repeats": 0}, {"low_frequency": 30.0}, {"regularisation": -1.0}):
        with pytest.raises(ParameterError):
            IterationPlan(**change)
    with pytest.raises(ParameterError, match="drive"):
        DriveFile(np.array([np.nan]))
    with pytest.raises(ParameterError, match="2 lanes"):
        DriveFile(np.zeros((2, 4))).predict(np.zeros((3, 5), dtype=np.float32))
    scenario = make_scenario("linear")
    with pytest.raises(ParameterError, match="high_frequency"):
        Lines.from_plan(scenario, IterationPlan(high_frequency=120.0), 100)
    with pytest.raises(ParameterError, match="step_weight"):
        norm_optimal_learning(scenario, noise_earthquakes(scenario, 1), step_weight=0.0)
    brief = replace(scenario, motion=FilteredNoise(duration=0.5))
    still = run_test(brief, noise_earthquakes(brief, 1), NoControl())
    assert not still.acceleration.any()


def test_an_identification_that_meets_a_limit_is_run_again_at_half_the_drive(linear):
    quakes, plan = noise_earthquakes(linear, 2), IterationPlan()
    lines = Lines.from_plan(linear, plan, 800)
    free, calm = measured_response(linear, quakes, plan, lines)
    peak = np.max(np.abs(calm.acceleration), axis=(1, 2))
    bound = Limits(table_acceleration=float(0.7 * peak.max()))
    found, test = measured_response(replace(linear, limits=bound), quakes, plan, lines)
    louder = np.max(np.abs(test.acceleration), axis=(1, 2)) / peak
    assert not test.stopped.any() and louder[np.argmax(peak)] == pytest.approx(0.5, rel=1e-3)
    assert found[:, lines.inside] == pytest.approx(free[:, lines.inside], rel=1e-2)  # linear: the same
