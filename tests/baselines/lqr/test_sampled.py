"""Sampled-data LQR: published values, an independent Riccati solver, optimality, and a simulation."""

import math
import warnings
from dataclasses import replace

import control
import numpy as np
import pytest

from baselines.lqr.design_states import observable_states
from baselines.lqr.sampled import (
    LinearFeedback,
    lqr,
    sampled_lqr,
    stationary_performance,
)
from shake_env import Actuator, make_scenario
from shake_env.errors import NumericalError, ParameterError
from shake_env.model.plant import REFERENCE_CURRENT
from shake_env.simulation.simulation import Simulation

# SPEC 4: control rate, stories, w_a, w_f -> J*, a, f, rms current [A]
PUBLISHED = [
    (200.0, 2, 1.0, 1.0, 0.208513, 0.441274, 0.072726, 0.023051),
    (200.0, 2, 1.0, 0.0, 0.199702, 0.437554, 0.167146, 0.022704),
    (200.0, 2, 0.0, 1.0, 0.009335, 0.631736, 0.042529, 0.021688),
    (500.0, 2, 1.0, 1.0, 0.096858, 0.291499, 0.032624, 0.026007),
    (1000.0, 2, 1.0, 1.0, 0.058513, 0.209065, 0.019790, 0.030013),
    (200.0, 10, 1.0, 1.0, 0.201775, 0.438093, 0.033428, 0.023361),
]

# SPEC 4: design without the specimen, on the real one: stories, mu -> a, f
UNAWARE = [
    (2, 0.1, 0.445, 0.106),
    (2, 0.2, 0.451, 0.170),
    (2, 0.5, 0.478, 0.347),
    (2, 1.0, 0.536, 0.543),
    (2, 2.0, 0.638, 0.729),
    (10, 0.1, 0.439, 0.126),
    (10, 0.2, 0.441, 0.230),
    (10, 0.5, 0.456, 0.471),
    (10, 1.0, 0.497, 0.687),
    (10, 2.0, 0.586, 0.847),
]


def design(scenario):
    return sampled_lqr(scenario.discrete, scenario.stage_cost)


def scaled_problem(scenario):
    """F, G, N, Q, R, S of the lifted problem, scaled, written again from the lifted model alone."""
    discrete, cost = scenario.discrete, scenario.stage_cost
    lifted, n = discrete.lifted, discrete.layout.order
    keep = [i for i in range(n) if i != discrete.layout.table_displacement]
    scale = discrete.plant.state_scale[keep]
    T = np.diag(scale)
    F = np.linalg.solve(T, lifted.state[np.ix_(keep, keep)] @ T)
    G = np.linalg.solve(T, lifted.state[keep, n : n + 1] * REFERENCE_CURRENT)
    N = np.linalg.solve(T, lifted.state[keep, n + 1 :])
    Q, S, R = np.zeros((len(keep),) * 2), np.zeros((len(keep), 1)), np.zeros((1, 1))
    constant = 0.0
    for output in lifted.outputs:  # one physics step
        for weight, row in (
            (cost.acceleration, output[0] - output[2]),
            (cost.force, output[1] - output[3]),
        ):
            z_x, z_u = (row[keep] * scale)[:, None], row[n] * REFERENCE_CURRENT
            Q += weight * (z_x @ z_x.T) / discrete.substeps
            S += weight * z_x * z_u / discrete.substeps
            R += weight * z_u**2 / discrete.substeps
            constant += weight * row[n + 1 :] @ row[n + 1 :] / discrete.substeps
    R += cost.current * REFERENCE_CURRENT**2
    return F, G, N, Q, R, S, constant, keep, scale


@pytest.mark.parametrize("row", PUBLISHED, ids=lambda r: f"{r[0]:g}Hz-n{r[1]}-{r[2]:g}:{r[3]:g}")
def test_reference_values_to_the_printed_digits(row):
    rate, stories, w_a, w_f, cost, a, f, current = row
    scenario = make_scenario(
        "linear",
        {
            "stories": stories,
            "control_rate": rate,
            "acceleration_weight": w_a,
            "force_weight": w_f,
        },
    )
    result = design(scenario)
    p = result.performance
    found = [result.analytic_cost, p.acceleration_rms_ratio, p.base_shear_rms_ratio, p.current_rms]
    # Six decimals were printed; half a unit of the last one.
    assert found == pytest.approx([cost, a, f, current], abs=0.5000001e-6)


