"""The JSON schema of scenario files: every field, and what an editor should mark."""

import json
import tomllib

import jsonschema
import pytest

from shake_env import (
    make_scenario,
)
from shake_env.scenario.json_schema import scenario_schema
from shake_env.scenario.scenario_file import scenario_fields

VALIDATOR = jsonschema.Draft7Validator(scenario_schema())


def test_the_schema_is_one_and_knows_every_field():
    schema = scenario_schema()
    jsonschema.Draft7Validator.check_schema(schema)
    text = json.dumps(schema)
    for path in scenario_fields(make_scenario("laboratory")):
        assert f'"{path.split(".")[-1]}"' in text, path


@pytest.mark.parametrize(
    ("text", "valid"),
    [
        ('[actuator]\ntable_mass = "4 kg"', True),
        ("[actuator]\ntable_mas = 4", False),
        ("[actuator]\ntable_mass = -4", False),
        ("[actuator]\ntable_mass = true", False),
        ('base = "lab"', False),
        ('[motion.file]\npath = "x"', True),
        ('[motion.file]\nunits = "g"', False),
        ('[limits]\ncurrent = "none"', True),
        ('[actuator]\ntable_mass = "none"', False),
        ("[uncertainty]\ndelay = [1, 2]", True),
        ("[uncertainty]\ndelay = [1]", False),
        ("[sensing.sensors.base_shear]\nnoise = 1", True),
        ("[sensing.sensors.speed]\nnoise = 1", False),
        ("[specimen.uniform]\nstories = 1", False),
    ],
)
def test_the_schema_refuses_what_an_editor_should_mark(text, valid):
    assert VALIDATOR.is_valid(tomllib.loads(f"schema = 1\n{text}")) == valid
