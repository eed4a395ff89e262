"""A short sequence on a small belief, for the tests of the laboratory's loop."""

from dataclasses import replace

from made_logs import noise

from agents.laboratory.sequence.steps import plan_sequence
from shake_env.scenario.overrides import make_scenario


def laboratory_test(seconds=3.0):
    fields = {
        "uncertainty.mass_ratio": [0.4, 0.6],
        "uncertainty.storey_frequency": [6.5, 7.5],
        "uncertainty.coulomb_friction": [120.0, 180.0],
    }
    scenario = make_scenario("laboratory", {"fields": fields})
    return replace(scenario, motion=noise(seconds, 0.22))


def begun(folder):
    return plan_sequence(
        folder, laboratory_test(), amplitudes=(0.5, 1.0), samples=12, required_probability=0.2
    )
