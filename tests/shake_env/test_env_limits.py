"""Limits: when an episode ends early, what that costs, and that it never pays."""

import numpy as np
import pytest

from baselines.lqr.sampled import lqr
from shake_env import (
    Limits,
    Objective,
    ShakeTableEnv,
    make_scenario,
)
from shake_env.errors import ScenarioError
from shake_env.simulation.simulation import Simulation


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        (Limits(table_displacement=1e-4), "table_displacement"),
        (Limits(table_velocity=1e-2), "table_velocity"),
        (Limits(load_pressure=1e5), "load_pressure"),
        (Limits(table_acceleration=1.0), "table_acceleration"),
        (Limits(state_limit=0.5), "diverged"),
        ("laboratory", None),
    ],
    ids=str,
)
def test_a_broken_limit_terminates_and_costs(limits, reason):
    env = ShakeTableEnv(limits=limits, duration=2.0)
    observation, _ = env.reset(seed=0)
    taken, terminated = 0, False
    while not terminated:
        observation, reward, terminated, truncated, info = env.step(np.ones(1))
        taken += 1
        assert terminated or (info["limit_cost"] == 0.0 and "broken_limit" not in info)
    assert not truncated
    assert env.observation_space.contains(observation)
    if reason is not None:
        assert info["broken_limit"] == reason
    # Five times the stationary cost of standing still, 2, for each period left.
    assert info["limit_cost"] == pytest.approx(5.0 * 2.0 * (400 - taken), rel=1e-9)
    assert reward < -info["limit_cost"]
    with pytest.raises(ScenarioError, match="reset"):
        env.step(np.zeros(1))


@pytest.mark.parametrize("limit", ["table_displacement", "table_velocity", "load_pressure"])
def test_a_limit_holds_up_to_its_value(limit):
    """The state that breaks a limit is the first beyond it."""
    free = ShakeTableEnv(duration=1.0)
    free.reset(seed=0)
    history = [abs(free.step(np.full(1, 0.2))[4][limit]) for _ in range(30)]
    bound = np.median(history)
    first = int(np.argmax(np.array(history) > bound))
    env = ShakeTableEnv(duration=1.0, limits=Limits(**{limit: bound}))
    env.reset(seed=0)
    for t in range(first + 1):
        terminated = env.step(np.full(1, 0.2))[2]
        assert terminated == (t == first)


def test_a_limit_broken_on_the_last_step_is_no_truncation():
    env = ShakeTableEnv(limits=Limits(load_pressure=1e5), duration=0.1)
    env.reset(seed=0)
    for _ in range(19):
        assert env.step(np.zeros(1))[2:4] == (False, False)
    *_, terminated, truncated, info = env.step(np.ones(1))
    assert (terminated, truncated) == (True, False)
    assert info["limit_cost"] == pytest.approx(10.0, rel=1e-9)  # of one period at least


def test_divergence_ends_an_episode_even_without_limits():
    # The negative of LQR's gain is unstable: it pumps the oil column as far as the current reaches.
    scenario = make_scenario("linear", {"duration": 20.0})
    controller = lqr(scenario)
    limited = ShakeTableEnv(scenario, limits=Limits(state_limit=5.0))
    observation, _ = limited.reset(seed=0)
    for _ in range(4000):
        action, _ = controller.predict(observation)
        observation, _, terminated, truncated, info = limited.step(-action)
        if terminated or truncated:
            break
    assert terminated and info["broken_limit"] == "diverged"


def test_drifting_position_alone_never_ends_an_episode():
    scenario = make_scenario("linear", {"duration": 20.0})
    env = ShakeTableEnv(scenario)
    env.reset(seed=0)
    for _ in range(3999):
        observation, _, terminated, _, info = env.step(np.full(1, 0.4))
        assert not terminated
    # 0.05 A give 114 l/min, 0.8 m/s for twenty seconds.
    assert info["table_displacement"] > 5.0
    assert env.observation_space.contains(observation)


def crashes(overrides, lanes=200):
    """Costs from a random moment on: of running into a limit there, and of standing still."""
    scenario = make_scenario("linear", {"limits": "laboratory", **overrides})

    def costs(policy):
        simulation = Simulation(scenario, lanes)
        simulation.start(range(lanes), [np.random.default_rng(i) for i in range(lanes)])
        steps = int(simulation.episode_steps[0])
        cost, over, broke = np.zeros((steps, lanes)), np.zeros(lanes, bool), np.zeros(lanes, bool)
        for t in range(steps):
            result = simulation.step(policy(t, steps))
            cost[t] = np.where(over, 0.0, -result.reward)
            broke |= result.terminated & ~over
            over |= result.terminated
        return cost, broke

    steps_all = np.arange(lanes)
    still, _ = costs(lambda t, steps: np.zeros(lanes))
    results = []
    for sign in (1.0, -1.0):
        begin = np.linspace(0, len(still) - 1, lanes).astype(int)
        crash, broke = costs(lambda t, steps, b=begin, s=sign: np.where(t >= b, s, 0.0))
        after = np.arange(len(still))[:, None] >= begin
        results.append(((crash * after).sum(0)[broke], (still * after).sum(0)[broke]))
        assert len(steps_all[broke]) > 0.9 * lanes
    return np.concatenate(results, axis=1)


@pytest.mark.parametrize(
    "overrides",
    [
        {"duration": 6.0},
        {"duration": 6.0, "amplitude": 3.0},
        {"duration": 6.0, "amplitude": 0.34, "highpass_frequency": 0.5},
        {"duration": 6.0, "objective": Objective.raw(1.0, 1e-3)},
        {"record": "napa2014_68150_hne", "duration": 10.0},
    ],
    ids=str,
)
def test_crashing_never_pays(overrides):
    crash, still = crashes(overrides)
    assert np.all(crash > still), np.min(crash / still)


def test_the_cost_of_a_limit_grows_with_the_motion():
    # Without this a strong motion makes standing still dearer than a crash.
    costs = []
    for amplitude in (0.3, 1.0, 3.0):
        env = ShakeTableEnv(limits=Limits(load_pressure=1e5), duration=1.0, amplitude=amplitude)
        env.reset(seed=0)
        costs.append(env.step(np.ones(1))[4]["limit_cost"])
    assert costs == pytest.approx([1990.0, 1990.0, 9 * 1990.0], rel=1e-9)


def test_the_horizon_of_the_limit_cost():
    env = ShakeTableEnv(limits=Limits(load_pressure=1e5, cost_horizon=0.1), duration=1.0)
    env.reset(seed=0)
    assert env.step(np.ones(1))[4]["limit_cost"] == pytest.approx(10.0 * 20, rel=1e-9)
