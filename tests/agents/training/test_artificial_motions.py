"""Artificial training earthquakes: what a table can just repeat, reproducible, and mixed with noise."""

import numpy as np
import pytest

from agents.scenario_options import ScenarioOptions
from agents.training.artificial_motions import LONGEST, artificial_motions
from agents.training.config import TrainConfig
from agents.training.tables import training_scenario
from shake_env import make_scenario
from shake_env.errors import ParameterError
from shake_env.motion.processing import RATED_VELOCITY, SOFT_STROKE
from shake_env.motion.targets import FilteredNoise, MotionSet, target_history


def test_each_uses_all_of_the_table_and_no_more():
    scenario = make_scenario("laboratory")
    used = []
    for motion in artificial_motions(scenario, 12, 7):
        history = target_history(motion, scenario.physics_step)
        stroke = np.max(np.abs(history.displacement)) / SOFT_STROKE
        velocity = np.max(np.abs(history.velocity)) / RATED_VELOCITY
        assert stroke <= 1.0 and velocity <= 1.0
        used.append(max(stroke, velocity))
    assert np.min(used) > 0.9999


def test_seeds_repeat_and_differ():
    scenario = make_scenario("laboratory")
    assert artificial_motions(scenario, 3, 5) == artificial_motions(scenario, 3, 5)
    assert artificial_motions(scenario, 1, 6)[0] == artificial_motions(scenario, 2, 5)[1]
    assert len({motion.source.digest for motion in artificial_motions(scenario, 8, 0)}) == 8


def test_spectra_differ_in_where_their_power_lies():
    """Displacement over acceleration goes with the period squared: a decade of it within one set."""
    scenario = make_scenario("laboratory")
    ratios = []
    for motion in artificial_motions(scenario, 16, 0):
        history = target_history(motion, scenario.physics_step)
        ratios.append(np.std(history.displacement) / np.std(history.acceleration))
    assert max(ratios) > 4.0 * min(ratios)


def test_every_other_episode_is_artificial():
    config = TrainConfig(
        scenario=ScenarioOptions("laboratory"), num_artificial_motions=5, episode_duration=4.0, seed=3
    )
    motion = training_scenario(config, config.scenario.build()).motion
    assert isinstance(motion, MotionSet)
    drawn = [motion.pick(np.random.default_rng(i)) for i in range(400)]
    noise = sum(isinstance(each, FilteredNoise) for each in drawn)
    assert abs(noise - 200) < 4 * 10  # four standard deviations of a fair coin
    assert all(each.duration == 4.0 for each in drawn if isinstance(each, FilteredNoise))
    names = {each.source.name for each in drawn if not isinstance(each, FilteredNoise)}
    assert names == {f"artificial {300_000 + i}" for i in range(5)}


@pytest.mark.parametrize("number", [0, LONGEST + 1])
def test_a_set_has_one_motion_at_least_and_no_more_than_are_kept_prepared(number):
    with pytest.raises(ParameterError, match="artificial"):
        artificial_motions(make_scenario("laboratory"), number, 0)
