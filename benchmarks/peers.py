"""gymnax's CartPole on the same cores, from an environment of its own that is made when asked for."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.environments import STEPS, STORIES, shake_vector, vector

FOLDER = Path(".venv-peers")
PACKAGES = ("jax[cpu]", "gymnax", "six")  # gymnax imports six and does not say that it needs it
TABLES = (256, 1024)
SERVER = Path(__file__).with_name("gymnax_server.py")
# One thread, as everything here is measured with; CPU time would add up threads anyway.
ONE_THREAD = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"


def environment(folder: Path) -> str:
    """Return the python of the peers' environment, made by pip if there is none.

    Raises
    ------
    OSError, CalledProcessError
        If it cannot be made, or what is installed cannot be imported.
    """
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True, capture_output=True)
    probe = [str(python), "-c", "import gymnax"]
    if subprocess.run(probe, capture_output=True).returncode:
        install = [str(python), "-m", "pip", "install", "--quiet", *PACKAGES]
        subprocess.run(install, check=True, capture_output=True, text=True)
        subprocess.run(probe, check=True, capture_output=True, text=True)
    return str(python)


def peers(spell: float, spells: int, folder: Path = FOLDER) -> dict[str, Any]:
    """Return table-steps a second beside gymnax at 256 and 1024 tables; why not, where that is so."""
    try:
        python = environment(folder)
    except (OSError, subprocess.CalledProcessError) as error:
        lines = (getattr(error, "stderr", None) or str(error)).strip().splitlines()
        return {"unavailable": lines[-1] if lines else str(error)}
    server = subprocess.Popen(
        [python, str(SERVER)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "XLA_FLAGS": ONE_THREAD, "JAX_PLATFORMS": "cpu"},
    )
    with server:
        assert server.stdin is not None and server.stdout is not None
        try:
            return {f"{tables} tables": _rates(server, tables, spell, spells) for tables in TABLES}
        except (OSError, ValueError) as error:  # it broke off: its own words are on standard error
            return {"unavailable": f"its process ended early ({error})"}
        finally:
            server.stdin.close()


def _rates(server: Any, tables: int, spell: float, spells: int) -> dict[str, float]:
    still = np.zeros((tables, 1), dtype=np.float32)
    calls = {
        name: vector(shake_vector(tables, scenario, **options), still)
        for name, scenario, options in (
            ("linear", "linear", {"stories": STORIES}),
            ("laboratory", "laboratory", {}),
        )
    }

    def seconds(name: str, number: int) -> float:
        """Return the CPU seconds of so many calls, in whichever process they run."""
        if name in calls:
            begin = time.process_time()
            for _ in range(number):
                calls[name]()
            return time.process_time() - begin
        server.stdin.write(f"{name.split()[-1]} {tables} {number}\n")
        server.stdin.flush()
        return float(server.stdout.readline())

    names = [*calls, "gymnax CartPole-v1, stepped", "gymnax CartPole-v1, scanned"]
    numbers = {}
    for name in names:
        seconds(name, 1)
        numbers[name] = max(1, round(spell / max(seconds(name, 1), 1e-7)))
    taken: dict[str, list[float]] = {name: [] for name in names}
    for _ in range(spells):
        for name in names:
            taken[name].append(seconds(name, numbers[name]) / numbers[name])
    return {name: tables * STEPS / statistics.median(times) for name, times in taken.items()}
