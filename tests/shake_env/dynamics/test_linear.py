"""The kernel against the full-state model, physics step by physics step; what the equations mean."""

from dataclasses import replace

import numpy as np
import pytest

from shake_env import Actuator, GroundFilter, ModelEquations, RecordedMotion, Specimen, make_scenario
from shake_env.dynamics.linear import TableDynamics
from shake_env.model.discretization import (
    DiscretePlant,
    first_order_hold,
    noise_covariance,
    noise_factor,
    zero_order_hold,
)
from shake_env.model.plant import CoupledPlant, StateSpace, specimen_plant
from shake_env.model.random_numbers import GROUND, episode_key, normals
from shake_env.motion.targets import target_history
from shake_env.simulation.simulation import Simulation

EQUATIONS = {
    "corrected": ModelEquations(),
    "as printed": ModelEquations.as_printed(),
    "one switch": ModelEquations(reaction_on_table=False),
}


def random_specimen(stories):
    rng = np.random.default_rng(stories)
    return Specimen(
        masses=rng.uniform(5.0, 60.0, stories),
        stiffnesses=rng.uniform(3e4, 3e5, stories),
        dampings=rng.uniform(20.0, 200.0, stories),
    )


def plant(equations, stories=3, highpass=None):
    return CoupledPlant(
        Actuator(), random_specimen(stories), GroundFilter(highpass_frequency=highpass), equations
    )


def largest(values, axis=0):
    return np.max(np.abs(values), axis=axis)


def augmented(p, dt):
    """The coupled plant with a third specimen whose base moves by ``y_A - y~``, discretised exactly.

    Outputs ``[y_A, f_s, y~, f~_s, f_3]``; the noise is drawn for all states together.
    """
    coupled, building = p.coupled, specimen_plant(p.specimen)
    n, m = coupled.order, building.order
    error = coupled.C[0] - coupled.C[2]
    A = np.block([[coupled.A, np.zeros((n, m))], [building.B @ error[None, :], building.A]])
    B = np.vstack([coupled.B, np.zeros((m, 2))])
    C = np.zeros((5, n + m))
    C[:4, :n], C[4, n:] = coupled.C, building.C[0]
    scale = np.concatenate([p.state_scale, p.state_scale[p.layout.reference]])
    model = zero_order_hold(StateSpace(A, B[:, :1], C, np.zeros((5, 1))), dt, scale)
    return model, noise_factor(noise_covariance(A, B[:, 1:], dt, scale), scale)


def tracking_run(equations, stories, seconds=3.0):
    """Force error of the kernel's table and what G_S makes of the acceleration error."""
    p = plant(equations, stories)
    discrete = DiscretePlant(p, 1e-3, 5)
    model, noise = augmented(p, 1e-3)
    kernel = TableDynamics.from_plant(discrete)
    steps, rng = round(seconds / 5e-3), np.random.default_rng(0)
    current = np.cumsum(0.004 * rng.standard_normal(steps))
    x, table = np.zeros(model.order), np.zeros(kernel.states)
    found, expected = [], []
    for u in current:
        response = kernel.control_step(table, np.asarray(u))
        table = response.state
        for j in range(5):
            x = model.A @ x + model.B[:, 0] * u + noise @ rng.standard_normal(noise.shape[1])
            _, f_s, _, reference, third = model.C @ x
            shear = f_s if equations.specimen_feels_target else response.base_shear[j]
            found.append(shear - reference)
            expected.append(third)
    return np.array(found), np.array(expected)


@pytest.mark.parametrize("stories", [1, 2, 5, 10])
def test_force_error_is_the_specimen_times_the_acceleration_error(stories):
    """f_s - f~_s = G_S (y_A - y~): force tracking is acceleration tracking seen by the specimen."""
    found, expected = tracking_run(ModelEquations(), stories)
    assert largest(found - expected) < 1e-9 * largest(expected)
    assert largest(expected) > 10.0  # newtons: there is something to compare


def test_force_error_is_something_else_as_printed():
    found, expected = tracking_run(ModelEquations.as_printed(), 2)
    assert largest(found - expected) > 0.1 * largest(expected)


@pytest.mark.parametrize("stories", [1, 5])
def test_force_error_in_the_frequency_domain(stories):
    p = plant(ModelEquations(), stories)
    omega = np.logspace(0, 3, 80)
    response = p.coupled.frequency_response(omega)
    G_S = specimen_plant(p.specimen).frequency_response(omega)[:, 0, 0]
    for source in (0, 1):
        y_A, f_s, y, reference = response[:, :, source].T
        assert f_s - reference == pytest.approx(G_S * (y_A - y), rel=1e-9)


