"""Scenario files on the command line: a scenario comes back, what is wrong with one is named."""

import json
import re
from pathlib import Path

import pytest

from agents.__main__ import main
from agents.cli.commands import parse
from shake_env import make_scenario
from shake_env.errors import ParameterError, ScenarioError
from shake_env.scenario.scenario_file import scenario_fields, scenario_of


def test_a_scenario_file_gives_the_scenario_again(tmp_path, capsys):
    changes = ["--set", "sensing.preview=0.2", "--set", "uncertainty.mass_ratio=[0.1,0.5]",
               "--stories", "3", "--set", "name=mine"]  # fmt: skip
    assert main(["show-scenario", "--scenario", "laboratory", *changes, "--json"]) == 0
    file = tmp_path / "mine.json"
    file.write_text(capsys.readouterr().out)
    built = parse(["show-scenario", "--scenario", "laboratory", *changes]).scenario.build()
    assert built.name == "mine" and built.specimen.stories == 3
    assert make_scenario(file) == make_scenario(str(file)) == built
    assert parse(["design", "--scenario", str(file)]).scenario.build() == built
    changed = make_scenario(file, {"delay": 1})
    assert changed.delay == 1 and changed != built
    again = parse(["evaluate", "lqg", "--scenario", str(file), "--json"]).scenario
    assert again.build() == built
    kept = again.without_file()
    file.unlink()
    assert kept.build() == built and kept.scenario == "mine"
    import gymnasium

    with pytest.raises(ScenarioError, match="there is no such file"):
        gymnasium.make("shake_env:ShakeTable-v0", scenario=str(file))


def test_a_trained_policy_does_not_depend_on_a_scenario_file(tmp_path):
    from agents.training.config import TrainConfig, config_of

    file = tmp_path / "mine.json"
    fields = scenario_fields(make_scenario("yielding"))
    file.write_text(json.dumps({"name": "yielding", "fields": fields}))
    config = parse(["train", "--run-dir", "x", "--config.scenario.scenario", str(file)]).config
    kept = TrainConfig(scenario=config.scenario.without_file())
    file.unlink()
    again = config_of(json.loads(json.dumps(kept.to_json())))
    assert again == kept and again.scenario.build() == make_scenario("yielding")


@pytest.mark.parametrize(
    "name", ["linear", "as-printed", "laboratory", "unknown-specimen", "yielding", "records"]
)
def test_every_named_scenario_survives_its_file(name):
    scenario = make_scenario(name)
    again = scenario_of(json.loads(json.dumps(scenario_fields(scenario), allow_nan=False)))
    assert again == scenario and hash(again) == hash(scenario)


FIELDS = scenario_fields(make_scenario("laboratory"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"specimen.masses": None}, r"specimen.masses = None: must be a list of numbers \[kg\]"),
        ({"specimen.masses": [1.0, "2"]}, r"specimen.masses\[1\] = '2': must be a number \[kg\]"),
        ({"control_rate": "200"}, r"control_rate = '200': must be a number \[Hz\]"),
        ({"control_rate": True}, r"control_rate = True: must be a number \[Hz\]"),
        ({"control_rate": 333.0}, "control_rate = 333.0: its period"),
        ({"sensing.history": 1.5}, "sensing.history = 1.5: must be a whole number"),
        ({"limits.curent": 1.0}, "limits.curent'?: did you mean 'limits.current'|did you mean"),
        ({"control_rate.x": 1.0}, "a part of it has a value already"),
        ({"sensing.sensors.load_pressure.signal": "base_shear"}, "must be 'load_pressure'"),
        ({"motion..duration": 1.0}, "must be names with dots"),
        ({"motion.motions[0].record": "x"}, "motion"),
    ],
)
def test_a_wrong_field_of_a_scenario_file_is_named(change, message, tmp_path):
    file = tmp_path / "mine.json"
    file.write_text(json.dumps({"fields": {**FIELDS, **change}}))
    with pytest.raises((ScenarioError, ParameterError), match=message):
        make_scenario(file)


@pytest.mark.parametrize("left_out", ["delay", "motion.duration", "sensing.sensors.load_pressure.noise"])
def test_a_missing_field_of_a_scenario_file_is_named(left_out):
    with pytest.raises(ScenarioError, match=re.escape(f"{left_out} = None: is missing")):
        scenario_of({path: value for path, value in FIELDS.items() if path != left_out})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is no JSON"),
        ("[1]", "must hold one JSON object"),
        ('{"name": "x"}', "has no object 'fields'"),
        ('{"fields": {}, "feilds": {}}', "did you mean 'fields'"),
        ('{"fields": {"delay": 1, "delay": 2}}', "stands twice"),
        ('{"fields": {"delay": NaN}}', "no JSON number"),
        ("[" * 100_000, "is no JSON"),
        ('{"fields": {"name": "\\ud800"}}', "is missing"),
    ],
)
def test_a_text_that_is_no_scenario(text, message, tmp_path):
    file = tmp_path / "mine.json"
    file.write_text(text)
    with pytest.raises(ScenarioError, match=message):
        make_scenario(file)


def test_what_is_no_file_of_text_is_refused(tmp_path):
    for path, why in (
        (tmp_path, "is a folder"),
        (tmp_path / "absent.json", "no such file"),
        (Path("/dev/zero"), "is a pipe or a device"),
    ):
        with pytest.raises(ScenarioError, match=why):
            make_scenario(path)
    (tmp_path / "x.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match="is no JSON"):
        make_scenario(tmp_path / "x.json")
