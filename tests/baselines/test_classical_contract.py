"""What every classical controller on measured signals keeps to, whatever its idea."""

import copy

import numpy as np
import pytest

from baselines.servo.disturbance_observer import DisturbanceObserver
from baselines.servo.inverse_model import InverseDesign, InverseFeedForward
from baselines.servo.mcs import MCS, MCSDesign
from baselines.servo.pid import pid
from baselines.servo.tvc import TVCDesign, tvc
from shake_env.controller import Controller
from shake_env.scenario.overrides import make_scenario
from shake_env.simulation.simulation import Simulation

CONTROLLERS = {
    "pid": pid,
    "tvc": tvc,
    "inverse-ff": InverseFeedForward,
    "inverse with feedback": lambda s: InverseFeedForward(s, InverseDesign(feedback=TVCDesign())),
    "mcs": MCS,
    "mcs bounded": lambda s: MCS(s, MCSDesign.bounded()),
    "observer around tvc": lambda s: DisturbanceObserver(s, tvc(s)),
    "observer around mcs": lambda s: DisturbanceObserver(s, MCS(s)),
}
SCENARIOS = {
    "laboratory": lambda: make_scenario("laboratory"),
    "full": lambda: make_scenario("laboratory", {"sensing": "full"}),
    "drifting": lambda: make_scenario("linear", {"delay": 2, "sensing": "laboratory"}),
}


def observations(scenario, lanes, steps, seed=0):
    simulation, rng = Simulation(scenario, lanes), np.random.default_rng(seed)
    streams = [np.random.default_rng(seed + i) for i in range(lanes)]
    shown = [simulation.start(range(lanes), streams)]
    for _ in range(steps - 1):
        shown.append(simulation.step(rng.uniform(-0.3, 0.3, lanes)).observation.copy())
    return np.stack(shown)


def arrays(memory):
    """The arrays of a memory, those of a wrapped controller's included."""
    for part in memory:
        if isinstance(part, tuple):
            yield from arrays(part)
        else:
            yield part


@pytest.fixture(params=SCENARIOS, scope="module")
def shown(request):
    scenario = SCENARIOS[request.param]()
    return scenario, observations(scenario, 3, 40)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_batch_is_single_and_memory_begins_afresh(name, shown):
    scenario, observed = shown
    controller = CONTROLLERS[name](scenario)
    assert isinstance(controller, Controller)
    batch, memory = [], None
    for t, row in enumerate(observed):
        # Lane 1 begins a new episode half way; the other two go on.
        start = np.array([t == 0, t in (0, 20), t == 0])
        action, memory = controller.predict(row, memory, start)
        assert action.shape == (3, 1) and action.dtype == np.float32
        assert np.all(np.abs(action) <= 1.0)
        batch.append(action[:, 0])
    batch = np.stack(batch)
    assert np.all(np.std(batch, axis=0) > 1e-5)  # it acts in each
    for lane, first in ((0, 0), (1, 20), (2, 0)):
        memory = None
        for t in range(first, len(observed)):
            given = None if t == first and lane == 2 else np.array([t == first])
            action, memory = controller.predict(observed[t, lane], memory, given)
            assert action.shape == (1,)
            # Sums of another order, then float32.
            assert action[0] == pytest.approx(batch[t, lane], abs=1e-5)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_never_a_nan_and_never_a_changed_argument(name, shown):
    scenario, observed = shown
    controller = CONTROLLERS[name](scenario)
    wild = np.random.default_rng(0).uniform(-1e3, 1e3, (500, 2, observed.shape[-1])).astype(np.float32)
    wild[100:200] = 1e3
    memory = None
    for t, row in enumerate(wild):
        before = row.copy()
        kept = None if memory is None else copy.deepcopy(memory)
        action, new = controller.predict(row, memory, np.full(2, t == 0))
        assert np.isfinite(action).all() and np.all(np.abs(action) <= 1.0)
        np.testing.assert_array_equal(row, before)
        if kept is not None:
            for old, part in zip(arrays(kept), arrays(memory), strict=True):
                np.testing.assert_array_equal(old, part)
        memory = new
