"""FMUs pass the validator, simulate to the Python result, and unload cleanly."""

import shutil
import zipfile
from dataclasses import replace

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


def unit_of(file, folder):
    """An instance of an FMU of FMI 3.0, begun, with a function that steps it: inputs in, outputs out."""
    from fmpy.fmi3 import FMU3Slave

    where = fmpy.extract(str(file), str(folder))
    description = fmpy.read_model_description(where)
    references = {
        causality: [v.valueReference for v in description.modelVariables if v.causality == causality]
        for causality in ("input", "output")
    }
    unit = FMU3Slave(
        guid=description.guid, unzipDirectory=where, instanceName=file.name,
        modelIdentifier=description.coSimulation.modelIdentifier,
    )  # fmt: skip
    unit.instantiate()
    unit.enterInitializationMode()
    unit.exitInitializationMode()

    def step(k, period, values):
        unit.setFloat64(references["input"], list(values))
        unit.doStep(k * period, period)
        return np.array(unit.getFloat64(references["output"]))

    return unit, step


def test_a_master_closes_the_loop_of_controller_and_table(tmp_path):
    """Sensors without noise and offset: the loop of two FMUs is the simulation's."""
    scenario = make_scenario("laboratory", {"duration": 1.0})
    sensors = tuple(
        replace(each, noise=0.0, bias=0.0, gain_error=0.0) for each in scenario.sensing.sensors
    )
    scenario = replace(scenario, sensing=replace(scenario.sensing, sensors=sensors))
    programs = [controller_program("pid", scenario)[0], plant_program(scenario)]
    made = [
        unit_of(write_fmu(program, tmp_path / f"{name}.fmu"), tmp_path / name)
        for name, program in zip(("controller", "table"), programs, strict=True)
    ]
    expected = record_decisions(
        controller_program("pid", scenario)[1], scenario, noise_earthquakes(scenario, 1)
    )
    inputs, outputs = (
        [channel.name for channel in each] for each in (programs[0].inputs, programs[1].outputs)
    )
    scales = np.array([channel.scale for channel in programs[0].inputs])
    measured = {name: inputs.index(name) for name in outputs if name.startswith("measured")}
    last, readings, current, currents = inputs.index("last action"), np.zeros(len(outputs)), 0.0, []
    for k, shown in enumerate(expected.observations[:, 0].astype(float)):
        given = shown * scales  # the target's part is known before the test
        given[list(measured.values())] = [readings[outputs.index(name)] for name in measured]
        given[last] = current / scenario.current_limit
        current = made[0][1](k, scenario.control_period, given)[0]
        currents.append(current)
        readings = made[1][1](k, scenario.control_period, [current])
    np.testing.assert_allclose(
        np.array(currents) / scenario.current_limit, expected.actions[:, 0], atol=1e-6
    )
    assert np.ptp(currents) > 1e-3 * scenario.current_limit
    for unit, _ in made:
        unit.terminate()
        unit.freeInstance()


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
