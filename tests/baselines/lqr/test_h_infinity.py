"""Robust feedback: its bound on real specimens, its measured gain by a sweep, its limits."""

import numpy as np
import pytest

from baselines.lqr.h_infinity import GeneralizedPlant, robust_feedback
from baselines.lqr.preview import preview_lqr
from baselines.lqr.sampled import LinearFeedback, ScaledProblem, sampled_lqr, stationary_performance
from baselines.registry import make_baseline
from shake_env import make_scenario
from shake_env.dynamics.nonlinear import FORCE, controlled_plant
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.model.plant import REFERENCE_CURRENT
from shake_env.rollout import noise_earthquakes, rollout

MASS = 0.55


def scenario_of(mass_ratio=MASS, **overrides):
    return make_scenario("linear", {"mass_ratio": mass_ratio, **overrides})


def scaled(scenario, gain):
    p = ScaledProblem.from_plant(scenario.discrete)
    return (gain[p.indices] * p.scale / REFERENCE_CURRENT)[None, :]


@pytest.mark.parametrize("overrides", [{}, {"stories": 5, "control_rate": 500.0}], ids=str)
@pytest.mark.parametrize("rho", [0.1, 0.4, 0.8])
def test_no_mass_within_the_uncertainty_costs_more_than_guaranteed(rho, overrides):
    design = robust_feedback(scenario_of(**overrides), rho)
    assert 0.0 < design.gamma < 1.0
    for delta in np.linspace(-1.0, 1.0, 9):
        real = scenario_of(MASS * (1.0 + rho * delta), **overrides)
        cost = stationary_performance(real.discrete, real.stage_cost, design.gain).cost
        assert cost < design.guaranteed_cost


