"""Ctrl-C while workers work: one line, no traceback, no process left."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

HELPERS = str(Path(__file__).parents[2] / "helpers")
SCRIPT = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[3])
import cloudpickle, unit_calls
from agents.execution.options import ExecutionOptions
from agents.execution.units import Unit, UnitRunner
cloudpickle.register_pickle_by_value(unit_calls)
engine, folder = sys.argv[1:3]
slurm = ("timeout_min=5",) if engine == "submitit" else ()
options = ExecutionOptions(executor=engine, processes=2, units=Path(folder) / "units", slurm=slurm)
units = [Unit(f"unit{i}", unit_calls.begins_and_ends, (folder, f"unit{i}", 300.0)) for i in range(2)]
if __name__ == "__main__":
    try:
        with options.open_executor() as executor:
            UnitRunner(executor, options.folder).run(units)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
"""


@pytest.mark.parametrize(
    "engine",
    [
        "local",
        pytest.param("ray", marks=pytest.mark.slow),
        pytest.param("submitit", marks=pytest.mark.slow),
    ],
)
def test_an_interruption_ends_every_worker_without_a_traceback(engine, tmp_path):
    if engine != "local":
        pytest.importorskip(engine, reason=f"{engine} is not installed: it is an extra")
    (tmp_path / "script.py").write_text(SCRIPT)
    words = [sys.executable, str(tmp_path / "script.py"), engine, str(tmp_path), HELPERS]
    # A session of its own: as on a terminal, every process of it gets the signal.
    command = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, start_new_session=True)
    notes = [tmp_path / "unit0", tmp_path / "unit1"]
    end = time.monotonic() + 120.0
    while not all(note.exists() for note in notes) and time.monotonic() < end:
        time.sleep(0.1)
    workers = [int(note.read_text()) for note in notes]
    os.killpg(command.pid, signal.SIGINT)
    try:
        _, said = command.communicate(timeout=120)
    finally:
        if command.poll() is None:  # it must not outlive the test, nor its pipe
            os.killpg(command.pid, signal.SIGKILL)
            command.communicate()
    assert said.splitlines() == ["interrupted"]
    end = time.monotonic() + 30.0
    while any(map(alive, workers)) and time.monotonic() < end:
        time.sleep(0.1)
    assert not any(map(alive, workers))


def alive(process):
    with contextlib.suppress(ProcessLookupError):
        os.kill(process, 0)
        state = Path(f"/proc/{process}/stat")
        return not (state.exists() and state.read_text().rpartition(")")[2].split()[0] == "Z")
    return False
