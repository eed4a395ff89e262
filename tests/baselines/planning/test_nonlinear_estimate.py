"""A full-state law behind the extended Kalman filter: equal where linear, better with friction."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba")

from baselines.estimation.lqg import estimated, full_state
from baselines.lqr.feedforward import FeedforwardLQR
from baselines.lqr.preview import PreviewFeedback
from baselines.planning.nonlinear_estimate import NonlinearEstimate
from baselines.registry import make_baseline
from shake_env import make_scenario
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.rollout import noise_earthquakes, rollout

PLACE = 0.01


def actions_of(controller, scenario, lanes=3):
    """Recorded actions of a roll-out whose tables begin together."""
    quakes = noise_earthquakes(scenario, lanes)
    return [
        run.current for run in rollout(controller, scenario, quakes, record=range(lanes))[1].values()
    ]


def test_on_a_linear_table_it_is_the_kalman_filter():
    """To the last bits of the actions, which are float32."""
    nonlinear = make_scenario("laboratory", {"duration": 2.0})
    scenario = replace(nonlinear, nonlinearity=Nonlinearity())

    def make(full):
        return PreviewFeedback(full, position=PLACE)

    linear = actions_of(estimated(scenario, make), scenario)
    ours = actions_of(NonlinearEstimate(scenario, make(full_state(scenario))), scenario)
    for one, other in zip(linear, ours, strict=True):
        np.testing.assert_allclose(other, one, atol=1e-6 * scenario.current_limit)


def test_friction_feed_forward_needs_a_filter_that_knows_friction():
    """Behind the linear filter it costs more than lqg, behind this one four fifths of it."""
    scenario = make_scenario("laboratory", {"duration": 8.0})
    quakes = noise_earthquakes(scenario, 4)

    def cost(controller):
        rows = rollout(controller, scenario, quakes)[0]
        assert all(row.broken_limit is None for row in rows)
        return np.mean([row.cost for row in rows])

    linear = estimated(scenario, lambda full: FeedforwardLQR(full, position=PLACE))
    lqg = cost(make_baseline("lqg", make_scenario("laboratory")))
    assert cost(make_baseline("lqr-friction-ff", scenario)) < 0.85 * lqg < lqg < cost(linear)


def test_an_episode_begins_anew_in_its_own_table():
    scenario = make_scenario("laboratory", {"duration": 1.0})
    controller = make_baseline("lqr-friction-ff", scenario)
    rng = np.random.default_rng(0)
    shown = rng.normal(0.0, 0.1, (6, 2, scenario.observation.size)).astype(np.float32)
    state, both = None, []
    for t, observation in enumerate(shown):
        start = np.array([t == 0, t in (0, 3)])
        action, state = controller.predict(observation, state, start)
        both.append(action[:, 0])
    state = None
    for t in range(3, 6):
        action, state = controller.predict(shown[t, 1], state, np.array([t == 3]))
        assert action[0] == both[t][1]