def test_not_even_a_mass_that_changes_at_each_physics_step():
    # The force of each step is the worst sign of the moment: against the table's present error.
    scenario, rho = scenario_of(), 0.4
    design = robust_feedback(scenario, rho)
    g, p = GeneralizedPlant.from_scenario(scenario), ScaledProblem.from_plant(scenario.discrete)
    K = scaled(scenario, design.gain)
    rng = np.random.default_rng(0)
    lanes, steps = 300, 3000
    x, cost = np.zeros((lanes, len(p.indices))), 0.0
    (B_w, B_d, B_u), (C_z, C_e) = g.B, g.C
    for t in range(steps):
        u, d = -x @ K.T, rng.standard_normal((lanes, B_d.shape[1]))
        w = np.zeros((lanes, B_w.shape[1]))
        for j in range(w.shape[1]):  # strictly causal: step j's shear needs earlier forces only
            z = x @ C_z[j] + w @ g.D[0][0][j] + d @ g.D[0][1][j] + u[:, 0] * g.D[0][2][j, 0]
            e = (
                x @ C_e[2 * j]
                + w @ g.D[1][0][2 * j]
                + d @ g.D[1][1][2 * j]
                + u[:, 0] * g.D[1][2][2 * j, 0]
            )
            w[:, j] = rho * np.abs(z) * np.sign(e)
        errors = x @ C_e.T + w @ g.D[1][0].T + d @ g.D[1][1].T + u @ g.D[1][2].T
        if t >= steps // 2:
            cost = cost + np.sum(errors**2, axis=1) / (steps - steps // 2)
        x = x @ g.A.T + w @ B_w.T + d @ B_d.T + u @ B_u.T
    quiet = design.performance.cost
    assert np.mean(cost) > 1.02 * quiet  # the force did harm
    assert np.mean(cost) < design.guaranteed_cost


@pytest.mark.parametrize("delta", [-0.6, 0.5])
def test_the_uncertain_force_is_another_mass(delta):
    # Held over a physics step, it is the other mass to first order in the step.
    def difference(physics_step):
        nominal = scenario_of(physics_step=physics_step)
        real = scenario_of(MASS * (1.0 + delta), physics_step=physics_step)
        g, layout = GeneralizedPlant.from_scenario(nominal), nominal.plant.layout
        loop = g.A + g.B[0] @ np.linalg.solve(np.eye(len(g.C[0])) / delta - g.D[0][0], g.C[0])
        p, q = ScaledProblem.from_plant(nominal.discrete), ScaledProblem.from_plant(real.discrete)
        ratio = q.scale / p.scale
        inside = np.flatnonzero(
            (p.indices >= layout.controlled.start) & (p.indices < layout.controlled.stop)
        )
        there = q.F * ratio[:, None] / ratio
        block = np.ix_(inside, inside)
        return np.max(np.abs(loop[block] - there[block])) / np.max(np.abs(there[block] - g.A[block]))

    coarse, fine = difference(1e-3), difference(0.25e-3)
    assert coarse < 0.15
    assert fine == pytest.approx(coarse / 4.0, rel=0.1)


def test_the_force_enters_as_in_the_nonlinear_plant():
    scenario = scenario_of(control_rate=1000.0)
    g, plant = GeneralizedPlant.from_scenario(scenario), scenario.plant
    table = controlled_plant(plant, Nonlinearity())
    kept = [0, 2, 3, *range(4, 8)]
    slow = table.B[kept, 1 + FORCE] * 1e-3 * np.sqrt(plant.reference_shear_variance)
    found = g.B[0][2 : 2 + len(kept), 0] * plant.state_scale[plant.layout.controlled][kept]
    # Of one short step the velocities feel the force directly, the other states through them.
    assert found[1] == pytest.approx(slow[1], rel=0.1)
    assert found[5:] == pytest.approx(slow[5:], rel=0.1)


def test_gamma_against_a_frequency_sweep():
    scenario, rho = scenario_of(), 0.5
    design = robust_feedback(scenario, rho)
    g, K = GeneralizedPlant.from_scenario(scenario), scaled(scenario, design.gain)
    A, C = g.A - g.B[2] @ K, rho * (g.C[0] - g.D[0][2] @ K)
    angles = np.concatenate([np.linspace(1e-4, np.pi, 4000), np.linspace(0.05, 0.3, 4000)])
    z = np.exp(1j * angles)[:, None, None]
    response = C @ np.linalg.solve(z * np.eye(len(A)) - A, g.B[0].astype(complex)) + rho * g.D[0][0]
    peak = np.max(np.linalg.norm(response, ord=2, axis=(1, 2)))
    assert peak <= design.gamma * (1.0 + 1e-8)
    assert peak == pytest.approx(design.gamma, rel=1e-3)  # the grid may step beside the peak


def test_guarantee_against_a_second_riccati_solver():
    # The game by value iteration: minimum over u of the maximum over w, period by period.
    scenario, rho = scenario_of(), 0.3
    design = robust_feedback(scenario, rho)
    g, d, k = GeneralizedPlant.from_scenario(scenario), design.scaling, scenario.substeps
    B = np.hstack([g.B[0] / d, g.B[2]])
    C = np.vstack([d * rho * g.C[0], g.C[1]])
    D = np.vstack(
        [
            d * rho * np.hstack([g.D[0][0] / d, g.D[0][2]]),
            np.hstack([g.D[1][0] / d, g.D[1][2]]),
        ]
    )
    J = np.diag([1.0] * k + [0.0])
    X = np.zeros_like(g.A)
    for _ in range(6000):
        inner = D.T @ D - J + B.T @ X @ B
        cross = D.T @ C + B.T @ X @ g.A
        X = C.T @ C + g.A.T @ X @ g.A - cross.T @ np.linalg.solve(inner, cross)
    K = np.linalg.solve(inner, cross)[-1:]
    assert scaled(scenario, design.gain) == pytest.approx(K, rel=1e-5, abs=1e-7)


def test_certain_mass_leaves_the_lqr():
    scenario = scenario_of()
    best = sampled_lqr(scenario.discrete, scenario.stage_cost).analytic_cost
    bounds = [robust_feedback(scenario, rho).guaranteed_cost / best - 1.0 for rho in (1e-4, 1e-3)]
    assert 0.0 < bounds[0] < 1e-3
    assert bounds[1] == pytest.approx(10.0 * bounds[0], rel=0.05)
    nominal = robust_feedback(scenario, 1e-4).performance.cost
    assert nominal == pytest.approx(best, rel=1e-6)


def test_more_uncertainty_costs_more():
    designs = [robust_feedback(scenario_of(), rho) for rho in (0.05, 0.2, 0.5, 0.9)]
    assert np.all(np.diff([d.guaranteed_cost for d in designs]) > 0.0)
    assert np.all(np.diff([d.performance.cost for d in designs]) > 0.0)
    # What it buys: the margin rho / gamma within which the loop is known to be stable.
    lqr_gain = scaled(scenario_of(), sampled_lqr(scenario_of().discrete, scenario_of().stage_cost).gain)
    margin = 1.0 / GeneralizedPlant.from_scenario(scenario_of()).force_gain(lqr_gain, 1.0)
    assert all(d.mass_uncertainty / d.gamma > margin for d in designs[1:])


def test_it_is_a_controller_of_the_full_state():
    scenario = scenario_of()
    design = robust_feedback(scenario, 0.3)
    action, _ = LinearFeedback(scenario, design.gain).predict(np.ones((2, 14), np.float32))
    assert action.shape == (2, 1)
    assert design.gain[scenario.plant.layout.table_displacement] == 0.0


def test_what_cannot_be_designed_says_why():
    for rho in (0.0, 1.0, -0.5):
        with pytest.raises(ParameterError, match="mass_uncertainty"):
            robust_feedback(scenario_of(), rho)
    with pytest.raises(ScenarioError, match="corrected"):
        robust_feedback(make_scenario("as-printed"), 0.2)


def test_certain_mass_leaves_the_lqr_that_minds_its_place():
    scenario = scenario_of(highpass_frequency=0.5)
    known = preview_lqr(scenario.discrete, scenario.stage_cost, 0.0, position=0.03)
    found = robust_feedback(scenario, 1e-4, position=0.03)
    scale = scenario.plant.state_scale
    # The force's worst harm is of first order in rho, with a factor of a few tens.
    assert np.max(np.abs(found.gain - known.gain) * scale) < 5e-3 * np.max(np.abs(known.gain * scale))
    assert found.performance.cost == pytest.approx(known.analytic_cost, rel=1e-3)
    assert found.guaranteed_cost > known.analytic_cost  # it contains the position's term


@pytest.mark.parametrize("name", ["h-infinity", "multi-model"])
def test_by_name_it_keeps_the_table_in_its_place(name):
    # Without a weighed position the robust law ended nine of two hundred tests at the stroke.
    scenario = make_scenario("unknown-specimen")
    rows, _ = rollout(make_baseline(name, scenario, {}), scenario, noise_earthquakes(scenario, 8, 5))
    assert all(row.broken_limit is None for row in rows)
    assert max(row.peak_displacement for row in rows) < 0.07
