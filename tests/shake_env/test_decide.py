"""No controller can change what its caller reads: roll-outs, wrappers and the supervisor."""

import numpy as np
import pytest

from agents.evaluation.comparison import decision_time
from agents.evaluation.perturbations import NoisyState
from baselines.estimation.lqg import lqg
from baselines.iterative.drive_file import DriveFile
from baselines.lqr.oracle import PerLane, Rescaled
from baselines.servo.disturbance_observer import DisturbanceObserver
from shake_env import NoControl, Supervised, make_scenario
from shake_env.controller import decide
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.simulation.simulation import Simulation


class Writing:
    """Full current; changes every array that it is given."""

    def __init__(self, factor, force):
        self.factor, self.force, self.written = factor, force, 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        if self.force:
            observation.flags.writeable = True
        observation *= self.factor
        if episode_start is not None:
            episode_start[...] = ~episode_start
        self.written += 1
        return np.ones((*observation.shape[:-1], 1)), None


def wrappers(scenario, inner, lanes):
    """Every controller that asks another one."""
    size = scenario.observation.size
    return {
        "supervised": Supervised(inner, scenario),
        "noisy state": NoisyState(inner, 0.0, slice(0, 2), range(lanes)),
        "one a lane": PerLane([inner] * lanes),
        "rescaled": Rescaled(inner, np.ones(size)),
        "disturbance observer": DisturbanceObserver(scenario, inner),
        "drive file": DriveFile(np.zeros(9), inner),
    }


NAMES = ("supervised", "noisy state", "one a lane", "rescaled", "disturbance observer", "drive file")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("factor", [0.1, 0.0])
def test_a_wrapper_acts_and_remembers_the_same_when_its_controller_writes(name, factor):
    scenario = make_scenario("laboratory")
    r, lanes = np.random.default_rng(0), 3
    honest = wrappers(scenario, Constant(), lanes)[name]
    writing = Writing(factor, force=True)
    deceived = wrappers(scenario, writing, lanes)[name]
    states = [None, None]
    for k in range(4):
        observation = (0.1 * r.normal(size=(lanes, scenario.observation.size))).astype(np.float32)
        before, begins = observation.copy(), np.full(lanes, k == 0)
        actions = []
        for i, controller in enumerate((honest, deceived)):
            action, states[i] = controller.predict(observation, states[i], begins)
            actions.append(action)
        assert np.array_equal(observation, before) and begins.tolist() == [k == 0] * lanes
        assert np.array_equal(*actions)
    assert writing.written >= 4


class Constant:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.ones((*observation.shape[:-1], 1)), None


@pytest.mark.parametrize("name", NAMES)
def test_what_is_handed_out_is_read_only(name):
    scenario = make_scenario("laboratory")
    controller = wrappers(scenario, Writing(0.1, force=False), 2)[name]
    observation = np.full((2, scenario.observation.size), 0.1, dtype=np.float32)
    with pytest.raises(ValueError, match="read-only"):
        controller.predict(observation)
    assert (observation == np.float32(0.1)).all() and observation.flags.writeable


@pytest.mark.parametrize("factor", [0.1, 0.0])
def test_a_controller_that_writes_breaks_no_limit_under_the_supervisor(factor):
    scenario = make_scenario("laboratory", {"duration": 1.5})
    quakes = noise_earthquakes(scenario, 8, 40)
    metrics, _ = rollout(Supervised(Writing(factor, force=True), scenario), scenario, quakes)
    assert {each.broken_limit for each in metrics} == {None}


def test_a_roll_out_and_the_clock_hand_out_read_only_arrays():
    scenario = make_scenario("laboratory", {"duration": 0.5})
    with pytest.raises(ValueError, match="read-only"):
        rollout(Writing(0.1, force=False), scenario, noise_earthquakes(scenario, 2, 40))
    with pytest.raises(ValueError, match="read-only"):
        decision_time(Writing(0.1, force=False), scenario, decisions=2)


def test_an_estimate_remembers_nothing_of_the_callers_array():
    scenario = make_scenario("laboratory")
    controller, simulation = lqg(scenario), Simulation(scenario, 1)
    observation = simulation.start([0], [np.random.default_rng(0)]).astype(float)
    _, state = controller.predict(observation)
    before = state[0].ground.copy()
    observation[:] = 1.0
    assert np.array_equal(state[0].ground, before)


def test_decide_passes_everything_on():
    class Asked:
        def predict(self, *arguments):
            self.arguments = arguments
            return arguments[0], arguments[1]

    asked, observation, memory = Asked(), np.ones(3, dtype=np.float32), (np.zeros(2),)
    decide(asked, observation, memory, np.array([True]), False)
    shown, state, begins, deterministic = asked.arguments
    assert np.array_equal(shown, observation) and state is memory
    assert begins.tolist() == [True] and deterministic is False
    decide(NoControl(), observation)