@pytest.mark.parametrize(("stories", "mass_ratio", "a", "f"), UNAWARE)
def test_design_that_does_not_know_the_specimen(stories, mass_ratio, a, f):
    real = make_scenario("linear", {"stories": stories, "mass_ratio": mass_ratio})

    def ratios(design_mass_ratio):
        blind = make_scenario("linear", {"stories": stories, "mass_ratio": design_mass_ratio})
        found = stationary_performance(real.discrete, real.stage_cost, design(blind).gain)
        return found.acceleration_rms_ratio, found.base_shear_rms_ratio

    # The printed values belong to a design with a specimen of 1/1000 of the table's mass; with none at
    # all (the limit, already reached at 1e-6) the last printed digit moves by one.
    assert ratios(1e-3) == pytest.approx((a, f), abs=0.5000001e-3)
    assert ratios(1e-6) == pytest.approx((a, f), abs=1.1e-3)
    assert ratios(1e-6) == pytest.approx(ratios(1e-9), abs=2e-6)


@pytest.mark.parametrize("stories", [2, 10])
@pytest.mark.parametrize("mass_ratio", [0.1, 0.5, 2.0])
def test_design_that_knows_the_specimen_holds_for_every_mass_ratio(stories, mass_ratio):
    p = design(make_scenario("linear", {"stories": stories, "mass_ratio": mass_ratio})).performance
    expected = {2: (0.44, 0.073), 10: (0.44, 0.033)}[stories]
    assert p.acceleration_rms_ratio == pytest.approx(expected[0], abs=0.005)
    assert p.base_shear_rms_ratio == pytest.approx(expected[1], abs=0.0015)


@pytest.mark.parametrize(
    "overrides",
    [
        {},
        {"stories": 10},
        {"control_rate": 1000.0},
        {"stories": 5, "mass_ratio": 0.1, "control_rate": 500.0},
        {"force_weight": 0.0},
    ],
    ids=str,
)
def test_riccati_solution_against_python_control(overrides):
    scenario = make_scenario("linear", overrides)
    F, G, N, Q, R, S, constant, keep, scale = scaled_problem(scenario)
    P, eigenvalues, K = control.dare(F, G, Q, R, S, method="scipy")
    result = design(scenario)
    gain = result.gain[keep] * scale / REFERENCE_CURRENT
    # Riccati solutions carry the condition of the symplectic pencil: 1e-10 measured.
    assert np.max(np.abs(gain - K[0])) < 1e-6 * np.max(np.abs(K))
    assert result.analytic_cost == pytest.approx(np.trace(N.T @ P @ N) + constant, rel=1e-6)
    assert np.max(np.abs(eigenvalues)) < 1.0
    assert result.gain[scenario.plant.layout.table_displacement] == 0.0


def test_riccati_solution_against_python_control_dlqr():
    # method="scipy": SLICOT, where it is installed, gives up on eigenvalues near 1.
    scenario = make_scenario("linear", {"control_rate": 500.0})
    F, G, _, Q, R, S, _, keep, scale = scaled_problem(scenario)
    K, _, _ = control.dlqr(F, G, Q, R, S, method="scipy")
    gain = design(scenario).gain[keep] * scale / REFERENCE_CURRENT
    assert np.max(np.abs(gain - K[0])) < 1e-6 * np.max(np.abs(K))


def test_analytic_cost_equals_the_cost_of_its_parts():
    scenario = make_scenario("linear", {"stories": 5})
    result = design(scenario)
    p = result.performance
    assert p.cost == pytest.approx(result.analytic_cost, rel=1e-9)
    parts = (
        p.acceleration_rms_ratio**2
        + p.base_shear_rms_ratio**2
        + 0.01 * (p.current_rms / REFERENCE_CURRENT) ** 2
    )
    assert parts == pytest.approx(result.analytic_cost, rel=1e-9)
    assert p.acceleration_rms == pytest.approx(p.acceleration_rms_ratio * math.sqrt(9.67611), rel=1e-6)


