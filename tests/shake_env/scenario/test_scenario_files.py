"""Scenario files in TOML: read with their units and includes, written with comments, exact both ways."""

import json
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import gymnasium
import jsonschema
import numpy as np
import pytest
from random_scenarios import first_steps, random_scenario

from agents.scenario_options import ScenarioOptions
from shake_env import (
    FilteredNoise,
    MotionSet,
    RecordedMotion,
    Specimen,
    Uniform,
    make_scenario,
    read_motion,
)
from shake_env.errors import FileError, ParameterError, RecordError, ScenarioError
from shake_env.model.ranges import RANGES
from shake_env.model.specimens import specimen_from_matrices
from shake_env.rollout import recorded_earthquakes
from shake_env.scenario.builder import LATER_FIELDS
from shake_env.scenario.forms import FORMS
from shake_env.scenario.json_schema import scenario_schema
from shake_env.scenario.presets import NAMED
from shake_env.scenario.scenario_file import parse_toml, scenario_fields, scenario_of
from shake_env.scenario.scenario_writer import SCHEMA_FILE, scenario_toml, write_scenario

VALIDATOR = jsonschema.Draft7Validator(scenario_schema())
RECORD = Path(__file__).parents[2] / "data" / "CICLC_trimmed.v1"


@pytest.fixture
def write(tmp_path):
    """A function that writes a file, with the version ahead of its text, and returns its path."""
    shutil.copy(RECORD, tmp_path / "CICLC.v1")

    def written(text, name="my.toml"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"schema = 1\n{text}", encoding="utf-8")
        return path

    return written


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


# Forms


def test_equal_storeys_stand_on_the_files_own_table(write):
    file = write(
        '[actuator]\ntable_mass = "0.4 t"\n[specimen.uniform]\nstories = 3\nmass_ratio = 0.2\n'
        'storey_frequency = "6 Hz"\ndamping_ratio = "3 %"\n'
    )
    wanted = Specimen.uniform(
        stories=3, mass_ratio=0.2, storey_frequency=6.0, damping_ratio=0.03, table_mass=400.0
    )
    assert make_scenario(file).specimen == wanted


def modal_specimen(*, shapes: tuple[tuple[float, ...], ...], mass: float, _context) -> Specimen:
    """Return a specimen of its modes.

    Parameters
    ----------
    shapes
        Shape of each mode.
    mass
        Mass of a storey [kg].
    """
    assert _context.actuator.table_mass == 180.0
    count = len(shapes)
    return Specimen(masses=(mass,) * count, stiffnesses=shapes[0], dampings=(1.0,) * count)


def test_a_form_of_a_specimen_is_added_by_its_constructor_alone(write, monkeypatch):
    ranges = {"mass": RANGES["Specimen"]["masses"]}
    monkeypatch.setitem(RANGES, "modal_specimen", ranges)
    monkeypatch.setitem(FORMS, Specimen, {"modes": modal_specimen})
    text = "[specimen.modes]\nmass = {}\nshapes = [[1e4, 2e4], [3e4, 4e4]]\n"
    assert make_scenario(write(text.format('"0.04 t"'))).specimen.masses == (40.0, 40.0)
    with pytest.raises(ParameterError, match=r"line 3, specimen.modes.mass = -1: must be a finite"):
        make_scenario(write(text.format("-1")))
    schema = scenario_schema()
    form = schema["definitions"]["Specimen"]["anyOf"][1]["properties"]["modes"]
    assert form["required"] == ["shapes", "mass"]
    assert form["properties"]["mass"]["description"].startswith("Mass of a storey [kg]. Range:")
    validator = jsonschema.Draft7Validator(schema)
    assert validator.is_valid(tomllib.loads(f"schema = 1\n{text.format(40)}"))
    assert not validator.is_valid(tomllib.loads(f"schema = 1\n{text.format(-40)}"))


def test_a_record_in_a_file_is_read_relative_to_it_and_scaled_to_the_files_table(write, monkeypatch):
    text = 'base = "laboratory"\n[limits]\ntable_displacement = "{}"\n'
    text += '[motion.file]\npath = "CICLC.v1"\ncolumn = 2\n'
    file = write(text.format("76 mm"))
    monkeypatch.chdir("/")
    scenario = make_scenario(file)
    motion = scenario.motion
    assert motion.record.digest == read_motion(file.with_name("CICLC.v1"), column=2)[0].digest
    assert (motion.highpass_frequency, motion.lowpass_frequency) == (0.2, 25.0)
    assert 0.1 < motion.amplitude < 1.0
    smaller = make_scenario(write(text.format("38 mm"))).motion
    assert smaller.amplitude < motion.amplitude
    as_it_is = make_scenario(write(text.format("76 mm") + "scale_to_table = false\namplitude = 0.5\n"))
    assert as_it_is.motion.amplitude == 0.5
    (quake,) = recorded_earthquakes(scenario)
    assert quake.motion == motion


