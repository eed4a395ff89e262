"""Scenario files as they are written: complete, commented, and read back exactly."""

import json
import shutil
import tomllib

import jsonschema
import numpy as np
import pytest
from random_scenarios import first_steps, random_scenario

from shake_env import (
    make_scenario,
)
from shake_env.errors import FileError, ParameterError, ScenarioError
from shake_env.scenario.builder import LATER_FIELDS
from shake_env.scenario.json_schema import scenario_schema
from shake_env.scenario.presets import NAMED
from shake_env.scenario.scenario_file import parse_toml, scenario_fields, scenario_of
from shake_env.scenario.scenario_writer import SCHEMA_FILE, scenario_toml, write_scenario

VALIDATOR = jsonschema.Draft7Validator(scenario_schema())


@pytest.mark.parametrize("name", [*NAMED])
def test_a_named_scenario_is_written_complete_and_read_back(name, tmp_path):
    scenario = make_scenario(name)
    whole = write_scenario(scenario, tmp_path / "whole.toml")
    assert {path.name for path in whole} == {"whole.toml", SCHEMA_FILE}
    text = whole[0].read_text(encoding="utf-8")
    assert text.startswith(f"#:schema ./{SCHEMA_FILE}\n")
    assert make_scenario(whole[0]) == scenario
    # It says everything: the scenario that it begins with does not matter, but for sensors to take away.
    complete = text.replace("schema = 1\n", 'schema = 1\nbase = "yielding"\n', 1)
    assert parse_toml(whole[0], complete) == scenario
    parts = write_scenario(scenario, tmp_path / "split.toml", parts=True)
    names = {f"split_{part}" for part in ("table", "specimen", "sensors", "test")}
    assert {path.stem for path in parts} == {"split", *names}
    assert make_scenario(tmp_path / "split.toml") == scenario
    assert "[actuator]" in (tmp_path / "split_table.toml").read_text()
    (tmp_path / "split.toml").unlink()
    with pytest.raises(FileError, match="is there already"):  # a part that somebody may have edited
        write_scenario(scenario, tmp_path / "split.toml", parts=True)


def test_every_line_of_a_written_file_says_unit_or_meaning():
    text = scenario_toml(make_scenario("laboratory"))
    lines = [line for line in text.splitlines() if " = " in line and not line.startswith("#")]
    silent = {line.split(" = ")[0] for line in lines if "  # " not in line}
    assert len(lines) > 80 and silent <= {"schema"}


def test_writing_to_a_file_keeps_its_comments(write):
    file = write(
        '# of the basement\nbase = "laboratory"\n\n[limits]  # by the maker\n'
        'table_displacement = "70 mm"  # measured\n[motion.file]\n'
        'path = "CICLC.v1"  # theirs\ncolumn = 2\n'
    )
    before = file.read_text()
    scenario = make_scenario(file)
    write_scenario(scenario, file)
    assert file.read_text() == before
    fields = {"limits.table_displacement": 0.06, "motion.amplitude": 0.1, "sensing.preview": 0.2,
              "actuator.table_mass": 300.0, "sensing.sensors.spool_position": None}  # fmt: skip
    changed = make_scenario(file, {"fields": fields})
    write_scenario(changed, file)
    assert make_scenario(file) == changed
    text = file.read_text()
    for line in (
        "# of the basement",
        "[limits]  # by the maker",
        'table_displacement = "60 mm"  # measured',
        'path = "CICLC.v1"  # theirs',
    ):
        assert line in text
    other = make_scenario(
        file, {"record": "napa2014_68150_hne", "fields": {"specimen.masses": [1.0, 2.0]}}
    )
    write_scenario(other, file)
    assert make_scenario(file) == other and "# of the basement" in file.read_text()


def test_a_file_that_is_no_scenario_is_not_overwritten(write):
    file = write("delay = \n")
    with pytest.raises(ScenarioError, match="is no TOML"):
        write_scenario(make_scenario("linear"), file)
    with pytest.raises(ParameterError, match="must end in"):
        write_scenario(make_scenario("linear"), file.with_suffix(".txt"))
    with pytest.raises(FileError, match=r"my\.toml"):
        write_scenario(make_scenario("linear"), file / "my.toml")


def said(scenario):
    """What a scenario's file says, with the samples of records in place of their files."""
    return scenario_toml(scenario, lambda record: record.digest.hex())


def assert_same_after_files(scenario, folder):
    file = folder / f"{len([*folder.iterdir()])}.toml"
    write_scenario(scenario, file)
    again = make_scenario(file)
    # A record from elsewhere gains lines of attribution that its format needs; its samples are equal.
    assert said(again) == said(scenario)
    for first, second in zip(first_steps(scenario), first_steps(again), strict=True):
        assert np.array_equal(first, second, equal_nan=True)
    second = file.with_name(f"again_{file.name}")
    write_scenario(again, second)
    assert make_scenario(second) == again
    plain = json.loads(json.dumps(scenario_fields(scenario), allow_nan=False))
    assert scenario_of(plain) == scenario
    assert VALIDATOR.is_valid(tomllib.loads(file.read_text(encoding="utf-8")))


@pytest.mark.parametrize("seed", range(20))
def test_random_scenarios_survive_their_files(seed, tmp_path):
    assert_same_after_files(random_scenario(np.random.default_rng(seed)), tmp_path)


@pytest.mark.slow
def test_a_thousand_random_scenarios_survive_their_files(tmp_path):
    for seed in range(1000):
        folder = tmp_path / str(seed)
        folder.mkdir()
        assert_same_after_files(random_scenario(np.random.default_rng(1000 + seed)), folder)
        shutil.rmtree(folder)


def test_json_of_before_a_field_was_added_is_read(monkeypatch):
    fields = scenario_fields(make_scenario("yielding"))
    with pytest.raises(ScenarioError, match=r"limits\.cost_horizon = None: is missing"):
        scenario_of({path: value for path, value in fields.items() if path != "limits.cost_horizon"})
    monkeypatch.setitem(LATER_FIELDS, "Limits", ("cost_horizon",))
    del fields["limits.cost_horizon"]
    assert scenario_of(fields) == make_scenario("yielding")
