"""What importing costs, in a process of its own, and what a wide batch keeps in memory."""

from __future__ import annotations

import statistics
import subprocess
import sys

IMPORT = """
import time
import gymnasium, scipy.signal
begin = time.process_time()
import shake_env
print(time.process_time() - begin)
import sys
print("torch" in sys.modules, "numba" in sys.modules)
"""

MEMORY = """
import pathlib, re, resource
import numpy as np
from shake_env import make_scenario
from shake_env.simulation.simulation import Simulation
scenario = make_scenario("laboratory", {"duration": 60.0})
simulation = Simulation(scenario, 4096)
simulation.start(range(4096), [np.random.default_rng(i) for i in range(4096)])
for _ in range(150):
    simulation.step(np.zeros(4096))
# What getrusage tells outlives exec: a process begins with the peak of the one that started it.
status = pathlib.Path("/proc/self/status")
peak = re.search(r"VmHWM:\\s+(\\d+) kB", status.read_text()) if status.exists() else None
kilobytes = int(peak[1]) if peak else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(kilobytes / 2**20)
"""


def _run(script: str) -> list[str]:
    command = [sys.executable, "-c", script]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()


def footprint(repeats: int) -> dict[str, float | bool]:
    """Return CPU seconds of the import beyond gymnasium and scipy.signal, and GiB of 4096 tables."""
    runs = [_run(IMPORT) for _ in range(repeats)]
    return {
        "import [s]": statistics.median(float(run[0]) for run in runs),
        "torch imported": any(run[1] == "True" for run in runs),
        "numba imported": any(run[2] == "True" for run in runs),
        "4096 tables, 60 s motions [GiB]": float(_run(MEMORY)[0]),
    }
