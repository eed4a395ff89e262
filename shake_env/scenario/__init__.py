"""A scenario as one frozen value: objective, limits, observation, uncertainty."""

from shake_env.scenario.capacity import scenario_capacity
from shake_env.scenario.digest import known_name, named_digest, scenario_digest
from shake_env.scenario.limits import Limits
from shake_env.scenario.objective import CostTerms, Objective, StageCost
from shake_env.scenario.observation import ObservationLayout, Sensing, Sensor
from shake_env.scenario.overrides import Overrides, make_scenario
from shake_env.scenario.presets import laboratory_noise
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.scenario_file import flattened, read_scenario, scenario_fields, scenario_of
from shake_env.scenario.scenario_writer import scenario_toml, write_scenario
from shake_env.scenario.uncertainty import Uncertainty, Uniform

__all__ = [
    "CostTerms",
    "Limits",
    "Objective",
    "ObservationLayout",
    "Overrides",
    "Scenario",
    "Sensing",
    "Sensor",
    "StageCost",
    "Uncertainty",
    "Uniform",
    "flattened",
    "known_name",
    "laboratory_noise",
    "make_scenario",
    "named_digest",
    "read_scenario",
    "scenario_capacity",
    "scenario_digest",
    "scenario_fields",
    "scenario_of",
    "scenario_toml",
    "write_scenario",
]
