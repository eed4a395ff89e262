"""A program as a functional mock-up unit: co-simulation, FMI 2.0 or 3.0, for this platform.

Modelica Association, Functional Mock-up Interface, versions 2.0.4 (2022) and 3.0.1 (2023). One
communication step is one or more whole periods. A controller's FMU decides within `doStep`, from the
inputs set before it: a master that steps the controller first and the table after it adds no delay.
"""

from __future__ import annotations

import hashlib
import os
import platform
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Any, Literal

from agents.deployment.c_source import render_program, template_environment, tidy
from agents.deployment.channels import Channel
from agents.deployment.compiled import FLAGS, run_compiler
from agents.deployment.program import Program
from shake_env.errors import ParameterError
from shake_env.files import write_bytes, write_text

Version = Literal["2.0", "3.0"]
# Exponents of the base units of each unit, as FMI has them.
BASE_UNITS = {
    "m": {"m": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s^2": {"m": 1, "s": -2},
    "m s": {"m": 1, "s": 1},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "N": {"kg": 1, "m": 1, "s": -2},
    "A": {"A": 1},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
}
_REASON = "this FMU does not offer it: use what modelDescription.xml names"
_REFERENCES = [("const reference_t *", "references"), ("size_t ", "count")]


def write_fmu(program: Program, path: str | os.PathLike[str], version: Version = "3.0") -> Path:
    """Compile a program and write it as an FMU; return the file.

    Raises
    ------
    ParameterError
        If the file's name does not end in ``.fmu``.
    ShakeError
        If there is no C compiler, or it refuses the source.
    """
    path = Path(path)
    if path.suffix != ".fmu":
        raise ParameterError("output", str(path), "must end in .fmu")
    major = version[0]
    texts = render_program(program)
    token = "{" + hashlib.sha256("".join(texts.values()).encode()).hexdigest()[:32] + "}"
    env = template_environment(program.precision)
    env.filters["unit"] = _unit
    interface = f"{program.name}_fmi{major}.c"
    context: dict[str, Any] = {
        "major": major,
        "name": program.name,
        "NAME": program.name.upper(),
        "title": program.title,
        "tool": program.provenance.get("program", "shake-env"),
        "token": token,
        "period": repr(program.period),
        "inputs": program.inputs,
        "outputs": program.outputs,
        "rounds_inputs": program.rounds_inputs,
        "units": _units(program),
        "sources": [f"{program.name}.c", interface],
        "unsupported": _UNSUPPORTED[version],
        "reason": _REASON,
    }
    texts[interface] = tidy(env.get_template(f"fmu/fmi{major}.c").render(context))
    description = env.get_template(f"fmu/modelDescription{major}.xml").render(context)
    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder)
        for name, text in texts.items():
            write_text(where / name, text)
        library = where / f"{program.name}{_extension()}"
        sources = [where / f"{program.name}.c", where / interface]
        hidden = ["-fvisibility=hidden", "-shared", "-fPIC"]
        run_compiler([*FLAGS, *hidden, "-o", library, *sources, "-lm"])
        archive = where / "archive"
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
            file.writestr("modelDescription.xml", description)
            file.write(library, f"binaries/{_platform(version)}/{library.name}")
            for name, text in texts.items():
                file.writestr(f"sources/{name}", text)
            if version == "3.0":
                build = env.get_template("fmu/buildDescription.xml").render(context)
                file.writestr("sources/buildDescription.xml", build)
        write_bytes(path, archive.read_bytes())
    return path


