"""The command ``shake export``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console

from agents.cli.command_options import CommandOptions, Flag
from agents.cli.output_path import output_folder, require_writable_file
from agents.scenario_options import ScenarioOptions
from shake_env.errors import ParameterError

SUFFIXES = {"onnx": ".onnx", "fmu": ".fmu"}


@dataclass(frozen=True, kw_only=True)
class Export(CommandOptions):
    """Write a controller as C99, as an FMU or as ONNX, for other runtimes than numpy.

    Try:
      shake export lqg --scenario laboratory --to c --output out/lqg
      shake export lqg --scenario laboratory --to fmu --output out/lqg.fmu --safety-supervisor
      shake export table --scenario laboratory --to fmu --output out/table.fmu
      shake export runs/mine --to onnx --output policy.onnx
    """

    controller: tyro.conf.Positional[str]
    """Name of a controller, policy file or run directory; "table" is the simulated table itself."""
    file: tyro.conf.Positional[Path | None] = None
    """The same as --output."""
    to: Literal["c", "fmu", "onnx"] = "onnx"
    """C99 source (a folder), a functional mock-up unit (*.fmu), or a policy's ONNX graph (*.onnx)."""
    output: Path | None = None
    """File or folder to write (a folder for C: default out/CONTROLLER)."""
    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(default_factory=ScenarioOptions)
    safety_supervisor: Flag = False
    """Put the safety supervisor around the controller (C, FMU)."""
    precision: Literal["float64", "float32"] = "float64"
    """Arithmetic of the C program."""
    fmi: Literal["2.0", "3.0"] = "3.0"
    """Version of FMI."""
    prefix: str | None = None
    """Prefix of the C functions and the FMU's model identifier (default: CONTROLLER_SCENARIO, with
    _supervised and _float32 where they are asked for). Programs that are linked together need different
    ones."""
    force: Flag = False
    """Write into a folder although there are files in it."""

    def run(self, console: Console) -> dict[str, Any]:
        """Write, and say what was written."""
        if self.file is not None and self.output is not None:
            raise ParameterError("output", str(self.output), "is given twice: leave one of them out")
        if self.prefix is not None and not (self.prefix.isascii() and self.prefix.isidentifier()):
            raise ParameterError("prefix", self.prefix, "must be a C identifier, such as my_controller")
        self._refuse_what_has_no_effect()
        target = self.file or self.output
        if self.to == "c":
            return self._c(target, console)
        suffix = SUFFIXES[self.to]
        if target is None or target.suffix != suffix:
            shown = None if target is None else str(target)
            raise ParameterError("output", shown, f"must end in {suffix}")
        require_writable_file(target, "output")
        return self._fmu(target, console) if self.to == "fmu" else self._onnx(target, console)

    def _refuse_what_has_no_effect(self) -> None:
        if self.safety_supervisor and self.to == "onnx":
            raise ParameterError(
                "safety_supervisor", True, "an ONNX graph is the policy alone: export to c or fmu"
            )
        if self.safety_supervisor and self.controller == "table":
            raise ParameterError(
                "safety_supervisor", True, "the table is no controller: put it around the controller's"
            )
        if self.precision == "float32" and self.to != "c":
            raise ParameterError(
                "precision", self.precision, f"is an option of the C program, {self.to} has its own"
            )

    def _c(self, target: Path | None, console: Console) -> dict[str, Any]:
        from agents.deployment.export import export_c

        scenario = self.scenario.build()
        name = self.controller.rstrip("/").rsplit("/", 1)[-1]
        folder = output_folder(target, Path("out") / name, force=self.force)
        program, files = export_c(
            self.controller, scenario, folder, supervised=self.safety_supervisor,
            precision=self.precision, prefix=self.prefix,
        )  # fmt: skip
        for file in files:
            console.print(f"wrote {file}")
        console.print(
            f"{len(program.inputs)} inputs, one step each {program.period:g} s; try: make check"
        )
        return {"output": str(folder), "files": [file.name for file in files], "name": program.name}

    def _fmu(self, target: Path, console: Console) -> dict[str, Any]:
        from agents.deployment.export import export_fmu

        program = export_fmu(
            self.controller, self.scenario.build(), target, version=self.fmi,
            supervised=self.safety_supervisor, prefix=self.prefix,
        )  # fmt: skip
        console.print(
            f"wrote {target}: FMI {self.fmi}, {len(program.inputs)} inputs, "
            f"{len(program.outputs)} outputs, step {program.period:g} s"
        )
        return {"output": str(target), "fmi": self.fmi, "name": program.name}

    def _onnx(self, target: Path, console: Console) -> dict[str, Any]:
        from agents.policies.onnx_export import export_onnx
        from agents.policies.policy_file import load_policy
        from agents.policies.registry import policy_path

        policy = load_policy(policy_path(self.controller))
        export_onnx(policy, target)
        widths = () if policy.memory is None else policy.memory.state_widths
        console.print(f"wrote {target}: observation (N, {policy.observation_size}) to action (N, 1)")
        if widths:
            shapes = ", ".join(f"(N, {width})" for width in widths)
            console.print(f"state: inputs and outputs {shapes}, zeros at first")
        return {
            "output": str(target),
            "observation_size": policy.observation_size,
            "states": len(widths),
            "units": 0 if policy.memory is None else policy.memory.units,
        }
