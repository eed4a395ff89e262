"""Scenario files in TOML: read with their units and includes, errors with line and remedy."""

from dataclasses import replace

import gymnasium
import pytest

from agents.scenario_options import ScenarioOptions
from shake_env import (
    Uniform,
    make_scenario,
)
from shake_env.errors import ParameterError, RecordError, ScenarioError

# Reading


def test_a_file_changes_what_it_says_and_has_units(write):
    file = write(
        """
base = "laboratory"
current_limit = "25 mA"
[actuator]
table_mass = "420 kg"
table_damping = "5.78 kN s/m"
piston_area = "42 cm^2"
leakage = 1e-12
[limits]
table_displacement = "70 mm"
table_velocity = "none"
[nonlinearity.valve]
supply_pressure = "21 MPa"
[uncertainty]
coulomb_friction = ["0.1 kN", 300]
storey_frequency = { low = "5 Hz", high = 9 }
[sensing.sensors.load_pressure]
noise = "3 kPa"
[sensing.sensors.base_shear]
noise = "2 N"
[sensing.sensors]
spool_position = "none"
"""
    )
    usual, scenario = make_scenario("laboratory"), make_scenario(file)
    assert scenario.name == "my" and make_scenario(str(file)) == scenario
    assert scenario.actuator == replace(
        usual.actuator, table_mass=420.0, table_damping=5780.0, piston_area=0.0042, leakage=1e-12
    )
    assert scenario.current_limit == 0.025 and scenario.nonlinearity == usual.nonlinearity
    assert scenario.limits == replace(usual.limits, table_displacement=0.07, table_velocity=None)
    assert scenario.uncertainty.coulomb_friction == Uniform(100.0, 300)
    assert scenario.uncertainty.storey_frequency == Uniform(5.0, 9)
    noise = {sensor.signal: sensor.noise for sensor in scenario.sensing.sensors}
    assert noise["load_pressure"] == 3000.0 and noise["base_shear"] == 2.0
    assert "spool_position" not in noise and len(noise) == 5


def test_every_command_option_and_environment_takes_a_file(write, monkeypatch):
    file = write("control_rate = 100\n[motion]\nduration = 1\n")
    monkeypatch.chdir(file.parent)
    env = gymnasium.make("shake_env:ShakeTable-v0", scenario="my.toml")
    assert (
        env.unwrapped.scenario == make_scenario(file, {}) and env.unwrapped.metadata["render_fps"] == 100
    )
    options = ScenarioOptions(scenario="my.toml", delay=2.0)
    assert options.build() == make_scenario("my.toml", {"delay": 2.0})
    kept = options.without_file()
    file.unlink()
    assert kept.build() == ScenarioOptions(**vars(kept)).build() and kept.scenario == "my"


