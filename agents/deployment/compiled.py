"""An exported program compiled on this machine: as a `Controller`, and its speed."""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.deployment.c_source import render_program
from agents.deployment.program import Program
from shake_env.errors import ShakeError
from shake_env.files import write_text
from shake_env.model.parameters import FloatArray

FLAGS = (
    "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off", "-O3",
)  # fmt: skip


def compiler() -> str:
    """Return the path of a C compiler.

    Raises
    ------
    ShakeError
        If there is none.
    """
    for name in ("cc", "gcc", "clang"):
        if path := shutil.which(name):
            return path
    raise ShakeError("C compiler", None, "install gcc or clang, and put it on the PATH")


def run_compiler(arguments: Sequence[str | Path], cc: str | None = None) -> None:
    """Run the compiler.

    Raises
    ------
    ShakeError
        If it refuses the source; its first lines are in the message.
    """
    command = [cc or compiler(), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ShakeError("C compiler", command[0], f"refused the source: {done.stderr[:2000]}")


class CompiledProgram:
    """A program as a shared library in this process, with a memory for each table of a batch.

    Parameters
    ----------
    program
        What is compiled.
    """

    def __init__(self, program: Program) -> None:
        self.program = program
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            where = Path(folder)
            for name, text in render_program(program).items():
                write_text(where / name, text)
            library = where / f"lib{program.name}.so"
            run_compiler([*FLAGS, "-shared", "-fPIC", "-o", library, where / f"{program.name}.c", "-lm"])
            loaded = ctypes.CDLL(str(library))  # it stays loaded when its file is gone
        self._size = getattr(loaded, f"{program.name}_size")
        self._size.restype = ctypes.c_ulong
        self._init, self._reset, self._step = (
            getattr(loaded, f"{program.name}_{what}") for what in ("init", "reset", "step")
        )
        for function in (self._init, self._reset, self._step):
            function.argtypes = [ctypes.c_void_p] * (1 if function is not self._step else 3)
        self._init.restype = self._reset.restype = None
        self._type = np.float64 if program.precision == "float64" else np.float32

    def begin(self, tables: int) -> NDArray[np.uint8]:
        """Return memories (tables, bytes) of programs that have just begun."""
        memory = np.zeros((tables, self._size()), dtype=np.uint8)
        for row in memory:
            self._init(row.ctypes.data)
        return memory

    def step(
        self, memory: NDArray[np.uint8], inputs: NDArray[Any], fresh: NDArray[np.bool_] | None = None
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """Advance each memory in place by one period.

        Parameters
        ----------
        memory
            (tables, bytes) of `begin`.
        inputs
            (tables, inputs) over their scales.
        fresh
            (tables,) of bool, where a new test begins.

        Returns
        -------
        outputs, codes
            (tables, outputs) over their scales, and (tables,).
        """
        given = np.ascontiguousarray(inputs, dtype=self._type)
        outputs = np.zeros((len(given), len(self.program.outputs)), dtype=self._type)
        codes = np.zeros(len(given), dtype=np.int64)
        for i, row in enumerate(memory):
            if fresh is not None and fresh[i]:
                self._reset(row.ctypes.data)
            codes[i] = self._step(row.ctypes.data, given[i].ctypes.data, outputs[i].ctypes.data)
        return outputs.astype(np.float64), codes


class CompiledController(CompiledProgram):
    """A controller's program as a `shake_env.controller.Controller`."""

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the action (..., 1) for an observation (..., n), and the memories.

        Raises
        ------
        ShakeError
            If the program refuses the observation.
        """
        rows = np.reshape(observation, (-1, observation.shape[-1]))
        memory = self.begin(len(rows)) if state is None else state[0].copy()
        fresh = None if episode_start is None or state is None else np.reshape(episode_start, -1)
        outputs, codes = self.step(memory, rows, fresh)
        if codes.any():
            raise ShakeError("observation", codes.tolist(), "the program refused it: it is not finite")
        return outputs.reshape(*observation.shape[:-1], 1).astype(np.float32), (memory,)


def build_test(
    folder: str | os.PathLike[str], name: str, flags: Sequence[str] = (), cc: str | None = None
) -> Path:
    """Compile the test program of a written export; return its path."""
    folder = Path(folder)
    target = folder / f"{name}_test"
    sources = [folder / f"{name}.c", folder / f"{name}_test.c"]
    run_compiler([*FLAGS, *flags, "-o", target, *sources, "-lm"], cc)
    return target


def step_times(folder: str | os.PathLike[str], name: str, steps: int = 100_000) -> dict[str, float]:
    """Return median and worst time [us] of so many steps of a written export's program, at most 100 000.

    `worst_us` is by the clock, `worst_processor_us` in processor time.
    """
    folder = Path(folder)
    test = build_test(folder, name)
    done = subprocess.run([str(test), "--time", str(steps)], capture_output=True, text=True, check=True)
    times: dict[str, float] = json.loads(done.stdout)
    return times