@pytest.mark.parametrize(("name", "ratio"), [("corrected", 1.0), ("as printed", 2.0)])
def test_perfect_acceleration_tracking(name, ratio):
    """With y_A = y~ at every frequency the shear is the reference's; as printed it is twice that."""
    p = plant(EQUATIONS[name], 2)
    response = p.coupled.frequency_response(np.logspace(-0.5, 2.5, 60))
    by_u, by_w = response[:, :, 0], response[:, :, 1]
    u = (by_w[:, 2] - by_w[:, 0]) / by_u[:, 0]
    shear = by_w[:, 1] + by_u[:, 1] * u
    assert shear == pytest.approx(ratio * by_w[:, 3], rel=1e-8)


@pytest.mark.parametrize("name", EQUATIONS)
@pytest.mark.parametrize("highpass", [None, 0.5])
def test_kernel_under_noise_against_physics_steps(name, highpass):
    scenario = replace(
        make_scenario("linear", {"specimen": random_specimen(3), "duration": 1.5}),
        equations=EQUATIONS[name],
        ground=GroundFilter(highpass_frequency=highpass),
    )
    discrete, layout, k = scenario.discrete, scenario.plant.layout, scenario.substeps
    model, noise = discrete.model, discrete.noise
    steps = 300  # past several blocks
    simulation = Simulation(scenario, 1)
    simulation.start([0], [np.random.default_rng(3)])
    key = episode_key(np.random.default_rng(3))
    draws = normals(key, np.arange(steps), GROUND, k * noise.shape[1]).reshape(steps * k, -1)
    actions = np.random.default_rng(4).uniform(-0.3, 0.3, steps)

    x, found, expected, states, kernel_states = np.zeros(layout.order), [], [], [], []
    for t, action in enumerate(actions):
        result = simulation.step(np.array([action]))
        response, ground = result.outcome.response, result.ground
        found.append(
            np.stack(
                [
                    response.table_acceleration[0],
                    response.base_shear[0],
                    ground.target[0],
                    ground.reference_shear[0],
                ],
                axis=-1,
            )
        )
        kernel_states.append(np.concatenate([ground.ground[0], response.state[0], ground.reference[0]]))
        for j in range(k):
            x = model.A @ x + model.B[:, 0] * (0.125 * action) + noise @ draws[t * k + j]
            expected.append(model.C @ x)
        states.append(x)
    found, expected = np.concatenate(found), np.array(expected)
    assert np.all(largest(found - expected) < 1e-12 * largest(expected))
    states, kernel_states = np.array(states), np.array(kernel_states)
    assert np.all(largest(kernel_states - states) < 1e-12 * largest(states))


@pytest.mark.parametrize("name", EQUATIONS)
def test_kernel_under_a_record_against_physics_steps(name):
    motion = RecordedMotion(record="ridgecrest2019_clc_90", duration=2.0, amplitude=3.0)
    scenario = replace(
        make_scenario("linear", {"specimen": random_specimen(2), "motion": motion}),
        equations=EQUATIONS[name],
    )
    p, k = scenario.plant, scenario.substeps
    scale = p.state_scale[p.layout.filter_states :]
    model, B_next = first_order_hold(p.driven, 1e-3, scale)
    target = target_history(motion, 1e-3).acceleration
    simulation = Simulation(scenario, 1)
    simulation.start([0], [np.random.default_rng(0)])
    actions = np.random.default_rng(4).uniform(-0.3, 0.3, 400)
    x, found, expected = np.zeros(p.driven.order), [], []
    for t, action in enumerate(actions):
        result = simulation.step(np.array([action]))
        response, ground = result.outcome.response, result.ground
        found.append(
            np.stack(
                [response.table_acceleration[0], response.base_shear[0], ground.reference_shear[0]],
                axis=-1,
            )
        )
        for j in range(t * k, (t + 1) * k):
            now = np.array([0.125 * action, target[j]])
            following = np.array([0.125 * action, target[j + 1]])
            x = model.A @ x + model.B @ now + B_next @ following
            expected.append(model.C @ x)
    found, expected = np.concatenate(found), np.array(expected)
    assert np.all(largest(found - expected) < 1e-12 * largest(expected))


@pytest.mark.parametrize("substeps", [1, 2, 5, 20])
def test_one_period_is_its_physics_steps_for_any_rate(substeps):
    p = plant(ModelEquations())
    discrete = DiscretePlant(p, 1e-3, substeps)
    keep = np.r_[p.layout.controlled]
    model, kernel = discrete.model, TableDynamics.from_plant(discrete)
    x0 = np.random.default_rng(0).standard_normal(len(keep)) * p.state_scale[keep]
    response = kernel.control_step(x0, np.asarray(0.02))
    x = np.zeros(p.layout.order)
    x[keep] = x0
    scale = p.state_scale[keep]
    for j in range(substeps):
        x = model.A @ x + model.B[:, 0] * 0.02
        y_A, f_s, _, _ = model.C @ x
        assert response.table_acceleration[j] == pytest.approx(y_A, rel=1e-12)
        assert response.base_shear[j] == pytest.approx(f_s, rel=1e-12)
    assert largest((response.state - x[keep]) / scale) < 1e-12 * largest(x[keep] / scale)


