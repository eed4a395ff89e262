"""Designs for tables of every size: platen 20 kg to 300 t, with and without a stiffness and leakage."""

import math
from dataclasses import replace

import numpy as np
import pytest

from baselines.analysis.h2 import h2_frequency, h2_lyapunov
from baselines.lqr import design_states
from baselines.lqr.continuous import continuous_lqr
from baselines.lqr.design_states import DesignStates, displaced_table
from baselines.lqr.feedforward import FeedforwardLQR
from baselines.lqr.h_infinity import robust_feedback
from baselines.lqr.preview import preview_lqr
from baselines.lqr.sampled import ScaledProblem, riccati, sampled_lqr
from shake_env.errors import ScenarioError
from shake_env.model.nonlinearity import Friction, Nonlinearity, ServoValve
from shake_env.model.parameters import Actuator, GroundFilter, Specimen
from shake_env.scenario.scenario import Scenario


def random_table(seed: int) -> dict:
    """Parts of a scenario: everything is drawn on a logarithmic scale."""
    rng = np.random.default_rng(seed)

    def draw(low, high):
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    mass, oil = draw(20.0, 3e5), 2.0 * math.pi * draw(1.0, 60.0)
    area = mass * draw(5.0, 40.0) / 21e6  # [m^2] 0.5 to 4 g at 21 MPa
    modulus = draw(1.4e8, 1.4e9)
    pendulum = 2.0 * math.pi * draw(1e-3, 1.0)
    actuator = Actuator(
        table_mass=mass,
        table_damping=2.0 * draw(0.005, 0.1) * mass * oil,
        table_stiffness=0.0 if rng.random() < 0.2 else mass * pendulum**2,
        piston_area=area,
        oil_volume=4.0 * modulus * area**2 / (mass * oil**2),
        bulk_modulus=modulus,
        leakage=1e-16 if rng.random() < 0.3 else draw(1e-16, 1e-11),
        flow_gain=1.0,
        valve_gain=area * draw(0.2, 2.0) / draw(0.01, 0.1),  # 0.2 to 2 m/s at 10 to 100 mA
        valve_time_constant=draw(0.001, 0.025),
    )
    specimen = Specimen.uniform(
        stories=int(rng.integers(1, 8)),
        mass_ratio=draw(0.05, 2.0),
        storey_frequency=draw(1.0, 15.0),
        damping_ratio=draw(0.005, 0.1),
        table_mass=mass,
    )
    ground = GroundFilter(highpass_frequency=0.5 if rng.random() < 0.5 else None)
    return {"actuator": actuator, "specimen": specimen, "ground": ground}


def check_designs(seeds: range) -> int:
    """Design for each table, check each design; return how many scenarios said why there is none."""
    refused = 0
    for seed in seeds:
        try:
            scenario = Scenario(**random_table(seed))
        except ScenarioError as error:
            assert error.field == "physics_step"  # leakage so large that 1 ms does not resolve it
            refused += 1
            continue
        discrete, cost = scenario.discrete, scenario.stage_cost
        design = sampled_lqr(discrete, cost)  # compares J* with the closed loop's Lyapunov cost
        p = ScaledProblem.from_plant(discrete)
        Q, R, S = p.stage(cost)
        P, K = riccati(p.F, p.G, Q, R, S)
        residual = p.F.T @ P @ p.F - P + Q - (p.F.T @ P @ p.G + S) @ K
        assert np.max(np.abs(residual)) < 1e-8 * np.max(np.abs(P)), seed
        assert np.max(np.abs(np.linalg.eigvals(p.F - p.G @ K))) < 1.0, seed
        assert np.linalg.eigvalsh(P)[0] > -1e-9 * np.max(np.abs(P)), seed
        # Of the whole table one more mode is left: displaced, it stands or creeps, and the law lets it.
        lifted, scale = discrete.lifted.state, discrete.plant.state_scale
        n, period = discrete.layout.order, discrete.substeps * discrete.dt
        whole = lifted[:, :n] - np.outer(lifted[:, n], design.gain)
        rate, state = displaced_table(discrete.plant)
        if len(p.indices) < n:
            moved = (whole @ state - math.exp(-rate * period) * state) / scale
            assert np.max(np.abs(moved)) < 1e-6 * np.max(np.abs(state / scale)), seed
        assert 0.0 < design.analytic_cost < cost.motionless(discrete.plant), seed
        preview_lqr(discrete, cost, 0.1)
        q_1, q_2, r = np.sqrt([cost.acceleration, cost.force, cost.current])
        continuous_lqr(discrete.plant, q_1=q_1, q_2=q_2, r=r)
    return refused