def test_cost_of_a_motionless_table():
    # Zero gain, decoupled by hand: y_A = f_s = u = 0, so a = f = 1 and the cost is 2.
    scenario = make_scenario()
    p = stationary_performance(scenario.discrete, scenario.stage_cost, np.zeros(14))
    assert p.acceleration_rms_ratio == pytest.approx(1.0, rel=1e-9)
    assert p.base_shear_rms_ratio == pytest.approx(1.0, rel=1e-9)
    assert p.cost == pytest.approx(2.0, rel=1e-9)
    assert p.current_rms == 0.0


@pytest.mark.parametrize("overrides", [{}, {"stories": 5, "control_rate": 500.0}], ids=str)
def test_no_neighbouring_gain_costs_less(overrides):
    scenario = make_scenario("linear", overrides)
    best = design(scenario)
    kept = observable_states(scenario.plant)
    scale = scenario.plant.state_scale
    size = np.linalg.norm(best.gain * scale)
    rng = np.random.default_rng(7)
    higher = []
    for step in (1e-4, 1e-3):
        for _ in range(20):
            direction = rng.standard_normal(len(kept))
            gain = best.gain.copy()
            gain[kept] += step * size * direction / np.linalg.norm(direction) / scale[kept]
            cost = stationary_performance(scenario.discrete, scenario.stage_cost, gain).cost
            higher.append(cost / best.analytic_cost - 1.0)
    # To first order the cost does not change; what is left is a positive quadratic form.
    assert min(higher) > 0.0
    assert np.mean(higher[20:]) > 50.0 * np.mean(higher[:20])


