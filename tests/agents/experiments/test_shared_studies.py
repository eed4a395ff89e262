"""Several processes on one study: no trial lost or doubled, a killed one's tried again."""

import errno
import getpass
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from agents.experiments import signs_of_life
from agents.experiments.study_storage import (
    is_shared,
    open_study,
    storage_errors,
    without_password,
)
from shake_env.errors import ParameterError

WORK = """
import sys, time
from agents.experiments import signs_of_life
from agents.experiments.parameter_search import search_parameters
from baselines.baseline import Tunable

signs_of_life.HEARTBEAT, signs_of_life.GRACE = 1, 4
storage, total, seconds, note = sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), sys.argv[4]

def cost(values):
    print(values["x"], file=open(note, "a"), flush=True)
    time.sleep(seconds)
    return (values["x"] - 1.0) ** 2

def told(done, total, best):
    print(done, flush=True)

if __name__ == "__main__":
    x = Tunable(0.0, 10.0, 5.0, logarithmic=False)
    starts = [{"x": 5.0}, {"x": 1.0}]
    found = search_parameters(cost, {"x": x}, storage, "study", total, 0, told, starts)
    assert found.default_cost == 16.0 and found.cost == 0.0
"""


@pytest.fixture(scope="module")
def postgresql():
    """The URL of a server that is started for the test."""
    pytest.importorskip("pg8000", reason="pg8000, the driver, is not installed")
    programs = [shutil.which(name) for name in ("initdb", "postgres")]
    if None in programs:
        # The server is the system's, not a Python package: most machines have none.
        pytest.skip("PostgreSQL's initdb and postgres are not on the path")
    # It does not run as root.
    user = {"user": "postgres"} if os.geteuid() == 0 else {}
    with tempfile.TemporaryDirectory(dir="/tmp") as name:
        if user:
            try:
                shutil.chown(name, "postgres")
            except LookupError:
                # Debian's package makes this user; another installation need not.
                pytest.skip("PostgreSQL does not run as root, and there is no user postgres")
        data, me = f"{name}/data", "postgres" if user else getpass.getuser()
        made = subprocess.run(
            [programs[0], "-D", data, "-A", "trust", "-U", me], capture_output=True, text=True, **user
        )
        if made.returncode:
            # A container without locales or shared memory: the server itself cannot be made here.
            pytest.skip(f"initdb fails here: {made.stderr}")
        port = free_port()
        options = ["-D", data, "-p", str(port), "-k", name, "-h", "127.0.0.1", "-c", "fsync=off"]
        server = subprocess.Popen(
            [programs[1], *options], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **user
        )
        for _ in range(300):
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.1)
        time.sleep(1.0)
        yield f"postgresql+pg8000://{me}@127.0.0.1:{port}/postgres"
        server.send_signal(signal.SIGINT)
        server.wait(timeout=60)


PROXY = """
import sys
from optuna.storages import get_storage, run_grpc_proxy_server
run_grpc_proxy_server(get_storage(sys.argv[1]), host="127.0.0.1", port=int(sys.argv[2]))
"""


@pytest.fixture
def grpc(tmp_path):
    """The URL of a proxy, a process of its own on the loopback, before a database."""
    pytest.importorskip("grpc", reason="grpcio is not installed: TensorBoard brings it")
    port = free_port()
    server = subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", PROXY, f"sqlite:///{tmp_path}/behind.db", str(port)],
        stderr=subprocess.PIPE,
        text=True,
    )
    yield f"grpc://127.0.0.1:{port}"  # who opens it waits until it answers
    assert server.poll() is None, server.stderr.read()
    server.terminate()
    server.communicate(timeout=60)


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@pytest.fixture(params=["journal", "postgresql", "grpc"])
def storage(request, tmp_path):
    if request.param == "journal":
        return f"journal:{tmp_path / 'study.journal'}"
    return request.getfixturevalue(request.param)


