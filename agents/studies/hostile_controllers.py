"""Controllers that try to break a table's limits: what a supervisor is tested with."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.scenario.scenario import Scenario

KINDS = ("linear", "sign of linear", "square", "sweep", "constant", "noise", "sign", "nan", "burst")


class Hostile:
    """A controller of another kind in every lane: gains, frequencies and amplitudes at random.

    Lane i is of kind ``KINDS[i % 9]``: linear feedback of every scale and its sign, square waves and
    sweeps over specimen and oil-column frequencies, a constant, white noise, the sign of a reading,
    commands that are no number, and bursts.

    Parameters
    ----------
    scenario
        Whose observation is fed back.
    lanes
        Number of tables N.
    seed
        Of everything that is drawn.
    """

    def __init__(self, scenario: Scenario, lanes: int, seed: int) -> None:
        r = self.random = np.random.default_rng([seed, 77])
        layout, self.period = scenario.observation, scenario.control_period
        n = layout.size
        self.kind = np.arange(lanes) % len(KINDS)
        some = r.random((lanes, n)) < r.choice([0.1, 0.3, 1.0], (lanes, 1))
        self.row = r.normal(size=(lanes, n)) * some * 10 ** r.uniform(-2.0, 3.0, (lanes, 1))
        bands = (
            r.uniform(2.0, 16.0, lanes),
            r.uniform(28.0, 42.0, lanes),
            10 ** r.uniform(-0.5, 2, lanes),
        )
        self.frequency = np.choose(r.choice(3, lanes, p=(0.5, 0.3, 0.2)), bands)  # specimen, oil, any
        self.amplitude = np.where(r.random(lanes) < 0.6, 1.0, 10 ** r.uniform(-2.0, 1.0, lanes))
        self.amplitude *= r.choice([-1.0, 1.0], lanes)
        self.hold = np.where(r.random(lanes) < 0.5, 1, r.integers(1, 40, lanes))
        actuator = scenario.plant.layout.actuator.start
        first = layout.readings.start if layout.readings_count else actuator
        self.reading = first + r.integers(0, max(layout.readings_count, 4), lanes)
        self.rate = 10 ** r.uniform(-3.0, -0.3, lanes)
        self.bad = r.choice([np.nan, np.inf, -np.inf], lanes)
        self.two_valued = r.random(lanes) < 0.5

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float64], tuple[Any, ...]]:
        """Return the actions (N, 1), some of them beyond [-1, 1] or no number, and the memory."""
        k, held = (0, np.zeros(len(observation))) if state is None else state
        lanes, t, r = np.arange(len(observation)), k * self.period, self.random
        linear = np.einsum("ij,ij->i", observation.astype(float), self.row)
        white = np.where(
            self.two_valued, r.choice([-1.0, 1.0], len(lanes)), r.uniform(-1, 1, len(lanes))
        )
        held = np.where(k % self.hold == 0, self.amplitude * white, held)
        square = self.amplitude * np.where(np.sin(2 * np.pi * self.frequency * t) >= 0.0, 1.0, -1.0)
        sweep = self.amplitude * np.sin(2 * np.pi * (0.5 * t + self.frequency * t**2 / 6.0))
        sign = self.amplitude * np.sign(observation[lanes, self.reading])
        bad = np.where(
            r.random(len(lanes)) < self.rate, self.bad, np.where(self.two_valued, square, held)
        )
        burst = np.where((k // self.hold) % 2 == 0, square, sign)
        choices = [linear, np.sign(linear), square, sweep, self.amplitude, held, sign, bad, burst]
        return np.choose(self.kind, choices)[:, None], (k + 1, held)
