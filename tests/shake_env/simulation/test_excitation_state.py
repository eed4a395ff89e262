"""The ground's state: snapshots, restarts and plants that several lanes share."""

import pickle

import numpy as np
import pytest
from ground_periods import MOTIONS, PARTS, joined, keys, taken

from shake_env import FilteredNoise, RecordedMotion, make_scenario
from shake_env.motion.targets import control_steps
from shake_env.simulation.excitation import Excitation
from shake_env.simulation.simulation import Simulation


@pytest.mark.parametrize("steps", [1, 40, 150])
def test_snapshot_and_restore_go_on_exactly(steps):
    scenario = make_scenario("linear", {"stories": 3})
    excitation = Excitation(scenario.discrete, 5)
    excitation.start(range(5), MOTIONS, keys(*range(5)))
    for _ in range(steps):
        excitation.advance()
    saved = pickle.loads(pickle.dumps(excitation.get_state()))
    expected = joined([taken(excitation) for _ in range(200)])
    other = Excitation(scenario.discrete, 5)
    for twin in (other, excitation):  # a fresh one, and the one that has gone on
        twin.set_state(saved)
        found = joined([taken(twin) for _ in range(200)])
        for part in PARTS:
            assert np.array_equal(found[part], expected[part])


def test_simulation_snapshot_goes_on_exactly():
    scenario = make_scenario("linear", {"duration": 2.0, "limits": "laboratory", "amplitude": 2.0})
    simulation = Simulation(scenario, 3)
    simulation.start(range(3), [np.random.default_rng(i) for i in range(3)])
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (300, 3))

    def play(which, rows):
        results = [which.step(action) for action in rows]
        return [
            np.stack([getattr(r, part) for r in results])
            for part in ("observation", "reward", "terminated", "truncated", "limit_cost")
        ]

    play(simulation, actions[:70])
    saved = pickle.loads(pickle.dumps(simulation.get_state()))
    expected = play(simulation, actions[70:])
    twin = Simulation(scenario, 3)
    twin.set_state(saved)
    for a, b in zip(play(twin, actions[70:]), expected, strict=True):
        assert np.array_equal(a, b)
    assert expected[4].max() > 0.0  # a limit's cost knows the motion too


def test_a_restart_leaves_the_last_result_alone():
    simulation = Simulation(make_scenario(), 2)
    simulation.start(range(2), [np.random.default_rng(i) for i in range(2)])
    result = simulation.step(np.array([0.5, 0.5]))
    before = result.outcome.response.state.copy()
    simulation.start([0], [np.random.default_rng(7)])
    assert np.array_equal(result.outcome.response.state, before) and np.all(before[:, 2] != 0.0)
    assert not np.any(simulation.state[0]) and np.array_equal(simulation.state[1], before[1])


def test_a_shared_plant_has_no_shared_state():
    scenario = make_scenario()
    one, two = Excitation(scenario.discrete, 1), Excitation(scenario.discrete, 1)
    for excitation in (one, two):
        excitation.start([0], [MOTIONS[1]], keys(0))
    first = taken(one)
    one.advance().target[:] = 1e9
    assert np.array_equal(taken(two)["target"], first["target"])
    two.advance()
    again = Excitation(scenario.discrete, 1)
    again.start([0], [MOTIONS[1]], keys(0))
    again.advance()
    assert np.max(np.abs(again.advance().target)) < 1e3


@pytest.mark.parametrize(
    ("motion", "period", "steps"),
    [
        (FilteredNoise(duration=1.0), 5e-3, 200),
        (FilteredNoise(duration=0.3), 0.1, 3),  # 0.3 / 0.1 is below 3 in floating point
        (FilteredNoise(duration=0.1), 0.03, 3),
        (RecordedMotion(record="napa2014_68150_hne"), 5e-3, 6996),
    ],
)
def test_control_steps(motion, period, steps):
    assert control_steps(motion, period, 1e-3) == steps
