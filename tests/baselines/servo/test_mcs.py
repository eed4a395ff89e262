"""Minimal control synthesis: it follows its model where the fixed loop does not, within its bounds."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.servo.mcs import MCS, MCSDesign
from shake_env.errors import ParameterError
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.motion.targets import FilteredNoise
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.scenario.limits import Limits
from shake_env.scenario.overrides import make_scenario
from shake_env.scenario.presets import laboratory
from shake_env.scenario.uncertainty import Uncertainty, Uniform
from shake_env.simulation.simulation import Simulation


def run(scenario, controller, seconds, lanes=2):
    """Return displacement errors (steps, lanes), gains (steps, lanes, 4) and whether a limit broke."""
    motion = FilteredNoise(duration=seconds, amplitude=0.15)
    scenario = replace(scenario, motion=motion)
    simulation = Simulation(scenario, lanes)
    observation = simulation.start(range(lanes), [np.random.default_rng(i) for i in range(lanes)])
    memory, errors, gains, broken = None, [], [], False
    for step in range(round(seconds * scenario.control_rate)):
        action, memory = controller.predict(observation, memory, np.full(lanes, step == 0))
        result = simulation.step(action[:, 0].astype(float))
        observation = result.observation
        broken |= bool(result.terminated.any())
        errors.append(result.ground.ground[:, 2] - simulation.state[:, 1])
        gains.append(controller.gains(memory))
    return np.array(errors), np.array(gains), broken


def test_the_table_follows_the_reference_model_where_its_valve_is_not_the_nominal_one():
    weak = Uncertainty(valve_gain=Uniform(3.5e-4, 3.5e-4))  # the nominal valve gives 5e-4 m/A
    scenario = replace(laboratory(), nonlinearity=Nonlinearity(), limits=Limits(), uncertainty=weak)
    fixed, _, _ = run(scenario, MCS(scenario, MCSDesign(alpha=0.0, beta=0.0)), 8.0)
    adaptive, gains, broken = run(scenario, MCS(scenario, MCSDesign(alpha=1.0, beta=0.1)), 8.0)
    assert not broken
    settled = slice(800, None)
    before, after = (np.sqrt(np.mean(e[settled] ** 2)) for e in (fixed, adaptive))
    assert after < 0.7 * before
    # The demand's gain grows, for the valve is weak.
    assert np.all(np.mean(gains[settled, :, 2], axis=0) > 0.05)


def test_adaptation_stays_bounded_over_long_noise():
    scenario = laboratory()
    design = MCSDesign(alpha=2.0, beta=0.2, leakage=0.2, bound=0.01, error_integral=True)
    _, gains, broken = run(scenario, MCS(scenario, design), 12.0)
    assert not broken and np.isfinite(gains).all()
    assert np.max(np.abs(gains)) <= design.bound
    # Plain MCS with the same adaptation is out of that box in half the time.
    _, plain, _ = run(scenario, MCS(scenario, MCSDesign(alpha=2.0, beta=0.2)), 6.0)
    assert np.max(np.abs(plain)) > design.bound


def test_a_motion_beyond_the_units_of_the_design_diverges_plain_mcs_and_not_the_bounded_one():
    # The paper's linear setting: unit intensity and no high-pass, so that the ground walks for metres.
    scenario = make_scenario("linear", {"duration": 15.0})
    quakes = noise_earthquakes(scenario, 3, 40)
    plain, _ = rollout(MCS(scenario), scenario, quakes)
    bounded, _ = rollout(MCS(scenario, MCSDesign.bounded()), scenario, quakes)
    assert all(m.broken_limit == "diverged" for m in plain)
    assert all(m.broken_limit is None and m.acceleration_rms_error < 0.75 for m in bounded)


def test_without_adaptation_it_is_the_inner_loop_and_gains_stay_zero():
    scenario = laboratory()
    _, gains, broken = run(scenario, MCS(scenario, MCSDesign(alpha=0.0, beta=0.0)), 2.0)
    assert not broken and np.all(gains == 0.0)


def test_mistakes_are_named():
    with pytest.raises(ParameterError, match="bound"):
        MCSDesign(bound=0.0)
    with pytest.raises(ParameterError, match="leakage"):
        MCSDesign(leakage=-1.0)
