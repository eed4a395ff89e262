"""LQG's cost: regulation and estimation, against the Lyapunov cost of the whole loop."""

import math
from dataclasses import replace

import numpy as np
import pytest
from lqg_loops import delayed_problem, streams
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from baselines.estimation.estimator_model import ModelError
from baselines.estimation.ground_estimate import ReferenceRecursion, predicted_ground
from baselines.estimation.lqg import estimated, full_state
from baselines.lqr.design_states import observable_states
from baselines.lqr.sampled import lqr, sampled_lqr
from shake_env import make_scenario
from shake_env.model.plant import REFERENCE_CURRENT
from shake_env.scenario.observation import Sensing
from shake_env.simulation.simulation import Simulation


def measured(delay=0.0, **changes):
    """The linear table under the laboratory's sensors, without offsets: they have no stationary law."""
    sensors = tuple(replace(s, bias=0.0) for s in Sensing.laboratory().sensors)
    return replace(make_scenario("linear", changes), delay=delay, sensing=Sensing(sensors=sensors))


def parts_of_the_cost(scenario, controller):
    """J* and the estimation part ``R_u E[(K e)^2]`` on a table that has no process noise itself."""
    F, G, Q, R, S, _, _ = delayed_problem(replace(scenario, delay=0.0))
    P = solve_discrete_are(F, G, Q, R, s=S)
    R_u = float((R + G.T @ P @ G)[0, 0])
    design = sampled_lqr(scenario.discrete, scenario.stage_cost)
    plant, layout = scenario.plant, scenario.plant.layout
    K = design.gain * plant.state_scale / REFERENCE_CURRENT
    model, L = controller.estimator.model, controller.estimator.gains[-1]
    loop = (np.eye(model.order) - L @ model.C) @ model.A
    e_table = solve_discrete_lyapunov(loop, L @ np.diag(model.R) @ L.T)
    recursion = ReferenceRecursion.from_scenario(scenario)
    e_reference = solve_discrete_lyapunov(recursion.S, recursion.unseen)
    ahead, noise = predicted_ground(scenario, full_state(scenario))
    outside = np.r_[layout.ground, layout.reference]
    on_table = K[layout.controlled] @ model.ahead[:, : model.order]
    on_ground = K[outside] @ ahead[:, layout.filter_states :]
    variance = on_table @ e_table @ on_table
    variance += on_ground @ e_reference @ on_ground + K[outside] @ noise @ K[outside]
    return design.analytic_cost, R_u * float(variance)


def test_the_sum_of_the_parts_is_the_lyapunov_cost_of_the_whole_loop():
    scenario = measured()
    controller = estimated(scenario, lqr, ModelError(force=20.0, flow=1e-6))
    regulation, estimation = parts_of_the_cost(scenario, controller)
    # The joint loop of plant, filter's error and reference's error, all from one noise vector.
    discrete, layout, cost = scenario.discrete, scenario.plant.layout, scenario.stage_cost
    scale = scenario.plant.state_scale
    kept = observable_states(scenario.plant)
    n, k, lifted = len(kept), discrete.substeps, discrete.lifted
    N_all = lifted.state[:, layout.order + 1 :] / scale[:, None]
    F = lifted.state[np.ix_(kept, kept)] * scale[kept] / scale[kept, None]
    G = lifted.state[kept, layout.order] * REFERENCE_CURRENT / scale[kept]
    K = sampled_lqr(discrete, cost).gain * scale / REFERENCE_CURRENT
    model, L = controller.estimator.model, controller.estimator.gains[-1]
    m, s, r = model.order, len(model.R), 2 * layout.stories
    recursion = ReferenceRecursion.from_scenario(scenario)
    draws = N_all.shape[1]
    loop = np.zeros((n + m + r, n + m + r))
    inputs = np.zeros((n + m + r, draws + s))
    on_error = np.concatenate([K[layout.controlled] @ model.ahead[:, :m], K[layout.reference]])
    u = np.concatenate([-K[kept], on_error])  # u = -K (x - e)
    loop[:n] = np.outer(G, u)
    loop[:n, :n] += F
    loop[n : n + m, n : n + m] = (np.eye(m) - L @ model.C) @ model.A
    loop[n + m :, n + m :] = recursion.S
    inputs[:n, :draws] = N_all[kept]
    inputs[n : n + m, draws:] = -L * np.sqrt(model.R)
    inputs[n + m :, :draws] = N_all[layout.reference] - recursion.W_now @ N_all[layout.ground]
    spread = solve_discrete_lyapunov(loop, inputs @ inputs.T)
    total = cost.current * REFERENCE_CURRENT**2 * (u @ spread @ u)
    errors = lifted.outputs[:, [0, 1]] - lifted.outputs[:, [2, 3]]
    for error in errors:
        for weight, row in zip((cost.acceleration, cost.force), error, strict=True):
            z = row[layout.order] * REFERENCE_CURRENT * u
            z[:n] += row[kept] * scale[kept]
            direct = row[layout.order + 1 :]
            total += weight / k * (z @ spread @ z + direct @ direct)
    assert total == pytest.approx(regulation + estimation, rel=1e-6)
    assert estimation > 0.002 * regulation  # the estimate does cost something here


def simulated(scenario, controller, lanes, seconds, warm_up, seed):
    """Mean stage cost of each lane after the warm-up [s]."""
    simulation = Simulation(scenario, lanes)
    observation = simulation.start(range(lanes), streams(lanes, seed))
    steps, skipped = (round(t * scenario.control_rate) for t in (seconds, warm_up))
    total, memory = np.zeros(lanes), None
    for t in range(steps):
        action, memory = controller.predict(observation, memory)
        result = simulation.step(action[:, 0].astype(float))
        observation = result.observation
        if t >= skipped:
            total -= result.reward
    return total / (steps - skipped)


@pytest.mark.parametrize(
    ("delay", "lanes"),
    [(0.0, 200), (5.0, 200), pytest.param(0.0, 2000, marks=pytest.mark.slow)],
)
def test_simulated_cost_is_regulation_plus_estimation(delay, lanes):
    scenario = measured(delay, duration=25.0)
    controller = estimated(scenario, lqr, ModelError(force=20.0, flow=1e-6))
    regulation, estimation = parts_of_the_cost(scenario, controller)
    seconds = 25.0 if lanes > 1000 else 10.0
    cost = simulated(scenario, controller, lanes, seconds, 4.0, seed=90)
    half_width = 1.96 * np.std(cost, ddof=1) / math.sqrt(lanes)
    assert abs(np.mean(cost) - regulation - estimation) < half_width
    if lanes > 1000:
        assert 2.0 * half_width < 0.01 * (regulation + estimation)
    # The same earthquakes under the full state: their difference is the estimation part, to a few per
    # cent of it.
    full = replace(scenario, sensing=Sensing(), delay=0.0)
    difference = cost - simulated(full, lqr(full), lanes, seconds, 4.0, seed=90)
    half_width = 1.96 * np.std(difference, ddof=1) / math.sqrt(lanes)
    assert abs(np.mean(difference) - estimation) < half_width