def test_the_step_of_a_record_has_a_unit(write):
    text = '[motion.file]\npath = "plain.csv"\nunits = "g"\nsampling_interval = "{}"\n'
    file = write(text.format("5 ms"))
    lines = "\n".join(f"{0.1 * (-1) ** i}" for i in range(400))
    (file.parent / "plain.csv").write_text(f"acceleration\n{lines}\n")
    assert make_scenario(file).motion.record.sampling_interval == 0.005
    with pytest.raises(ScenarioError, match=r"line 5, motion.file.sampling_interval = '5 mm'"):
        make_scenario(write(text.format("5 mm")))


def test_a_set_of_motions(write):
    scenario = make_scenario(
        write(
            """
[motion]
amplitude = 0.5
[[motion.motions]]
record = "napa2014_68150_hne"
[[motion.motions]]
file.path = "CICLC.v1"
file.column = 1
file.scale_to_table = false
[[motion.motions]]
duration = "3 s"
envelope = { rise = "1 s" }
"""
        )
    )
    first, second, third = scenario.motion.motions
    assert isinstance(scenario.motion, MotionSet) and scenario.motion.amplitude == 0.5
    assert first == RecordedMotion(record="napa2014_68150_hne")
    assert second.record.name == "CICLC channel 1 (90 Deg)"
    assert isinstance(third, FilteredNoise) and third.envelope.rise == 1.0 and third.duration == 3.0


# Writing


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


MATRICES = """
[specimen.matrices]
mass = ["40 kg", "30 kg"]
stiffness = [["80 kN/m", "-30 kN/m"], ["-30 kN/m", "30 kN/m"]]
rayleigh_frequencies = ["2 Hz", "8 Hz"]
rayleigh_damping_ratios = ["3 %", 0.04]
"""


def test_a_structure_is_given_by_matrices_a_file_or_modes(write, tmp_path):
    mass, stiffness = (40.0, 30.0), [[8e4, -3e4], [-3e4, 3e4]]
    expected = specimen_from_matrices(mass, stiffness, rayleigh=((2.0, 0.03), (8.0, 0.04)))
    scenario = make_scenario(write(MATRICES))
    assert scenario.specimen == expected
    written = tmp_path / "written.toml"
    write_scenario(scenario, written)
    assert make_scenario(written).specimen == expected
    assert "coupled_stiffnesses = [[" in written.read_text()
    (tmp_path / "frame.csv").write_text("M\n40,0\n0,30\nK\n8e4,-3e4\n-3e4,3e4\n")
    ratio = specimen_from_matrices(mass, stiffness, damping_ratio=0.02)
    text = '[specimen.file]\npath = "frame.csv"\ndamping_ratio = "2 %"\n'
    assert make_scenario(write(text)).specimen == ratio
    modes = (
        '[specimen.modes]\nmasses = ["50 kg", "40 kg"]\nfrequencies = ["2 Hz"]\n'
        "damping_ratios = [0.01]\nshapes = [[0.5], [1]]\n"
    )
    found = make_scenario(write(modes)).specimen
    assert found.fixed_base_frequencies == pytest.approx([2.0, 6.0])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('["2 Hz", "8 Hz"]', '["2 Hz"]', "give two rayleigh_frequencies"),
        ('"-30 kN/m", "30 kN/m"', '"-20 kN/m", "30 kN/m"', "must be symmetric"),
        ('"40 kg"', '"40 m"', "has the unit m, which does not convert to kg"),
    ],
)
def test_a_structure_of_wrong_matrices_is_refused(write, old, new, message):
    assert old in MATRICES
    with pytest.raises((ScenarioError, ParameterError), match=message):
        make_scenario(write(MATRICES.replace(old, new, 1)))


def test_a_file_names_its_table_and_says_the_rest_on_top(write, tmp_path):
    file = write('base = "laboratory"\ntable = "lnec-uniaxial"\ndelay = 3\n')
    scenario = make_scenario(file)
    named = make_scenario("laboratory", {"table": "lnec-uniaxial", "delay": 3})
    assert replace(scenario, name="laboratory") == named
    written = tmp_path / "written.toml"
    write_scenario(named, written)
    assert make_scenario(written) == named
    own = make_scenario(write('table = "mine"\nactuator.table_mass = "420 kg"\n'))
    assert own.table == "mine" and own.actuator.table_mass == 420.0
    with pytest.raises(ScenarioError, match=r"line 3, table = 'lnec': .*lnec-uniaxial"):
        make_scenario(write('base = "laboratory"\ntable = "lnec"\n'))


# Round trip


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


# The schema


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
