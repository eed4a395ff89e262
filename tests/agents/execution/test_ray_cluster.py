"""A cluster of Ray on this machine, a head and two nodes: workers, a node and the driver are killed."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from unit_calls import begins_and_ends, runs

from agents.execution.units import Unit

ray = pytest.importorskip("ray", reason="ray is not installed: it is an extra")
pytestmark = pytest.mark.slow

UNITS = 16
DRIVER = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[3])
import cloudpickle, unit_calls
from agents.execution.options import ExecutionOptions
from agents.execution.units import Unit, UnitRunner
cloudpickle.register_pickle_by_value(unit_calls)
address, folder, number = sys.argv[1], sys.argv[2], int(sys.argv[4])
options = ExecutionOptions(
    executor="ray", ray_address=address, units=Path(folder) / "units", worker_memory=1.0
)
units = [
    Unit(f"unit{i}", unit_calls.begins_and_ends, (folder, f"unit{i}", 2.0)) for i in range(number)
]
if __name__ == "__main__":
    with options.open_executor() as executor:
        values = UnitRunner(executor, options.folder).run(units)
    assert values == [f"unit{i}" for i in range(number)]
"""


@pytest.fixture
def cluster():
    from ray.cluster_utils import Cluster

    Path(tempfile.gettempdir(), "ray").mkdir(exist_ok=True)  # where Ray notes the cluster's address
    small = {"object_store_memory": 100 * 2**20, "memory": 4 * 2**30}
    with tempfile.TemporaryDirectory(dir="/tmp") as short:  # a socket's path is at most 107 long
        head = {"num_cpus": 0, "temp_dir": short, **small}
        made = Cluster(initialize_head=True, head_node_args=head)
        made.workers = [made.add_node(num_cpus=1, **small) for _ in range(2)]
        yield made
        made.shutdown()


def wait_until(condition, process, seconds=240.0):
    end = time.monotonic() + seconds
    while not condition():
        if process.poll() is not None:
            pytest.fail(f"the driver ended: {process.stderr.read()}")
        assert time.monotonic() < end
        time.sleep(0.05)


def test_killed_workers_node_and_driver_lose_no_unit_and_repeat_none_that_is_done(cluster, tmp_path):
    script = tmp_path / "driver.py"
    script.write_text(DRIVER)
    helpers = str(Path(__file__).parents[2] / "helpers")

    def start():
        return subprocess.Popen(
            [sys.executable, str(script), cluster.address, str(tmp_path), helpers, str(UNITS)],
            stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    results = [
        tmp_path / "units" / f"{Unit(name, begins_and_ends, (str(tmp_path), name, 2.0)).key()}.npz"
        for name in (f"unit{i}" for i in range(UNITS))
    ]

    def done():
        return sum(file.is_file() for file in results)

    def done_runs():
        """Runs of each unit that has a result."""
        return {i: runs(tmp_path, f"unit{i}") for i, file in enumerate(results) if file.is_file()}

    def counts():
        return [runs(tmp_path, f"unit{i}") for i in range(UNITS)]

    def pids(number):
        return [int(pid) for pid in (tmp_path / f"unit{number}").read_text().split()]

    driver = start()
    # A worker process, in the middle of a unit.
    wait_until(lambda: done() >= 2 and sum(counts()) > done(), driver)
    running = max(i for i, count in enumerate(counts()) if count)
    at_kills = [done_runs()]
    os.kill(pids(running)[-1], signal.SIGKILL)
    wait_until(lambda: done() >= 5, driver)
    # The driver.
    driver.kill()
    driver.communicate()
    time.sleep(1.0)
    at_kills.append(done_runs())
    before = len(at_kills[-1])
    assert 5 <= before < UNITS
    driver = start()
    wait_until(lambda: done() >= before + 2, driver)
    # A node.
    at_kills.append(done_runs())
    cluster.remove_node(cluster.workers[0], allow_graceful=False)
    _, said = driver.communicate(timeout=400)
    assert driver.returncode == 0, said
    assert done() == UNITS
    after = counts()
    assert min(after) >= 1
    # What had a result when something was killed never ran again.
    for done_then in at_kills:
        assert done_then == {i: after[i] for i in done_then}
    # What was at work did: at most the unit of the worker, two of the driver and one of the node.
    assert UNITS < sum(after) <= UNITS + 4