def _extension() -> str:
    return {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so")


def _platform(version: Version) -> str:
    """Return the folder of this platform's library."""
    if version == "2.0":
        return {"darwin": "darwin64", "win32": "win64"}.get(sys.platform, "linux64")
    system = {"darwin": "darwin", "win32": "windows"}.get(sys.platform, "linux")
    machine = platform.machine().lower()
    architecture = "aarch64" if machine in ("arm64", "aarch64") else "x86_64"
    return f"{architecture}-{system}"


def _unit(channel: Channel) -> str:
    """Return the attribute of a variable's unit; none for a number without one."""
    return f' unit="{channel.unit}"' if channel.unit in BASE_UNITS else ""


def _units(program: Program) -> list[dict[str, str]]:
    used = dict.fromkeys(channel.unit for channel in (*program.inputs, *program.outputs))
    return [
        {"name": unit, "base": "".join(f' {b}="{e}"' for b, e in BASE_UNITS[unit].items())}
        for unit in used
        if unit in BASE_UNITS
    ]


def _fmi2_unsupported() -> dict[str, list[tuple[str, str]]]:
    """Return functions of FMI 2.0 that are exported and return an error, with their parameters."""
    every: dict[str, list[tuple[str, str]]] = {}
    for kind, given, asked in (
        ("Integer", "const int *", "int *"), ("Boolean", "const int *", "int *"),
        ("String", "const char *const *", "const char **"),
    ):  # fmt: skip
        every[f"fmi2Get{kind}"] = [*_REFERENCES, (asked, "values")]
        every[f"fmi2Set{kind}"] = [*_REFERENCES, (given, "values")]
    every["fmi2GetDirectionalDerivative"] = [
        ("const reference_t *", "unknown"), ("size_t ", "unknowns"), ("const reference_t *", "known"),
        ("size_t ", "knowns"), ("const double *", "change"), ("double *", "derivative"),
    ]  # fmt: skip
    orders = ("const int *", "orders")
    every["fmi2SetRealInputDerivatives"] = [*_REFERENCES, orders, ("const double *", "values")]
    every["fmi2GetRealOutputDerivatives"] = [*_REFERENCES, orders, ("double *", "values")]
    for kind, value in (
        ("", "int *"), ("Real", "double *"), ("Integer", "int *"), ("Boolean", "int *"),
        ("String", "const char **"),
    ):  # fmt: skip
        every[f"fmi2Get{kind}Status"] = [("int ", "kind"), (value, "value")]
    return every


def _fmi3_unsupported() -> dict[str, list[tuple[str, str]]]:
    """Return functions of FMI 3.0 that are exported and return an error, with their parameters."""
    every: dict[str, list[tuple[str, str]]] = {}
    numbers = {
        "Float32": "float", "Int8": "int8_t", "UInt8": "uint8_t", "Int16": "int16_t",
        "UInt16": "uint16_t", "Int32": "int32_t", "UInt32": "uint32_t", "Int64": "int64_t",
        "UInt64": "uint64_t", "Boolean": "bool", "String": "const char *",
    }  # fmt: skip
    size = ("size_t ", "size")
    for kind, c_type in numbers.items():
        given = "const char *const *" if kind == "String" else f"const {c_type} *"
        every[f"fmi3Get{kind}"] = [*_REFERENCES, (f"{c_type} *", "values"), size]
        every[f"fmi3Set{kind}"] = [*_REFERENCES, (given, "values"), size]
    for way, const in (("Get", ""), ("Set", "const ")):
        sizes = (f"{const}size_t *", "sizes")
        every[f"fmi3{way}Binary"] = [*_REFERENCES, sizes, ("const unsigned char **", "values"), size]
        every[f"fmi3{way}Clock"] = [*_REFERENCES, (f"{const}bool *", "values")]
    every["fmi3GetNumberOfVariableDependencies"] = [("reference_t ", "variable"), ("size_t *", "count")]
    every["fmi3GetVariableDependencies"] = [
        ("reference_t ", "dependent"), ("size_t *", "elements"), ("reference_t *", "independents"),
        ("size_t *", "others"), ("int *", "kinds"), ("size_t ", "count"),
    ]  # fmt: skip
    for name in ("Directional", "Adjoint"):
        every[f"fmi3Get{name}Derivative"] = [
            ("const reference_t *", "unknowns"), ("size_t ", "unknown_count"),
            ("const reference_t *", "knowns"), ("size_t ", "known_count"), ("const double *", "seed"),
            ("size_t ", "seed_size"), ("double *", "values"), size,
        ]  # fmt: skip
    every["fmi3GetOutputDerivatives"] = [
        *_REFERENCES, ("const int32_t *", "orders"), ("double *", "values"), size,
    ]  # fmt: skip
    every["fmi3GetIntervalDecimal"] = [*_REFERENCES, ("double *", "intervals"), ("int *", "qualifiers")]
    every["fmi3SetIntervalDecimal"] = [*_REFERENCES, ("const double *", "intervals")]
    every["fmi3GetShiftDecimal"] = [*_REFERENCES, ("double *", "shifts")]
    every["fmi3SetShiftDecimal"] = [*_REFERENCES, ("const double *", "shifts")]
    whole = [("uint64_t *", "counters"), ("uint64_t *", "resolutions")]
    given_whole = [("const uint64_t *", "counters"), ("const uint64_t *", "resolutions")]
    every["fmi3GetIntervalFraction"] = [*_REFERENCES, *whole, ("int *", "qualifiers")]
    every["fmi3SetIntervalFraction"] = [*_REFERENCES, *given_whole]
    every["fmi3GetShiftFraction"] = [*_REFERENCES, *whole]
    every["fmi3SetShiftFraction"] = [*_REFERENCES, *given_whole]
    every["fmi3EvaluateDiscreteStates"] = []
    every["fmi3UpdateDiscreteStates"] = [
        ("bool *", "again"), ("bool *", "ends"), ("bool *", "nominals"), ("bool *", "states"),
        ("bool *", "event"), ("double *", "when"),
    ]  # fmt: skip
    every["fmi3EnterContinuousTimeMode"] = []
    every["fmi3CompletedIntegratorStep"] = [
        ("bool ", "no_return"),
        ("bool *", "event"),
        ("bool *", "ends"),
    ]
    every["fmi3SetTime"] = [("double ", "when")]
    every["fmi3SetContinuousStates"] = [("const double *", "states"), size]
    for name in ("ContinuousStateDerivatives", "EventIndicators", "ContinuousStates",
                 "NominalsOfContinuousStates"):  # fmt: skip
        every[f"fmi3Get{name}"] = [("double *", "values"), size]
    for name in ("EventIndicators", "ContinuousStates"):
        every[f"fmi3GetNumberOf{name}"] = [("size_t *", "count")]
    every["fmi3ActivateModelPartition"] = [("reference_t ", "clock"), ("double ", "when")]
    return every


_UNSUPPORTED = {"2.0": _fmi2_unsupported(), "3.0": _fmi3_unsupported()}
