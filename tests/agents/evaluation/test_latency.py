"""Processor time of a decision, also by a clock that ticks slowly and in an episode of one period."""

import math
import time
from types import SimpleNamespace

import numpy as np
import pytest

from agents.evaluation import latency
from agents.evaluation.latency import decision_time
from shake_env import make_scenario

SECONDS = 1e-3


class Busy:
    """Zero current after so much processor time; NaN from a decision on, if one is given."""

    def __init__(self, broken_at=math.inf):
        self.broken_at, self.asked = broken_at, 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.asked += 1
        end = time.process_time() + SECONDS
        while time.process_time() < end:
            pass
        action = np.zeros((*observation.shape[:-1], 1), dtype=np.float32)
        return action if self.asked < self.broken_at else action * np.nan, None


@pytest.mark.parametrize("tick", [0.0, 4e-3])
def test_a_clock_that_ticks_slowly_gives_the_same(monkeypatch, tick):
    """Differences over one decision by a clock of 4 ms are 0 in three of four."""
    true = time.process_time

    def clock():
        return true() // tick * tick if tick else true()

    monkeypatch.setattr(latency, "time", SimpleNamespace(process_time=clock))
    found = decision_time(Busy(), make_scenario("linear", {"duration": 0.5}))
    assert found * 1.06 >= SECONDS and found < 1.5 * SECONDS  # one of twenty ticks may be missed


@pytest.mark.parametrize(("duration", "broken_at"), [(0.005, math.inf), (0.5, 1), (0.5, 7)])
def test_a_short_or_broken_episode_has_its_time(duration, broken_at):
    found = decision_time(Busy(broken_at), make_scenario("linear", {"duration": duration}))
    assert SECONDS <= found < 1.5 * SECONDS


def test_no_decision_takes_no_known_time():
    assert math.isnan(decision_time(Busy(), make_scenario("linear"), decisions=0))