def test_files_in_parts(write):
    write('[actuator]\ntable_mass = "300 kg"\ntable_damping = 900\n', "table.toml")
    write('include = ["../table.toml"]\n[specimen]\nmasses = [9]\nstiffnesses = [1e5]\ndampings = [9]\n',
          "parts/specimen.toml")  # fmt: skip
    file = write('include = ["parts/specimen.toml", "table.toml"]\n[actuator]\ntable_damping = 800\n')
    scenario = make_scenario(file)
    assert scenario.actuator.table_mass == 300.0 and scenario.actuator.table_damping == 800
    assert scenario.specimen.masses == (9.0,)
    assert make_scenario(file.with_name("table.toml")).actuator.table_damping == 900


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"my": 'include = ["my.toml"]'}, "my.toml, line 2, include = 'my.toml': includes this file"),
        ({"my": 'include = ["a.toml"]', "a": 'include = [\n"b.toml"]', "b": 'include = ["a.toml"]'},
         "b.toml, line 2, include = 'a.toml': includes this file itself: a circle"),
        ({"my": 'include = ["none.toml"]'}, "line 2, include = .*there is no such file"),
        ({"my": 'include = "a.toml"', "a": ""}, "line 2, include = 'a.toml': must be a list"),
        ({"my": 'include = ["a.csv"]'}, "must end in .toml"),
        ({"my": 'include = ["a.toml", "b.toml"]', "a": "delay = 1", "b": "\ndelay = 2"},
         "b.toml, line 3, delay = 2: is given in .*a.toml, line 2, delay, too"),
        ({"my": 'include = ["a.toml"]', "a": "[limits]\ncurrrent = 2"},
         "a.toml, line 3, limits.currrent = 2"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_parts_is_refused(files, message, write):
    paths = {name: write(text, f"{name}.toml") for name, text in files.items()}
    with pytest.raises(ScenarioError, match=message):
        make_scenario(paths["my"])


@pytest.mark.parametrize(
    ("text", "kind", "message"),
    [
        ('\n[actuator]\ntable_mas = "4 kg"', ScenarioError,
         "line 4, actuator.table_mas = '4 kg': is no field: did you mean 'table_mass'"),
        ('[actuator]\ntable_mass = "4 mm"', ScenarioError,
         "line 3, actuator.table_mass = '4 mm': has the unit mm, which does not convert to kg"),
        ('[actuator]\ntable_mass = "-4 kg"', ParameterError,
         "line 3, actuator.table_mass = '-4 kg': must be a finite number above 0: 0.01 to"),
        ("[actuator]\ntable_mass = true", ScenarioError,
         "line 3, .* = True: must be a number \\[kg\\]"),
        ("[actuator]\ntable_mass = 2024-01-01", ScenarioError, "must be a number \\[kg\\]"),
        ("[actuator]\nfriction.coulomb = 3", ScenarioError, "line 3, actuator.friction = "),
        ("actuator = 3", ScenarioError, "line 2, actuator = 3: is no Actuator"),
        ("[[actuator]]\ntable_mass = 3", ScenarioError, "line 2, actuator"),
        ("[nonlinearity.friction]\nstatic = 90\ncoulomb = 100", ParameterError,
         "line 3, nonlinearity.friction.static = 90: must be at least the Coulomb force"),
        ("\n\ncontrol_rate = 333", ParameterError, "line 4, control_rate = 333: its period"),
        ("[limits]\nsoft_share = 3", ParameterError, "line 3, limits.soft_share = 3: must lie between"),
        ("[specimen]\nmasses = [1,\n 2, '3 m']", ScenarioError,
         "line 3, specimen.masses\\[2\\] = '3 m'"),
        ("[specimen]\nmasses = [1, 2]\ndampings = [1]", ParameterError, "line 2, specimen: masses"),
        ("[uncertainty]\ndelay = [3, 1]", ParameterError, "line 3, uncertainty.delay"),
        ("[equations]\nreaction_on_table = 1", ScenarioError, "line 3, .*: must be true or false"),
        ("[sensing.sensors.table_speed]\nnoise = 1", ScenarioError,
         "line 2, sensing.sensors.table_speed = .*did you mean 'table_velocity'|known: base_shear"),
        ("[sensing.sensors.base_shear]\nnoise = '1 m'", ScenarioError,
         "line 3, .*does not convert to N"),
        ("[sensing]\nhistory = 1.5", ScenarioError,
         "line 3, sensing.history = 1.5: must be a whole number"),
        ("base = 'lab'", ScenarioError, "line 2, base = 'lab': is no named scenario: .*laboratory"),
        ("name = 3", ScenarioError, "line 2, name = 3: must be a text"),
        ("schema = 1", ScenarioError, "line 2 = 'schema = 1': is no TOML: Cannot overwrite"),
        ("delay = ", ScenarioError, "line 2 = 'delay =': is no TOML: Invalid value"),
        ("delay = '1", ScenarioError, "line 2 = .*is no TOML"),
        ("delay = " + "[" * 5000, ScenarioError, "is no TOML"),
        ("[motion]\nmotions = 3", ScenarioError, "line 3, motion.motions = 3"),
        ("[motion]\nrecord = 'napa'", RecordError, "line 3, motion.record = 'napa': .*napa2014"),
        ("[motion.file]\nunits = 'g'", ScenarioError, "line 2, motion.file = .*needs path"),
        ("[motion.file]\npath = 'x.at2'", RecordError, "line 2, motion.file: .*x.at2"),
        ("[motion.file]\npath = 'CICLC.v1'", RecordError,
         "line 2, motion.file: column = None: the file holds 3"),
        ("[motion.file]\npath = 'CICLC.v1'\ncolumn = 7", RecordError,
         "line 2, motion.file: .*column = 7"),
        ("[motion.file]\npath = 'CICLC.v1'\nspeed = 7", ScenarioError, "line 4, motion.file.speed = 7"),
        ("[motion]\nfile = 'CICLC.v1'", ScenarioError,
         "line 3, motion.file = 'CICLC.v1': must have fields"),
        ("[motion]\namplitude = 1\nfile.path = 'CICLC.v1'", ScenarioError,
         "line 2, motion = .*not by both"),
        ("[specimen.uniform]\nstories = 2", ScenarioError,
         "needs mass_ratio, storey_frequency, damping_ratio"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_file_line_field_value_and_remedy(text, kind, message, write):
    file = write(text)
    with pytest.raises(kind, match=message) as caught:
        make_scenario(str(file))
    assert "my.toml" in str(caught.value) or kind is RecordError


@pytest.mark.parametrize("text", ["delay = 1\n", "schema = 2\n", "schema = '1'\n", "schema = true\n"])
def test_another_version_is_refused(text, tmp_path):
    (tmp_path / "my.toml").write_text(text)
    with pytest.raises(ScenarioError, match=r"schema = 1|must be 1, the version"):
        make_scenario(tmp_path / "my.toml")


def test_a_field_after_values_of_several_lines_is_named_by_its_own_line(write):
    storeys = "\n".join("  1," for _ in range(150))
    text = f"# a comment\n\n[specimen]\nmasses = [\n{storeys}\n]\nstiffness = 3\n"
    with pytest.raises(ScenarioError, match=r"line 157, specimen.stiffness = 3: is no field"):
        make_scenario(write(text))
    text = 'name = """\na\n[limits]\n]\nb"""\nspecimen.masses = [ # ]\n 1,\n 2 ]\n"delay" = "x y z"\n'
    with pytest.raises(ScenarioError, match="line 10, delay = 'x y z'"):
        make_scenario(write(text))


def test_what_is_no_text_is_refused(tmp_path):
    file = tmp_path / "my.toml"
    file.write_bytes(b"schema = 1\nname = '\xff'")
    with pytest.raises(ScenarioError, match="is no TOML"):
        make_scenario(file)
    file.write_bytes(b"#" * 1_000_001)
    with pytest.raises(ScenarioError, match="larger than 1 MB"):
        make_scenario(file)
    for path, why in ((tmp_path / "none.toml", "no such file"), (tmp_path, "is a folder")):
        with pytest.raises(ScenarioError, match=why):
            make_scenario(path)


def test_a_delay_is_a_time_or_a_number_of_physics_steps(write):
    text = 'physics_step = "0.5 ms"\ndelay = {}\n[uncertainty]\ndelay = ["0 ms", {}]\n'
    scenario = make_scenario(write(text.format('"2.5 ms"', '"3 ms"')))
    assert scenario.delay == 5.0 and scenario.uncertainty.delay == Uniform(0.0, 6.0)
    assert make_scenario(write(text.format("2.5", "3"))).delay == 2.5
    with pytest.raises(
        ScenarioError, match="line 3, delay = '2 mm': has the unit mm, which does not conv"
    ):
        make_scenario(write(text.format('"2 mm"', "3")))