def test_each_weight_buys_its_own_error():
    only_a, both, only_f = (
        design(make_scenario("linear", {"acceleration_weight": a, "force_weight": f})).performance
        for a, f in ((1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
    )
    assert only_a.acceleration_rms_ratio < both.acceleration_rms_ratio < only_f.acceleration_rms_ratio
    assert only_f.base_shear_rms_ratio < both.base_shear_rms_ratio < only_a.base_shear_rms_ratio
    # The paper's conclusion in sound form: 1 % of acceleration accuracy buys half the force error.
    assert both.acceleration_rms_ratio / only_a.acceleration_rms_ratio < 1.01
    assert both.base_shear_rms_ratio / only_a.base_shear_rms_ratio < 0.5


def test_simulated_cost_of_2000_earthquakes_agrees_with_the_analytic_one():
    scenario = make_scenario("linear", {"duration": 25.0})
    controller = lqr(scenario)
    lanes, steps, warm_up = 2000, 5000, 1000
    simulation = Simulation(scenario, lanes)
    seeds = np.random.SeedSequence(2009).spawn(lanes)
    observation = simulation.start(range(lanes), [np.random.default_rng(s) for s in seeds])
    total = np.zeros(lanes)
    for t in range(steps):
        result = simulation.step(controller.predict(observation)[0][:, 0])
        observation = result.observation
        if t >= warm_up:
            total -= result.reward
    # The motion starts from rest; the slowest pole of filter and closed loop is the filter's
    # 2.7 rad/s, so that after 5 s its memory of the start is exp(-2 * 2.7 * 5) = 1e-12.
    mean = total / (steps - warm_up)
    half_width = 1.96 * np.std(mean, ddof=1) / math.sqrt(lanes)
    analytic = design(scenario).analytic_cost
    assert abs(np.mean(mean) - analytic) < half_width
    assert 2.0 * half_width < 0.01 * analytic


def test_unobservable_position_is_left_out_only_without_a_table_stiffness():
    free = make_scenario()
    assert free.plant.layout.table_displacement not in observable_states(free.plant)
    held = replace(free, actuator=Actuator(table_stiffness=1e6, leakage=1e-12))
    assert list(observable_states(held.plant)) == list(range(14))


@pytest.mark.parametrize("stiffness", [1e4, 1e5, 1e6])
def test_a_table_on_springs_with_a_leaking_valve(stiffness):
    # Where K_c k_a > 0 the leak lets the spring centre the table, and the position has a use.
    scenario = replace(make_scenario(), actuator=Actuator(table_stiffness=stiffness, leakage=1e-11))
    result = design(scenario)
    assert result.gain[scenario.plant.layout.table_displacement] != 0.0
    assert result.performance.cost == pytest.approx(result.analytic_cost, rel=1e-6)
    # The spring's force is 1e6 N/m times centimetres at most, small beside the actuator's 50 kN.
    assert result.analytic_cost == pytest.approx(0.2085, rel=0.1)


def test_a_soft_spring_is_close_to_none():
    # 1 kN/m over centimetres is tens of N beside the inertia's kN.
    free = design(make_scenario()).analytic_cost
    scenario = replace(make_scenario(), actuator=Actuator(table_stiffness=1e3, leakage=1e-11))
    leaky = replace(make_scenario(), actuator=Actuator(leakage=1e-11))
    assert design(scenario).analytic_cost == pytest.approx(design(leaky).analytic_cost, rel=1e-2)
    assert design(leaky).analytic_cost == pytest.approx(free, rel=0.05)


def test_unsolvable_design_raises_a_typed_error():
    # An undamped reference specimen is neither stable nor reached by the current.
    scenario = make_scenario("linear", {"damping_ratio": 0.0, "force_weight": 0.0})
    with pytest.raises(NumericalError, match="damp every storey"):
        design(scenario)


def test_unstable_gain_raises_a_numerical_error():
    scenario = make_scenario()
    gain = design(scenario).gain
    with pytest.raises(NumericalError, match="spectral radius") as caught:
        stationary_performance(scenario.discrete, scenario.stage_cost, -gain)
    assert caught.value.value > 1.0


@pytest.mark.parametrize("gain", [np.zeros(13), np.zeros((1, 14)), np.full(14, np.nan)], ids=str)
def test_bad_gain_raises_a_parameter_error(gain):
    scenario = make_scenario()
    with pytest.raises(ParameterError, match="gain"):
        stationary_performance(scenario.discrete, scenario.stage_cost, gain)


def test_linear_feedback_is_gain_times_si_state():
    scenario = make_scenario("linear", {"stories": 5})
    n = scenario.plant.layout.order
    gain = design(scenario).gain
    rng = np.random.default_rng(3)
    x = rng.standard_normal((40, n)) * scenario.plant.state_scale
    observation = (x / scenario.plant.state_scale).astype(np.float32)
    action, memory = LinearFeedback(scenario, gain).predict(observation)
    expected = np.clip(-(x @ gain) / scenario.current_limit, -1.0, 1.0)
    assert action.shape == (40, 1) and action.dtype == np.float32 and memory is None
    # float32 observations: 6e-8 of each of the terms that nearly cancel.
    terms = np.abs(x * gain).sum(axis=1) / scenario.current_limit
    assert np.all(np.abs(action[:, 0] - expected) < 1.2e-7 * (terms + 1.0))
    single, _ = LinearFeedback(scenario, gain).predict(observation[0])
    assert single.shape == (1,)
    assert single[0] == pytest.approx(action[0, 0], abs=1e-6)


def test_linear_feedback_stays_within_the_action_space():
    scenario = make_scenario()
    controller = lqr(scenario)
    action, _ = controller.predict(np.full((3, 14), 1e3, np.float32) * [[1.0], [-1.0], [0.0]])
    assert np.all(np.abs(action) <= 1.0)
    assert set(np.abs(action[:2, 0])) == {1.0}


def test_linear_feedback_refuses_a_gain_of_another_size():
    with pytest.raises(ParameterError, match="gain shape"):
        LinearFeedback(make_scenario(), np.zeros(26))


def test_designs_of_many_plants_pass_their_own_checks():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for stories in (1, 3, 8, 12):
            for mass_ratio in (0.01, 5.0):
                for highpass in (None, 0.5):
                    scenario = make_scenario(
                        "linear",
                        {
                            "stories": stories,
                            "mass_ratio": mass_ratio,
                            "highpass_frequency": highpass,
                            "current_weight": 1e-6,
                        },
                    )
                    assert 0.0 < design(scenario).analytic_cost < 1.0