def begin(folder, storage, total, seconds):
    script, note = folder / "work.py", folder / "values"
    script.write_text(WORK)
    arguments = [sys.executable, str(script), storage, str(total), str(seconds), str(note)]
    return subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True, stdout=subprocess.DEVNULL)


def values(folder):
    file = folder / "values"
    return file.read_text().split() if file.exists() else []


@pytest.mark.slow
def test_two_processes_share_a_study(storage, tmp_path):
    total = 16
    both = [begin(tmp_path, storage, total, 0.2) for _ in range(2)]
    for process in both:
        _, said = process.communicate(timeout=300)
        assert process.returncode == 0, said
    study, made = open_study(storage, "study")
    trials = study.get_trials(deepcopy=False)
    assert not made and {t.state.name for t in trials} == {"COMPLETE"}
    assert total <= len(trials) <= total + 1  # both may find the last one lacking
    assert [t.number for t in trials] == list(range(len(trials)))
    tried = values(tmp_path)
    assert sorted(map(float, tried)) == sorted(t.params["x"] for t in trials)  # none lost, none twice
    assert len(set(tried)) == len(tried)
    assert study.best_value == 0.0 and study.best_params == {"x": 1.0}


@pytest.mark.slow
def test_a_killed_processs_trial_is_tried_again(storage, tmp_path):
    folder = tmp_path
    starts = begin(folder, storage, 2, 0.1)  # what a search begins with
    _, said = starts.communicate(timeout=300)
    assert starts.returncode == 0, said
    study, _ = open_study(storage, "study")
    before, noted = len(study.get_trials(deepcopy=False)), len(values(folder))
    first = begin(folder, storage, before + 3, 600.0)
    end = time.monotonic() + 120.0
    while len(values(folder)) == noted and time.monotonic() < end:
        time.sleep(0.1)
    first.kill()
    first.communicate()
    (lost,) = values(folder)[noted:]
    second = begin(folder, storage, before + 3, 0.1)
    _, said = second.communicate(timeout=300)
    assert second.returncode == 0, said
    trials = study.get_trials(deepcopy=False)
    again = [t for t in trials if t.params.get("x") == float(lost)]
    assert [t.state.name for t in again] == ["FAIL", "COMPLETE"]
    assert sum(t.state.name == "COMPLETE" for t in trials) >= before + 3
    assert not any(t.state.name in ("RUNNING", "WAITING") for t in trials)


ONE_FILE = """
import sys, time
from pathlib import Path
from agents.experiments.parameter_search import search_parameters
from agents.experiments.study_storage import storage_errors
from baselines.baseline import Tunable

storage, name, total = sys.argv[1], sys.argv[2], int(sys.argv[3])
print("ready", flush=True)
while not Path(storage + ".go").exists():
    time.sleep(0.001)
with storage_errors(storage):
    x = Tunable(0.0, 10.0, 5.0, logarithmic=False)
    search_parameters(lambda values: (values["x"] - 1.0) ** 2, {"x": x}, storage, name, total, 0,
                      lambda *told: None, [{"x": 5.0}, {"x": 1.0}])
"""


@pytest.mark.slow
def test_processes_with_a_study_each_begin_one_sqlite_file_at_once(tmp_path):
    file, total = tmp_path / "all.db", 15
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", ONE_FILE, str(file), f"study{i}", str(total)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )
        for i in range(4)
    ]  # fmt: skip
    for process in processes:
        assert process.stdout.readline() == "ready\n"
    (tmp_path / "all.db.go").touch()
    for process in processes:
        _, said = process.communicate(timeout=300)
        assert process.returncode == 0, said
    for i in range(4):
        study, made = open_study(file, f"study{i}")
        trials = study.get_trials(deepcopy=False)
        assert not made and [t.state.name for t in trials] == ["COMPLETE"] * total


