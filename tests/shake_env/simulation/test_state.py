"""The state of a batch as a value: tables go on from it to the bit, in both engines, lane by lane."""

from dataclasses import replace

import numpy as np
import pytest

from shake_env import ShakeTableVectorEnv, make_scenario, numba_support
from shake_env.errors import ScenarioError
from shake_env.simulation.simulation import Simulation

SCENARIOS = ("linear", "laboratory", "yielding", "unknown-specimen", "field", "records")


@pytest.fixture(params=["compiled", "readable"])
def engine(request, monkeypatch):
    if request.param == "readable":
        monkeypatch.setattr(numba_support, "COMPILED", False)
    return request.param


def begun(name, lanes, periods=40):
    simulation = Simulation(make_scenario(name, {}), lanes)
    simulation.start(range(lanes), [np.random.default_rng(i) for i in range(lanes)])
    for t in range(periods):
        simulation.step(0.1 * np.sin(0.3 * t + np.arange(lanes)))
    return simulation


def played(simulation, periods=60):
    lanes = simulation.lanes
    results = [simulation.step(0.1 * np.cos(0.2 * t) * np.ones(lanes)) for t in range(periods)]
    return np.stack([np.concatenate([r.observation, r.report.T], axis=1) for r in results])


@pytest.mark.parametrize("name", SCENARIOS)
def test_tables_go_on_exactly_from_their_state(name, engine):
    simulation = begun(name, 3)
    state = simulation.get_state()
    assert all(isinstance(array, np.ndarray) and len(array) == 3 for array in state.values())
    expected = played(simulation)
    fresh = Simulation(simulation.scenario, 3)
    for twin in (fresh, simulation):  # a new one, and the one that has gone on
        twin.set_state(state)
        np.testing.assert_array_equal(played(twin), expected)


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_table_takes_the_place_of_another_and_the_rest_stays(name, engine):
    simulation, apart = begun(name, 5), begun(name, 5)
    simulation.set_state(simulation.get_state([3, 1]), [0, 4])
    ours, theirs = played(simulation), played(apart)
    np.testing.assert_array_equal(ours[:, [0, 4]], theirs[:, [3, 1]])
    np.testing.assert_array_equal(ours[:, 1:4], theirs[:, 1:4])
    assert np.abs(ours[:, 0] - theirs[:, 0]).max() > 0.0


def test_a_state_is_a_copy():
    simulation = begun("laboratory", 2)
    state = simulation.get_state()
    held = {name: array.copy() for name, array in state.items()}
    played(simulation)
    for name, array in state.items():
        np.testing.assert_array_equal(array, held[name])


def test_a_state_that_does_not_fit_is_refused_with_its_part():
    simulation = begun("laboratory", 2, 5)
    state = simulation.get_state()
    with pytest.raises(ScenarioError, match=r"state motion.*must be object of shape \(1,\)"):
        simulation.set_state(state, [0])
    with pytest.raises(ScenarioError, match=r"plant_values.*same scenario"):
        simulation.set_state(state | {"plant_values": np.zeros(2)})
    with pytest.raises(ScenarioError, match=r"lanes.*\[2\].*0 to 1"):
        simulation.get_state([2])
    other = Simulation(replace(simulation.scenario, delay=0), 2)
    with pytest.raises(ScenarioError, match=r"state state.*shape"):
        other.set_state(state)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_a_lane_of_a_vector_environment_goes_on_as_another_through_its_episodes(mode):
    env = ShakeTableVectorEnv(3, "laboratory", autoreset_mode=mode, duration=0.3)
    with pytest.raises(ScenarioError, match=r"reset\(\) first"):
        env.get_state()
    env.reset(seed=7)
    action = np.full((3, 1), 0.05, dtype=np.float32)
    for _ in range(61 if mode == "NextStep" else 20):  # there at an episode's end
        env.step(action)
    state = env.get_state([2])
    env.set_state(state, [0])
    for _ in range(150):  # three episodes
        observation, reward, *_ = env.step(action)
        np.testing.assert_array_equal(observation[0], observation[2])
        assert reward[0] == reward[2]
    assert reward[1] != reward[2]
    twin = ShakeTableVectorEnv(1, env.scenario, autoreset_mode=mode)
    twin.set_state(state)
    env.set_state(state, [1])
    for _ in range(150):
        ours, theirs = env.step(action), twin.step(action[:1])
        np.testing.assert_array_equal(ours[0][1], theirs[0][0])