def test_finer_physics_steps_change_nothing_at_the_period_ends():
    # Exact discretisation has no step error; only the stage cost's samples lie closer.
    coarse, fine = (
        TableDynamics.from_plant(DiscretePlant(plant(ModelEquations()), dt, n))
        for dt, n in ((1e-3, 5), (2.5e-4, 20))
    )
    scale = plant(ModelEquations()).state_scale[2:12]
    x = y = np.random.default_rng(1).standard_normal(10) * scale
    for u in np.random.default_rng(2).uniform(-0.1, 0.1, 200):
        a, b = coarse.control_step(x, np.asarray(u)), fine.control_step(y, np.asarray(u))
        assert b.base_shear[3::4] == pytest.approx(
            a.base_shear, rel=1e-9, abs=1e-9 * largest(a.base_shear)
        )
        x, y = a.state, b.state
    assert largest((x - y) / scale) < 1e-10 * largest(x / scale)


def test_update_is_linear():
    kernel = TableDynamics.from_plant(DiscretePlant(plant(ModelEquations()), 1e-3, 5))
    rng = np.random.default_rng(3)
    scale = plant(ModelEquations()).state_scale[2:12]
    x, y = rng.standard_normal((2, 6, 10)) * scale
    u, v = rng.standard_normal((2, 6)) * 0.05
    drive = rng.standard_normal((6, 20))
    a, b = kernel.control_step(x, u, drive), kernel.control_step(y, v)
    both = kernel.control_step(2.0 * x - 3.0 * y, 2.0 * u - 3.0 * v, 2.0 * drive)
    for field in ("state", "table_acceleration", "base_shear"):
        expected = 2.0 * getattr(a, field) - 3.0 * getattr(b, field)
        difference = largest(getattr(both, field) - expected)
        assert np.all(difference < 1e-12 * (largest(getattr(a, field)) + largest(expected)))


def test_rest_stays_at_rest():
    for name in EQUATIONS:
        kernel = TableDynamics.from_plant(DiscretePlant(plant(EQUATIONS[name]), 1e-3, 5))
        response = kernel.control_step(np.zeros(10), np.zeros(()))
        assert not np.any(response.state) and not np.any(response.base_shear)


def test_leading_axes_are_the_batch():
    kernel = TableDynamics.from_plant(DiscretePlant(plant(ModelEquations()), 1e-3, 5))
    rng = np.random.default_rng(3)
    x = rng.standard_normal((4, 3, 10)) * plant(ModelEquations()).state_scale[2:12]
    u = rng.standard_normal((4, 3))
    batch = kernel.control_step(x, u)
    assert batch.state.shape == (4, 3, 10) and batch.base_shear.shape == (4, 3, 5)
    for i in np.ndindex(4, 3):
        single = kernel.control_step(x[i], np.asarray(u[i]))
        assert batch.state[i] == pytest.approx(single.state, rel=1e-11)
        assert batch.base_shear[i] == pytest.approx(single.base_shear, rel=1e-11)


def test_target_does_not_reach_the_table_in_the_corrected_equations():
    tables = []
    for seed in (0, 1):
        simulation = Simulation(make_scenario(), 1)
        simulation.start([0], [np.random.default_rng(seed)])
        for action in np.random.default_rng(9).uniform(-0.2, 0.2, 100):
            result = simulation.step(np.array([action]))
        assert result.ground.drive is None
        tables.append(result.outcome.response.state)
    assert np.array_equal(*tables)


def test_target_moves_the_specimen_of_a_motionless_table_as_printed():
    # Zero current: SPEC 3, f_s = f~_s while the reaction leaves the table nearly at rest.
    simulation = Simulation(make_scenario("as-printed", {"mass_ratio": 1e-6, "force_weight": 0.0}), 1)
    simulation.start([0], [np.random.default_rng(0)])
    shear, reference = [], []
    for _ in range(400):
        result = simulation.step(np.zeros(1))
        shear.append(result.outcome.response.base_shear[0])
        reference.append(result.ground.reference_shear[0].copy())
    difference = np.abs(np.array(shear) - np.array(reference)).max()
    assert difference < 1e-4 * np.abs(reference).max()