def test_a_trial_without_a_sign_of_life_is_queued_again_and_one_with_it_is_not(tmp_path, monkeypatch):
    monkeypatch.setattr(signs_of_life, "HEARTBEAT", 0.1)
    monkeypatch.setattr(signs_of_life, "GRACE", 0.8)
    storage = f"journal:{tmp_path / 'study.journal'}"
    with storage_errors(storage):
        study, _ = open_study(storage, "study")
        lost, alive = study.ask(), study.ask()
        lost.suggest_float("x", 0.0, 1.0)
        with signs_of_life.sign_of_life(study, lost):
            pass  # as if its process ended here
        other, _ = open_study(storage, "study")
        with signs_of_life.sign_of_life(study, alive):
            end = time.monotonic() + 2.0
            while time.monotonic() < end:
                signs_of_life.retry_lost_trials(other)
                time.sleep(0.05)
        states = [trial.state.name for trial in other.get_trials()]
        assert states == ["FAIL", "RUNNING", "WAITING"]
        assert other.get_trials()[2].params == lost.params
        other.tell(alive.number, 0.0)
        # Lost again and again, it is given up.
        for _ in range(signs_of_life.RETRIES):
            again = other.ask()
            assert again.params == lost.params
            end = time.monotonic() + 1.5
            while time.monotonic() < end:
                signs_of_life.retry_lost_trials(other)
                time.sleep(0.05)
        states = [trial.state.name for trial in other.get_trials()]
        assert "WAITING" not in states and states.count("FAIL") >= 1 + signs_of_life.RETRIES


def test_a_trial_that_was_lost_before_its_first_heartbeat_is_queued_again(tmp_path, monkeypatch):
    monkeypatch.setattr(signs_of_life, "HEARTBEAT", 1)
    monkeypatch.setattr(signs_of_life, "GRACE", 2)
    storage = f"sqlite:///{tmp_path / 'study.db'}"  # a URL: shared, with heartbeats
    with storage_errors(storage):
        study, _ = open_study(storage, "study")
        study.ask()  # and its process ends here
        with signs_of_life.sign_of_life(study, study.ask()):
            end = time.monotonic() + 3.5
            while time.monotonic() < end:
                signs_of_life.retry_lost_trials(study)
                time.sleep(0.1)
        assert [trial.state.name for trial in study.get_trials()] == ["FAIL", "RUNNING", "WAITING"]


def test_storages_are_told_apart_and_keep_their_password():
    assert is_shared("postgresql://h/d") and is_shared("journal:x.log") and is_shared("grpc://h:1")
    assert not is_shared(Path("runs/tune.db")) and not is_shared("C:/tune.db")
    assert "secret" not in without_password("mysql+pymysql://me:secret@host/name")
    assert without_password("journal:x.log") == "journal:x.log"


@pytest.mark.parametrize("filename", [None, "study.journal.lock"])
def test_a_journal_that_cannot_be_written_is_named(filename):
    full = OSError(errno.ENOSPC, "No space left on device", filename)
    with (
        pytest.raises(ParameterError, match=r"study.journal'.*\(No space left.*free some space"),
        storage_errors("journal:study.journal"),
    ):
        raise full
    for storage, error in (
        ("journal:study.journal", OSError(errno.ENOSPC, "No space left on device", "another")),
        ("journal:study.journal", BrokenPipeError(errno.EPIPE, "Broken pipe")),
        ("study.db", full),
    ):
        with pytest.raises(OSError, match=error.strerror), storage_errors(storage):
            raise error


@pytest.mark.parametrize(
    ("storage", "words"),
    [
        ("grpc://nowhere", "grpc://HOST:PORT"),
        ("nothing://me:secret@host/x", "driver installed"),
        ("postgresql+pg8000://me:secret@127.0.0.1:9/x", "server reachable"),
    ],
)
def test_a_storage_that_cannot_be_used_is_named_without_its_password(storage, words):
    with pytest.raises(ParameterError, match=words) as raised:
        open_study(storage, "x")
    assert "secret" not in str(raised.value)
