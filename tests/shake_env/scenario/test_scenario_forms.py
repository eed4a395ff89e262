"""Forms in scenario files: specimens, structures and motions by constructors, and tables by name."""

import tomllib
from dataclasses import replace

import jsonschema
import pytest

from shake_env import (
    FilteredNoise,
    MotionSet,
    RecordedMotion,
    Specimen,
    make_scenario,
    read_motion,
)
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.ranges import RANGES
from shake_env.model.specimens import specimen_from_matrices
from shake_env.rollout import recorded_earthquakes
from shake_env.scenario.forms import FORMS
from shake_env.scenario.json_schema import scenario_schema
from shake_env.scenario.scenario_writer import write_scenario


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
    with pytest.raises(ScenarioError, match=r"line 2, table = 'lnec-uniaxil': did you mean 'lnec-uni"):
        make_scenario(write('table = "lnec-uniaxil"\nactuator.table_mass = "420 kg"\n'))
