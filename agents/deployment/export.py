"""What ``shake export`` does: a controller or the table as C or as an FMU, with its recorded test."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from agents.deployment.c_source import write_program
from agents.deployment.compiled import CompiledProgram
from agents.deployment.controller_program import controller_program
from agents.deployment.fmu import Version, write_fmu
from agents.deployment.plant import plant_program
from agents.deployment.program import Precision, Program
from agents.deployment.recorded import record_decisions
from agents.deployment.rehearsal.datagram import c_numbers
from shake_env.model.parameters import FloatArray
from shake_env.rollout import noise_earthquakes
from shake_env.scenario.scenario import Scenario

TABLE = "table"  # name that stands for the table itself
RECORDED = 200  # periods of the test that comes with a program


def export_c(
    name: str,
    scenario: Scenario,
    folder: str | os.PathLike[str],
    *,
    supervised: bool = False,
    precision: Precision = "float64",
    prefix: str | None = None,
) -> tuple[Program, list[Path]]:
    """Write a controller, or the table, as C with its test, Makefile and program for UDP.

    Parameters
    ----------
    name
        Of a controller, or `TABLE`.
    scenario, supervised, precision, prefix
        As for `controller_program`.
    folder
        Where; files of the same name are replaced.

    Returns
    -------
    program, files
        What was written.
    """
    folder = Path(folder)
    if name == TABLE:
        program = plant_program(scenario, precision, prefix)
        return program, write_program(program, folder, *_recorded_table(program))
    program, controller = controller_program(
        name, scenario, supervised=supervised, precision=precision, prefix=prefix
    )
    decisions = record_decisions(controller, scenario, noise_earthquakes(scenario, 1), RECORDED)
    inputs = decisions.observations[:, 0].astype(float)
    outputs = decisions.actions.astype(float)
    return program, write_program(program, folder, inputs, outputs, udp=c_numbers())


def export_fmu(
    name: str,
    scenario: Scenario,
    path: str | os.PathLike[str],
    *,
    version: Version = "3.0",
    supervised: bool = False,
    prefix: str | None = None,
) -> Program:
    """Write a controller, or the table, as an FMU; arguments as for `export_c`."""
    path = Path(path)
    if name == TABLE:
        program = plant_program(scenario, prefix=prefix)
    else:
        program, _ = controller_program(name, scenario, supervised=supervised, prefix=prefix)
    write_fmu(program, path, version)
    return program


def _recorded_table(program: Program) -> tuple[FloatArray, FloatArray]:
    """Return the table's response to a slow random current: what the target machine must repeat."""
    rng = np.random.default_rng(0)
    compiled = CompiledProgram(program)
    memory, action = compiled.begin(1), 0.0
    inputs, outputs = [], []
    for _ in range(RECORDED):
        action = float(np.clip(0.9 * action + 0.1 * rng.standard_normal(), -1.0, 1.0))
        inputs.append([action])
        outputs.append(compiled.step(memory, np.array([[action]]))[0][0])
    return np.array(inputs), np.array(outputs)
