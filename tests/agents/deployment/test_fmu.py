"""FMUs pass the validator, simulate to the Python result, and unload cleanly."""

import shutil
import zipfile

import numpy as np
import pytest

from agents.deployment.compiled import CompiledProgram
from agents.deployment.controller_program import controller_program
from agents.deployment.fmu import write_fmu
from agents.deployment.plant import plant_program
from agents.deployment.recorded import record_decisions
from shake_env import make_scenario
from shake_env.errors import ParameterError
from shake_env.rollout import noise_earthquakes

fmpy = pytest.importorskip("fmpy", reason="fmpy is not installed: python -m pip install '.[fmu]'")
pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler is installed"
)
PERIODS = 200
VERSIONS = ("2.0", "3.0")


@pytest.fixture(scope="module")
def case():
    """A controller in the laboratory, its program, and its decisions on one earthquake."""
    scenario = make_scenario("laboratory", {"duration": 2.0})
    program, controller = controller_program("pid", scenario)
    decisions = record_decisions(controller, scenario, noise_earthquakes(scenario, 1), PERIODS)
    return scenario, program, decisions.observations[:, 0].astype(float), decisions.actions[:, 0]


def simulated(file, program, values):
    """Outputs (periods, outputs) of an FMU under inputs (periods, inputs) in SI."""
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(file)) == []
    names = [channel.identifier for channel in program.inputs]
    given = np.zeros(len(values), dtype=[("time", float), *((name, float) for name in names)])
    given["time"] = program.period * np.arange(len(values))
    for name, column in zip(names, values.T, strict=True):
        given[name] = column
    result = fmpy.simulate_fmu(
        str(file), input=given, stop_time=program.period * (len(values) - 1),
        step_size=program.period, output_interval=program.period,
    )  # fmt: skip
    return np.column_stack([result[channel.identifier] for channel in program.outputs])[1:]


@pytest.mark.parametrize("version", VERSIONS)
def test_a_controllers_fmu_decides_as_python_does(case, version, tmp_path):
    scenario, program, observations, actions = case
    file = write_fmu(program, tmp_path / "controller.fmu", version)
    scales = np.array([channel.scale for channel in program.inputs])
    outputs = simulated(file, program, observations * scales)
    np.testing.assert_allclose(outputs[:, 0] / scenario.current_limit, actions[:-1], atol=1e-9)


@pytest.mark.parametrize("version", VERSIONS)
def test_the_tables_fmu_moves_as_the_simulated_table(case, version, tmp_path):
    scenario, _, _, actions = case
    program = plant_program(scenario)
    outputs = simulated(
        write_fmu(program, tmp_path / "table.fmu", version),
        program,
        scenario.current_limit * actions[:, None].astype(float),
    )
    compiled = CompiledProgram(program)  # which a test holds equal to the simulation
    memory = compiled.begin(1)
    expected = [compiled.step(memory, np.array([[float(a)]]))[0][0] for a in actions[:-1]]
    size = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(outputs / size, np.array(expected) / size, atol=1e-9)
    assert size[0] > 1e-3


@pytest.mark.parametrize("version", VERSIONS)
def test_instances_are_apart_go_back_to_a_state_and_unload(case, version, tmp_path):
    from fmpy.fmi2 import FMU2Slave
    from fmpy.fmi3 import FMU3Slave

    _, program, observations, _ = case
    file = write_fmu(program, tmp_path / "controller.fmu", version)
    folder = fmpy.extract(str(file), str(tmp_path / "unzipped"))
    description = fmpy.read_model_description(folder)
    kind, two = (FMU2Slave, True) if version == "2.0" else (FMU3Slave, False)
    given = [v.valueReference for v in description.modelVariables if v.causality == "input"]
    asked = [v.valueReference for v in description.modelVariables if v.causality == "output"]
    scales = np.array([channel.scale for channel in program.inputs])

    def begun(name, token=description.guid):
        unit = kind(
            guid=token, unzipDirectory=folder, instanceName=name,
            modelIdentifier=description.coSimulation.modelIdentifier,
        )  # fmt: skip
        unit.instantiate()
        if two:
            unit.setupExperiment(startTime=0.0)
        unit.enterInitializationMode()
        unit.exitInitializationMode()
        return unit

    def step(unit, k):
        (unit.setReal if two else unit.setFloat64)(given, list(observations[k] * scales))
        unit.doStep(k * program.period, program.period)
        return (unit.getReal if two else unit.getFloat64)(asked)[0]

    first, second = begun("first"), begun("second")
    alone = [step(first, k) for k in range(20)]
    state = (first.getFMUstate if two else first.getFMUState)()
    onwards = [step(first, k) for k in range(20, 40)]
    assert [step(second, k) for k in range(20)] == alone
    (first.setFMUstate if two else first.setFMUState)(state)
    assert [step(first, k) for k in range(20, 40)] == onwards
    (first.freeFMUstate if two else first.freeFMUState)(state)
    first.reset()
    if two:
        first.setupExperiment(startTime=0.0)
    first.enterInitializationMode()
    first.exitInitializationMode()
    assert [step(first, k) for k in range(20)] == alone
    with pytest.raises(Exception, match="DoStep"):  # no whole period
        first.doStep(20 * program.period, 0.4 * program.period)
    with pytest.raises(Exception, match="instantiate"):
        begun("third", "{another}")
    for unit in (first, second):
        unit.terminate()
        unit.freeInstance()


@pytest.mark.parametrize("version", VERSIONS)
def test_an_fmu_holds_its_sources(case, version, tmp_path):
    _, program, _, _ = case
    with zipfile.ZipFile(write_fmu(program, tmp_path / "controller.fmu", version)) as file:
        names = set(file.namelist())
    assert {"modelDescription.xml", f"sources/{program.name}.c"} <= names
    assert ("sources/buildDescription.xml" in names) == (version == "3.0")


def test_another_ending_is_refused(case, tmp_path):
    with pytest.raises(ParameterError, match="fmu"):
        write_fmu(case[1], tmp_path / "controller.zip")