def test_random_tables_have_designs():
    assert check_designs(range(25)) <= 1


@pytest.mark.slow
def test_1000_random_tables_have_designs():
    assert check_designs(range(1000)) < 10


def sprung(leakage: float, stiffness: float = 7e3, **changes) -> Scenario:
    return Scenario(
        actuator=Actuator(table_stiffness=stiffness, leakage=leakage),
        ground=GroundFilter(highpass_frequency=0.5),
        **changes,
    )


def test_displaced_table_is_a_mode_of_the_plant():
    scenario = sprung(1e-12)
    plant = scenario.plant
    rate, state = displaced_table(plant)
    a = plant.actuator
    slip = a.leakage * a.table_stiffness / a.piston_area**2 / (1.0 + a.table_stiffness / a.oil_stiffness)
    assert rate == pytest.approx(slip, rel=2e-4)
    scale = plant.state_scale
    remainder = plant.coupled.A @ state + rate * state
    assert np.max(np.abs((remainder / scale)[plant.layout.actuator])) < 1e-12
    # What is left is the specimen's part, which follows the table's acceleration.
    assert np.max(np.abs(remainder[plant.layout.specimen])) == pytest.approx(rate**2, rel=0.01)
    poles = np.linalg.eigvals(plant.coupled.A * scale / scale[:, None])
    assert np.min(np.abs(poles + rate)) < 1e-6 * rate + 1e-11


@pytest.mark.parametrize("leakage", [1e-13, 7e-13])
def test_leaving_the_mode_out_changes_no_cost(monkeypatch, leakage):
    scenario = sprung(leakage)
    discrete, cost = scenario.discrete, scenario.stage_cost
    assert 1e-5 < displaced_table(scenario.plant)[0] < design_states.SLOWEST
    reduced = sampled_lqr(discrete, cost)
    ahead = preview_lqr(discrete, cost, 0.1)
    robust = robust_feedback(scenario, 0.1)
    monkeypatch.setattr(design_states, "SLOWEST", 0.0)
    assert len(DesignStates.from_plant(scenario.plant).indices) == discrete.layout.order
    assert sampled_lqr(discrete, cost).analytic_cost == pytest.approx(reduced.analytic_cost, rel=1e-7)
    whole = preview_lqr(discrete, cost, 0.1)
    assert whole.analytic_cost == pytest.approx(ahead.analytic_cost, rel=1e-6)
    assert robust_feedback(scenario, 0.1).guaranteed_cost == pytest.approx(
        robust.guaranteed_cost, rel=1e-5
    )


def test_norms_of_a_sprung_table_agree_by_two_methods():
    plant = sprung(1e-16).plant
    gain = continuous_lqr(plant, q_1=0.3, q_2=1e-3, r=2.0).gain
    assert gain[plant.layout.table_displacement] != 0.0  # against the spring's pressure
    by_gramian, by_frequency = h2_lyapunov(plant, gain), h2_frequency(plant, gain)
    assert by_gramian.acceleration == pytest.approx(by_frequency.acceleration, rel=1e-5)
    assert by_gramian.base_shear == pytest.approx(by_frequency.base_shear, rel=1e-5)


def test_a_vanishing_spring_leads_to_the_free_table():
    # What a spring adds to the laws goes with its stiffness, without a jump where the mode is left out.
    parts = Nonlinearity(friction=Friction(coulomb=150.0), valve=ServoValve(supply_pressure=21e6))
    free = replace(sprung(1e-16), actuator=Actuator(), nonlinearity=parts)
    soft = sprung(1e-16, 1e-3, nonlinearity=parts)
    assert sampled_lqr(soft.discrete, soft.stage_cost).analytic_cost == pytest.approx(
        sampled_lqr(free.discrete, free.stage_cost).analytic_cost, rel=1e-7
    )
    observation = np.random.default_rng(1).standard_normal((5, free.observation.size)) * 0.3
    for position in (None, 0.03):
        np.testing.assert_allclose(
            FeedforwardLQR(soft, position=position).predict(observation)[0],
            FeedforwardLQR(free, position=position).predict(observation)[0],
            rtol=1e-4, atol=1e-5,
        )  # fmt: skip
