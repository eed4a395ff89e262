"""Observations with a preview of the target, for the tests of controllers that read one."""

from collections import deque

import numpy as np

from shake_env.excitation import Excitation
from shake_env.motion import FilteredNoise
from shake_env.simulation import Simulation


class PreviewedTables:
    """Tables under the scenario's noise, whose targets a twin excitation computes ahead."""

    def __init__(self, scenario, lanes, preview, spacing=None, seed=2009):
        k, dt = scenario.substeps, scenario.physics_step
        self.stride = round((spacing or scenario.control_period) / dt)
        self.samples = round(preview / (self.stride * dt))
        self.size = np.sqrt(scenario.plant.target_variance)
        assert isinstance(scenario.motion, FilteredNoise)
        self.simulation, self.twin = Simulation(scenario, lanes), Excitation(scenario.discrete, lanes)
        streams = [
            [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(lanes)]
            for _ in range(2)
        ]
        self.twin.start(range(lanes), [scenario.motion] * lanes, streams[1])
        self.ahead = deque(maxlen=max(1, -(-self.samples * self.stride // k)))
        for _ in range(self.ahead.maxlen):
            self.ahead.append(self.twin.advance().target.copy())
        self.observation = self._observe(self.simulation.start(range(lanes), streams[0]))

    def _observe(self, state):
        coming = np.concatenate(list(self.ahead), axis=1)
        seen = coming[:, self.stride - 1 :: self.stride][:, : self.samples]
        return np.concatenate([state, seen / self.size], axis=1).astype(np.float32)

    def step(self, action):
        result = self.simulation.step(np.asarray(action, dtype=float))
        self.ahead.append(self.twin.advance().target.copy())
        self.observation = self._observe(result.observation)
        return result


def mean_costs(controller, tables, steps, warm_up):
    """Mean stage cost (N,) after the warm-up, and the last observation."""
    total, memory = 0.0, None
    for t in range(steps):
        start = np.full(len(tables.observation), t == 0)
        action, memory = controller.predict(tables.observation, memory, start)
        result = tables.step(action[:, 0])
        if t >= warm_up:
            total = total - result.reward
    return total / (steps - warm_up)
