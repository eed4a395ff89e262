"""Classes of information: declared once, and true of what a controller does with its observation."""

import numpy as np
import pytest

from agents.policies.registry import controllers, information_of
from baselines.catalogue import BASELINES
from baselines.information import INFORMATION, MEANINGS, knows_no_more
from baselines.registry import make_baseline
from shake_env import make_scenario
from shake_env.errors import ShakeError
from shake_env.simulation.simulation import Simulation

SEEING = ("laboratory", "yielding", "unknown-specimen")


def test_every_controller_has_a_class_on_every_scenario():
    laboratory, linear = make_scenario("laboratory"), make_scenario("linear")
    for name in controllers():
        assert information_of(name, laboratory) in INFORMATION
        assert information_of(name, linear) != "preview"
    assert information_of("lqg", laboratory) == information_of("ppo", laboratory) == "preview"
    assert information_of("tvc", laboratory) == information_of("lqg", linear) == "causal"
    assert information_of("planned", linear) == "record known"
    assert information_of("ilc", linear) == "repeated tests"
    assert list(MEANINGS) == list(INFORMATION)
    assert knows_no_more("causal", "preview") and not knows_no_more("record known", "preview")


@pytest.mark.parametrize("name", [n for n, b in BASELINES.items() if not b.takes_earthquakes])
def test_a_causal_controller_does_not_read_the_preview_and_others_do(name):
    """The coming samples are replaced by others: the command of a causal controller is the same."""
    reading = []
    for each in SEEING:
        scenario = make_scenario(each, {"duration": 0.1})
        try:
            law = make_baseline(name, scenario)
        except ShakeError:
            continue  # does not suit
        observation = Simulation(scenario, 1).start([0], [np.random.default_rng(0)])
        other = observation.copy()
        other[:, scenario.observation.preview] = 1.0
        fresh = np.ones(1, dtype=bool)
        commands = [law.predict(shown, None, fresh)[0] for shown in (observation, other)]
        reading.append(not np.array_equal(*commands))
        assert information_of(name, scenario) == "preview" or not reading[-1], each
    assert reading and any(reading) == BASELINES[name].uses_preview
