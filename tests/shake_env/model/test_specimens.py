"""Structures from matrices and modes, against an independent simulation."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from baselines.lqr.sampled import lqr, sampled_lqr
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.nonlinearity import Friction, Nonlinearity, Yielding
from shake_env.model.parameters import Specimen
from shake_env.model.plant import specimen_plant
from shake_env.model.specimens import specimen_from_matrices, specimen_from_modes
from shake_env.rollout import noise_earthquakes
from shake_env.scenario.digest import scenario_digest
from shake_env.scenario.overrides import make_scenario
from shake_env.scenario.scenario_file import scenario_fields, scenario_of
from shake_env.simulation.simulation import Simulation

# A frame that bends: the second floor is tied to the base, and a beam couples the masses.
M = np.array([[40.0, 3.0, 0.0], [3.0, 30.0, 2.0], [0.0, 2.0, 20.0]])
K = np.array([[9.0e4, -4.0e4, 5.0e3], [-4.0e4, 7.0e4, -2.5e4], [5.0e3, -2.5e4, 2.2e4]])
FRAME = specimen_from_matrices(M, K, rayleigh=((2.0, 0.03), (8.0, 0.04)))


def modes(specimen):
    squares, shapes = eigh(specimen.stiffness_matrix, specimen.mass_matrix)
    omega = np.sqrt(squares)
    modal = np.einsum("im,ij,jm->m", shapes, specimen.damping_matrix, shapes)
    return omega / (2.0 * np.pi), modal / (2.0 * omega), shapes


def test_base_shear_is_the_sum_of_the_inertia_forces():
    # Against scipy, in absolute displacements: nothing of the program's own equations.
    C = FRAME.damping_matrix

    def ground(t):  # displacement, velocity, acceleration
        w = 2.0 * math.pi * 3.0
        return 0.01 * (1.0 - math.cos(w * t)), 0.01 * w * math.sin(w * t), 0.01 * w * w * math.cos(w * t)

    def rates(t, y):
        x, v = y[:3], y[3:]
        d, r, _ = ground(t)
        return np.concatenate([v, np.linalg.solve(M, -K @ (x - d) - C @ (v - r))])

    times = np.linspace(0.0, 1.0, 41)
    y = solve_ivp(rates, (0.0, 1.0), np.zeros(6), t_eval=times, rtol=1e-10, atol=1e-12).y
    plant = specimen_plant(FRAME)

    def own(t, x):
        return plant.A @ x + plant.B[:, 0] * ground(t)[2]

    x = solve_ivp(own, (0.0, 1.0), np.zeros(6), t_eval=times, rtol=1e-10, atol=1e-12).y
    inertia = [np.sum(M @ rates(t, y[:, k])[3:]) for k, t in enumerate(times)]
    np.testing.assert_allclose(
        -(plant.C @ x)[0], inertia, rtol=1e-6, atol=1e-6 * np.max(np.abs(inertia))
    )


def test_a_chain_given_by_its_matrices_is_the_same_plant():
    chain = Specimen(masses=(50.0, 40.0), stiffnesses=(8e4, 5e4), dampings=(90.0, 60.0))
    given = specimen_from_matrices(chain.mass_matrix, chain.stiffness_matrix, chain.damping_matrix)
    assert given.coupled and not chain.coupled
    for name in "ABC":
        np.testing.assert_allclose(
            getattr(specimen_plant(given), name), getattr(specimen_plant(chain), name), atol=1e-9
        )
    assert given.masses == chain.masses
    assert given.stiffnesses == pytest.approx(chain.stiffnesses, rel=1e-9)
    assert given.fixed_base_frequencies == pytest.approx(chain.fixed_base_frequencies, rel=1e-12)
    a, b = (replace(make_scenario(), specimen=each) for each in (given, chain))
    assert a.plant.state_scale == pytest.approx(b.plant.state_scale, rel=1e-9)
    assert a.plant.natural_frequencies == pytest.approx(b.plant.natural_frequencies, rel=1e-9)
    costs = [sampled_lqr(each.discrete, each.stage_cost).analytic_cost for each in (a, b)]
    assert costs[0] == pytest.approx(costs[1], rel=1e-9)


@pytest.mark.parametrize("parts", [Nonlinearity(), Nonlinearity(friction=Friction(coulomb=100.0))])
def test_a_table_carries_the_frame_and_its_reference_feels_the_target(parts):
    # f_s - f~_s = G (y_A - y~): what the plant returns, against scipy on the recorded accelerations.
    scenario = replace(make_scenario("linear", {"duration": 2.0}), specimen=FRAME, nonlinearity=parts)
    law, simulation = lqr(scenario), Simulation(scenario, 1)
    shown = simulation.start([0], [np.random.default_rng(3)])
    rows = []
    for _ in range(300):
        result = simulation.step(law.predict(shown)[0][:, 0])
        shown, table, ground = result.observation, result.outcome.response, result.ground
        pairs = (table.table_acceleration, table.base_shear, ground.target, ground.reference_shear)
        rows.append(np.concatenate([np.array(each, dtype=float) for each in pairs]))
    table, shear, target, reference = np.insert(np.concatenate(rows, axis=1), 0, 0.0, axis=1)
    times = scenario.physics_step * np.arange(len(table))
    for base, force in ((table, shear), (target, reference)):

        def rates(t, x, base=base):
            return specimen_rates(x, np.interp(t, times, base))

        x = solve_ivp(rates, times[[0, -1]], np.zeros(6), t_eval=times, max_step=times[1]).y
        expected = np.sum(K @ x[:3] + FRAME.damping_matrix @ x[3:], axis=0)
        assert np.max(np.abs(expected)) > 100.0
        assert np.max(np.abs(force - expected)) < 0.01 * np.max(np.abs(expected))


def specimen_rates(x, base):
    right = -K @ x[:3] - FRAME.damping_matrix @ x[3:] - M @ np.full(3, base)
    return np.concatenate([x[3:], np.linalg.solve(M, right)])


def test_damping_is_what_was_asked_for():
    f, zeta, _ = modes(FRAME)
    a, b = np.linalg.solve([[1 / (4 * np.pi * w), np.pi * w] for w in (2.0, 8.0)], [0.03, 0.04])
    assert zeta == pytest.approx(a / (4 * np.pi * f) + b * np.pi * f, rel=1e-9)
    each = specimen_from_matrices(M, K, damping_ratio=(0.01, 0.02, 0.05))
    assert modes(each)[1] == pytest.approx([0.01, 0.02, 0.05], rel=1e-9)


def test_measured_modes_come_back():
    masses = (50.0, 50.0, 40.0)
    shapes = np.array([[0.4, 1.0, 1.0], [0.75, 0.4, -1.3], [1.0, -0.9, 0.6]])
    structure = specimen_from_modes(masses, [1.8, 5.6, 9.1], [0.01, 0.015, 0.02], shapes)
    f, zeta, found = modes(structure)
    assert f == pytest.approx([1.8, 5.6, 9.1], rel=1e-9)
    assert zeta == pytest.approx([0.01, 0.015, 0.02], rel=1e-9)
    root = np.sqrt(masses)[:, None]
    for k in range(3):
        a, b = (root * shapes)[:, k], (root * found)[:, k]
        assert abs(a @ b) / np.linalg.norm(a) / np.linalg.norm(b) > 0.98  # the nearest orthogonal ones
    few = specimen_from_modes(masses, [1.8], [0.01], shapes[:, :1])
    assert modes(few)[0] == pytest.approx([1.8, 5.4, 5.4], rel=1e-9)
    assert few.masses == masses
    with pytest.raises(ParameterError, match="share of one in another"):
        specimen_from_modes(masses, [1.8, 5.6], [0.01, 0.01], shapes[:, [0, 0]])


@pytest.mark.parametrize(
    ("mass", "stiffness", "options", "what"),
    [
        (M, -K, {"damping_ratio": 0.02}, "without a force"),
        (-M, K, {"damping_ratio": 0.02}, "positive definite"),
        (M, K[:2], {"damping_ratio": 0.02}, "of one size"),
        (M, K + np.triu(np.full((3, 3), 50.0), 1), {"damping_ratio": 0.02}, "symmetric"),
        (M, K, {}, "give one of"),
        (M, K, {"rayleigh": ((2.0, 0.03), (2.0, 0.03))}, "two different frequencies"),
    ],
)
def test_what_is_no_structure_is_refused(mass, stiffness, options, what):
    with pytest.raises(ParameterError, match=what):
        specimen_from_matrices(mass, stiffness, **options)


def test_the_frame_in_a_scenario():
    scenario = replace(make_scenario(), specimen=FRAME)
    assert scenario_of(scenario_fields(scenario)) == scenario
    assert scenario_digest(scenario) != scenario_digest(
        replace(scenario, specimen=FRAME.scaled(mass=1.1))
    )
    light = FRAME.scaled(mass=0.5, frequency=2.0, damping=0.5)
    assert light.fixed_base_frequencies == pytest.approx(2.0 * FRAME.fixed_base_frequencies)
    assert modes(light)[1] == pytest.approx(0.5 * modes(FRAME)[1])
    with pytest.raises(ParameterError, match="its storeys differ"):
        make_scenario(scenario, {"mass_ratio": 0.3})
    with pytest.raises(ScenarioError, match="needs storeys"):
        replace(scenario, nonlinearity=Nonlinearity(yielding=Yielding(yield_drift=0.01)))
    assert len(noise_earthquakes(scenario, 1)) == 1
