"""What an FMU refuses, it says in words to the importer's log, which fmpy prints."""

import shutil

import numpy as np
import pytest

from agents.deployment.controller_program import controller_program
from agents.deployment.fmu import write_fmu
from shake_env import make_scenario

fmpy = pytest.importorskip("fmpy", reason="fmpy is not installed: python -m pip install '.[fmu]'")
pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler is installed"
)


class Unit:
    """One instance of an FMU of either version, with the names of FMI 3.0."""

    def __init__(self, folder, version, token=None):
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        description = fmpy.read_model_description(folder)
        self.two = version == "2.0"
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.unit = (FMU2Slave if self.two else FMU3Slave)(
            guid=token or description.guid, unzipDirectory=folder, instanceName="mine",
            modelIdentifier=description.coSimulation.modelIdentifier,
        )  # fmt: skip
        self.unit.instantiate()  # fmpy's own callback prints
        if self.two:
            self.unit.setupExperiment(startTime=0.0)
        self.unit.enterInitializationMode()
        self.unit.exitInitializationMode()
        self.set = self.unit.setReal if self.two else self.unit.setFloat64
        self.get = self.unit.getReal if self.two else self.unit.getFloat64

    def deserialize(self, state):
        return (self.unit.deSerializeFMUstate if self.two else self.unit.deserializeFMUState)(state)

    def integers(self, references):
        return (self.unit.getInteger if self.two else self.unit.getInt32)(references)


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def made(request, tmp_path_factory):
    """Version, unzipped FMU and program of a controller in the laboratory."""
    program, _ = controller_program("pid", make_scenario("laboratory"))
    folder = tmp_path_factory.mktemp("fmu")
    file = write_fmu(program, folder / "pid.fmu", request.param)
    return request.param, fmpy.extract(str(file), str(folder / "unzipped")), program


def said(capfd, action):
    """What the FMU says as it refuses an action."""
    with pytest.raises(Exception):  # noqa: B017  # fmpy's own type, which names a status only
        action()
    return " ".join(capfd.readouterr().out.split())


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_an_input_that_is_refused_is_named_with_its_value(made, value, capfd):
    version, folder, program = made
    unit = Unit(folder, version)
    unit.set([unit.references["measured_load_pressure"]], [value])
    text = said(capfd, lambda: unit.unit.doStep(2 * program.period, program.period))
    assert f"[ERROR] fmi{version[0]}DoStep at 0.01 s: measured_load_pressure [Pa] = {value:g}" in text
    assert text.count("give a finite number") == 1
    assert unit.get([unit.references["current"]]) == [0.0]
    unit.set([unit.references["measured_load_pressure"]], [1e5])
    unit.unit.doStep(3 * program.period, program.period)
    assert capfd.readouterr().out == ""


def test_a_step_that_is_no_whole_period_is_told_the_period(made, capfd):
    version, folder, program = made
    unit = Unit(folder, version)
    text = said(capfd, lambda: unit.unit.doStep(0.0, 0.4 * program.period))
    assert "communication step = 0.002 s: give a whole number of control periods of 0.005 s" in text


def test_references_states_tokens_and_functions_that_are_none_are_told(made, capfd):
    version, folder, program = made
    unit = Unit(folder, version)
    last = len(program.inputs) + len(program.outputs)
    assert f"value reference {last + 1}: no such variable" in said(capfd, lambda: unit.get([last + 1]))
    assert f"inputs and outputs have 1 to {last}" in said(capfd, lambda: unit.set([last + 1], [0.0]))
    assert "the time is set by the steps alone" in said(capfd, lambda: unit.set([0], [1.0]))
    assert "3 bytes: a state of this FMU has" in said(capfd, lambda: unit.deserialize(b"abc"))
    assert "use what modelDescription.xml names" in said(capfd, lambda: unit.integers([1]))
    assert "instantiation token {another}" in said(capfd, lambda: Unit(folder, version, "{another}"))


def test_a_simulation_shows_the_message(made, capfd):
    _, folder, program = made
    given = np.array([(0.0, 0.0), (0.02, np.nan)], dtype=[("time", float), ("last_action", float)])
    text = said(
        capfd,
        lambda: fmpy.simulate_fmu(
            folder, input=given, stop_time=0.1, step_size=program.period, output_interval=program.period
        ),
    )
    assert "last_action [-] = nan: give a finite number" in text
