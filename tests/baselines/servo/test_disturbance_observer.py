"""The disturbance observer: it finds what acts at the valve, and leaves a nominal table alone."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.servo.disturbance_observer import (
    DisturbanceObserver,
    ObserverDesign,
    model_mismatch,
    observer_corner,
)
from shake_env.controller import NoControl
from shake_env.errors import ParameterError
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.scenario.limits import Limits
from shake_env.scenario.observation import Sensing
from shake_env.scenario.presets import laboratory
from shake_env.simulation.simulation import Simulation


class Shaking:
    """A sine of current, by step count."""

    def __init__(self, period, frequency, amplitude):
        self.step, self.amplitude = 2.0 * np.pi * frequency * period, amplitude

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        count = 0 if state is None else state[0]
        action = np.full((*observation.shape[:-1], 1), self.amplitude * np.sin(self.step * count))
        return action.astype(np.float32), (count + 1,)


def drive(scenario, controller, steps, offset=0.0):
    """Return disturbances [A] and table velocities (steps,), with a valve that is off its middle."""
    simulation = Simulation(scenario, 1)
    observation = simulation.start([0], [np.random.default_rng(0)])
    memory, found, velocity = None, [], []
    for step in range(steps):
        action, memory = controller.predict(observation, memory, np.array([step == 0]))
        observation = simulation.step(action[:, 0].astype(float) + offset).observation
        found.append(controller.compensation(memory)[0])
        velocity.append(simulation.state[0, 2])
    return np.array(found), np.array(velocity)


def linear():
    return replace(laboratory(), nonlinearity=Nonlinearity(), limits=Limits(), sensing=Sensing())


def test_a_valve_offset_is_found_and_removed():
    scenario, offset = linear(), 0.05
    observer = DisturbanceObserver(scenario, NoControl())
    found, velocity = drive(scenario, observer, 600, offset)
    # The sum of command and offset ends at zero: the table stands where without it it would run at
    # 16 m/s per ampere.
    assert found[-100:].mean() == pytest.approx(-offset * scenario.current_limit, rel=0.01)
    assert np.abs(velocity[-100:]).max() < 0.02 * 16.0 * offset * scenario.current_limit


def test_a_nominal_table_shows_no_disturbance_and_friction_shows_one():
    scenario = linear()
    design = ObserverDesign(corner=2.0)
    controller = DisturbanceObserver(scenario, Shaking(0.005, 1.0, 0.1), design)
    clean, _ = drive(scenario, controller, 1000)
    rubbing = replace(scenario, nonlinearity=laboratory().nonlinearity)
    seen, _ = drive(rubbing, controller, 1000)
    assert np.abs(clean[400:]).max() < 0.02 * 0.1 * scenario.current_limit
    assert np.abs(seen[400:]).max() > 3.0 * np.abs(clean[400:]).max()


def test_the_corner_is_the_highest_that_small_gain_allows():
    scenario = laboratory()
    corner = observer_corner(scenario, ObserverDesign())
    frequency = np.geomspace(0.05, 100.0, 20_000)
    missed = model_mismatch(scenario, frequency)

    def worst(at):
        return np.max(missed / (1.0 + (frequency / at) ** 2))

    assert worst(corner) < 0.75 and worst(1.1 * corner) > 0.7
    # Dead time and lag are the simple model's own: it is the table below a quarter of the oil column.
    assert np.max(missed[frequency < 3.0]) < 0.05


def test_mistakes_are_named():
    with pytest.raises(ParameterError, match="margin"):
        ObserverDesign(margin=1.0)
    with pytest.raises(ParameterError, match="corner"):
        ObserverDesign(corner=-1.0)


def test_what_was_given_counts_and_not_what_was_asked():
    """A supervisor's changes are in the last action that the scenario shows."""
    scenario = laboratory()
    shown = scenario.observation
    assert shown.sensing.last_action
    observer = DisturbanceObserver(scenario, NoControl())
    observation = np.zeros(shown.size, dtype=np.float32)
    _, quiet = observer.predict(observation)
    observation[shown.last_action] = 0.25
    _, told = observer.predict(observation, quiet)
    _, untold = observer.predict(np.zeros_like(observation), quiet)
    assert observer.compensation(told) > observer.compensation(untold)
