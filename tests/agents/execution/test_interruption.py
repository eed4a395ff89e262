"""Ctrl-C while workers work: one line, no traceback, no process left."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from unit_calls import runs

HELPERS = str(Path(__file__).parents[2] / "helpers")
SCRIPT = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[3])
import cloudpickle, unit_calls
from agents.execution.options import ExecutionOptions
from agents.execution.units import Unit, UnitRunner
cloudpickle.register_pickle_by_value(unit_calls)
if __name__ == "__mp_main__" and sys.argv[4:]:
    unit_calls.begins_and_ends(sys.argv[2], "begins", 3.0)
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
    interrupted(tmp_path, engine, lambda: runs(tmp_path, "unit0") + runs(tmp_path, "unit1") == 2)
    workers = [int((tmp_path / name).read_text()) for name in ("unit0", "unit1")]
    end = time.monotonic() + 30.0
    while any(map(alive, workers)) and time.monotonic() < end:
        time.sleep(0.1)
    assert not any(map(alive, workers))


def test_an_interruption_while_processes_begin_leaves_no_traceback(tmp_path):
    interrupted(tmp_path, "local", lambda: runs(tmp_path, "begins") == 2, "slowly")
    assert not (tmp_path / "unit0").exists()


def interrupted(folder, engine, ready, *more):
    """Begin the script, interrupt it when it is ready, and check what it says."""
    (folder / "script.py").write_text(SCRIPT)
    words = [sys.executable, str(folder / "script.py"), engine, str(folder), HELPERS, *more]
    # A session of its own: as on a terminal, every process of it gets the signal.
    command = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, start_new_session=True)
    end = time.monotonic() + 120.0
    while not ready() and time.monotonic() < end:
        time.sleep(0.1)
    os.killpg(command.pid, signal.SIGINT)
    try:
        _, said = command.communicate(timeout=120)
    finally:
        if command.poll() is None:  # it must not outlive the test, nor its pipe
            os.killpg(command.pid, signal.SIGKILL)
            command.communicate()
    assert said.splitlines() == ["interrupted"]


def alive(process):
    with contextlib.suppress(ProcessLookupError):
        os.kill(process, 0)
        state = Path(f"/proc/{process}/stat")
        return not (state.exists() and state.read_text().rpartition(")")[2].split()[0] == "Z")
    return False
