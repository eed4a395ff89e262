"""Units of work: the same results by every engine, done once, however workers end."""

import math
import os
import re
import socket
import sys
import time
import types
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from pathlib import Path

import cloudpickle
import numpy as np
import pytest
import unit_calls
from unit_calls import allocates, dies, divides, noted, refuses, runs, says

from agents import execution
from agents.execution import executor as executor_module
from agents.execution import ray_executor
from agents.execution.encoding import decoded, encoded
from agents.execution.environment import environment, folder_token
from agents.execution.executor import ATTEMPTS
from agents.execution.local_executor import LocalExecutor
from agents.execution.options import ExecutionOptions
from agents.execution.submitit_executor import _parameter
from agents.execution.units import Unit, UnitRunner, plain_identity
from agents.execution.worker import Call, Conditions, pack_calls, perform_calls
from shake_env import SCENARIO_NAMES, make_scenario
from shake_env.errors import FileError, ParameterError, ShakeError

cloudpickle.register_pickle_by_value(unit_calls)  # workers of Ray do not have this folder


@contextmanager
def engine(name, folder, **options):
    if name != "local":
        pytest.importorskip(name, reason=f"{name} is not installed: it is an extra")
    slurm = ("timeout_min=5",) if name == "submitit" else ()
    chosen = ExecutionOptions(executor=name, processes=2, units=folder, slurm=slurm, **options)
    with chosen.open_executor() as executor:
        yield executor


ENGINES = [
    "local",
    pytest.param("ray", marks=pytest.mark.slow),
    pytest.param("submitit", marks=pytest.mark.slow),
]


def test_what_is_encoded_comes_back_as_it_was():
    value = {
        "number": 0.1 + 0.2,
        "none": None,
        "list": [math.inf, True, "text", {"array": np.arange(6.0).reshape(2, 3) / 7.0}],
        "flags": np.array([True, False]),
        "single": np.float32(0.1),
    }
    again = decoded(encoded(value))
    assert again["number"] == value["number"] and again["list"][:3] == value["list"][:3]
    assert again["list"][3]["array"].tobytes() == value["list"][3]["array"].tobytes()
    assert again["flags"].dtype == bool and again["single"] == float(np.float32(0.1))
    assert encoded(value) == encoded(value)
    assert math.isnan(decoded(encoded(math.nan)))
    with pytest.raises(FileError, match="not complete"):
        decoded(encoded(value)[:-40])
    with pytest.raises(TypeError, match="objects"):
        encoded(np.array([object()]))


def test_every_field_of_a_scenario_decides_a_units_name():
    names = {Unit("x", divides, (make_scenario(name),)).key() for name in SCENARIO_NAMES}
    assert len(names) == len(SCENARIO_NAMES)
    one = make_scenario("laboratory")
    other = make_scenario("laboratory", {"delay": one.delay + 1e-12})
    assert Unit("x", divides, (one,)).key() != Unit("x", divides, (other,)).key()
    assert Unit("x", divides, (one,)).key() == Unit("y", divides, (make_scenario("laboratory"),)).key()
    assert Unit("x", divides, (1,)).key() != Unit("x", says, (1,)).key()
    assert Unit("x", divides, (np.zeros(2),)).key() != Unit("x", divides, (np.zeros(3),)).key()
    with pytest.raises(TypeError, match="does not say"):
        plain_identity(object())


@pytest.mark.parametrize("name", ENGINES)
def test_workers_fail_and_are_lost_without_harm_to_other_work(name, tmp_path, monkeypatch):
    lines = []
    monkeypatch.setattr(executor_module.display, "note", lines.append)
    folder = str(tmp_path)
    calls = [
        Call("good", noted, (folder, "good", 1.5)),
        Call("dies once", dies, (folder, "once", 1)),
        Call("dies", dies, (folder, "always", 99)),
        Call("divides", divides, (0,)),
        Call("refuses", refuses),
        Call("says", says, ("a word",)),
        Call("large", allocates, (3.0,)),
        *(Call(f"good {i}", noted, (folder, f"good{i}", i)) for i in range(4)),
    ]
    with engine(name, tmp_path, worker_memory=2.0) as executor:
        outcomes = dict(executor.results(calls))
    assert sorted(outcomes) == list(range(len(calls)))
    assert decoded(outcomes[0].content) == {"value": 1.5, "threads": "1"}
    assert decoded(outcomes[1].content) == "once" and runs(folder, "once") == 2
    assert "lost 3 times" in str(outcomes[2].error) and runs(folder, "always") == ATTEMPTS
    assert "ZeroDivisionError at unit_calls.py" in str(outcomes[3].error)
    assert isinstance(outcomes[4].error, ParameterError) and "mass = -1.0" in str(outcomes[4].error)
    assert "says: a word" in lines
    if sys.platform == "linux":
        assert "--worker-memory" in str(outcomes[6].error)
    assert [decoded(outcomes[i].content)["value"] for i in range(7, 11)] == [0, 1, 2, 3]
    assert runs(folder, "good") == 1 == runs(folder, "good0")


@pytest.mark.parametrize("name", ENGINES)
def test_a_unit_that_is_done_is_done_for_every_engine(name, tmp_path):
    folder, kept = str(tmp_path), tmp_path / "units"
    units = [Unit(f"unit {i}", noted, (folder, f"unit{i}", i)) for i in range(5)]
    UnitRunner(None, kept).run(units[:2])
    shares = []
    with engine(name, kept) as executor:
        runner = UnitRunner(executor, kept)
        values = runner.run(units, lambda index, share: shares.append((index, share)))
        assert [each["value"] for each in values] == list(range(5))
        assert sorted(shares) == [(i, 1.0) for i in range(5)]
        assert runner.run(units) == values
    assert UnitRunner(None, kept).run(units) == values
    assert [runs(folder, f"unit{i}") for i in range(5)] == [1] * 5
    # Half a result is none.
    (file,) = kept.glob(f"{units[3].key()}.npz")
    file.write_bytes(file.read_bytes()[:-30])
    assert UnitRunner(None, kept).run(units)[3]["value"] == 3
    assert [runs(folder, f"unit{i}") for i in range(5)] == [1, 1, 1, 2, 1]
    runner.forget()
    assert list(kept.glob("*.npz")) == []


def test_a_unit_that_fails_ends_the_command_and_what_is_done_stays(tmp_path):
    units = [Unit("good", noted, (str(tmp_path), "good", 1)), Unit("bad", refuses, ())]
    with LocalExecutor(1) as executor:
        with pytest.raises(ParameterError, match="mass"):
            UnitRunner(executor, tmp_path / "units").run(units)
        again = UnitRunner(executor, tmp_path / "units").run(units[:1])
    assert again[0]["value"] == 1 and runs(tmp_path, "good") == 1


def test_a_worker_of_another_version_is_named():
    other = {**environment(), "numpy": "0.1", "code": "0" * 16}
    (outcome,) = perform_calls(pack_calls([Call("x", says, ("x",))], Conditions(other, ".")))
    assert "where 0.1 is needed" in str(outcome.error) and "code" in str(outcome.error)
    assert "constraints.txt" in str(outcome.error)


def test_a_worker_that_lacks_a_calls_module_names_the_versions_or_what_it_lacks(monkeypatch):
    module = types.ModuleType("of_other_code")
    exec("def work(): pass", vars(module))
    with monkeypatch.context() as here:
        here.setitem(sys.modules, module.__name__, module)
        calls = [Call("x", module.work)] * 2
        content = pack_calls(calls, Conditions({**environment(), "code": "0" * 16}, "."))
    outcomes = perform_calls(content)
    assert len(outcomes) == 2 and all("constraints.txt" in str(each.error) for each in outcomes)

    class Broken(LocalExecutor):
        def submit(self, content):
            future = Future()
            future.set_exception(RuntimeError("worker's:\nModuleNotFoundError: No module 'agents'\nbye"))
            return future

    with Broken(1) as executor:
        outcomes = dict(executor.results([Call("x", says, ("x",)), Call("y", says, ("y",))]))
    for index, name in enumerate("xy"):
        assert re.search(rf"'{name}'.*No module 'agents'\).*constraints", str(outcomes[index].error))


def test_a_log_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    call = Call("x", says, ("x",), log=tmp_path / "file" / "x.log")
    (outcome,) = perform_calls(pack_calls([call], Conditions(environment(), ".")))
    assert isinstance(outcome.error, FileError) and str(tmp_path / "file") in str(outcome.error)


def test_a_folder_that_a_worker_does_not_share_is_named(tmp_path):
    token = folder_token(tmp_path)
    assert folder_token(tmp_path) == token
    conditions = Conditions(environment(), ".")
    good = Call("x", says, ("x",), folder=(tmp_path, token), needs_folder=True)
    assert perform_calls(pack_calls([good], conditions))[0].error is None
    (tmp_path / "elsewhere").mkdir()
    for folder in (tmp_path / "elsewhere", tmp_path / "nowhere"):
        call = Call("x", says, ("x",), folder=(folder, token), needs_folder=True)
        assert "all machines share" in str(perform_calls(pack_calls([call], conditions))[0].error)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"processes": 0}, "processes = 0"),
        ({"worker_memory": 0.0}, "worker-memory = 0.0"),
        ({"worker_memory": math.inf}, "worker-memory = inf: .*at most 100000 GiB"),
        ({"ray_address": "auto"}, "goes with --executor ray"),
        ({"executor": "ray", "slurm": ("a=b",)}, "goes with --executor submitit"),
    ],
)
def test_options_that_contradict_each_other_are_named(options, named):
    with pytest.raises(ParameterError, match=named):
        ExecutionOptions(**options)


def test_a_folder_of_units_that_cannot_be_one_is_refused_before_the_work(tmp_path):
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(FileError, match="file"),
        ExecutionOptions(processes=2, units=tmp_path / "file").open_runner(),
    ):
        pass


@pytest.mark.slow
def test_a_folder_that_submitit_cannot_have_is_named(tmp_path):
    pytest.importorskip("submitit", reason="submitit is not installed: it is an extra")
    (tmp_path / "units").mkdir()
    (tmp_path / f"units/submitit-{socket.gethostname()}-{os.getpid()}").write_text("")
    options = ExecutionOptions(executor="submitit", units=tmp_path / "units")
    with pytest.raises(FileError, match=r"submitit-.*is a file"), options.open_executor():
        pass


def test_workers_are_as_many_as_a_command_usually_has(tmp_path):
    with ExecutionOptions(units=tmp_path).open_runner() as runner:
        assert runner.executor is None
    with ExecutionOptions(units=tmp_path).open_runner(usual=2) as runner:
        assert isinstance(runner.executor, LocalExecutor)
    with ExecutionOptions(units=tmp_path, processes=1).open_runner(usual=2) as runner:
        assert runner.executor is None


@pytest.mark.parametrize("text", ["timeout_min=abc", "timeout_min=-5", "slurm_timeout_min=0", "alone"])
def test_parameters_of_jobs_that_have_no_meaning_are_refused(text):
    with pytest.raises(ParameterError, match="slurm"):
        _parameter(text)


def test_an_address_without_a_cluster_is_named_in_time(monkeypatch):
    monkeypatch.setattr(ray_executor, "ANSWER", 0.2)
    with socket.socket() as mute:
        mute.bind(("127.0.0.1", 0))
        port = mute.getsockname()[1]
        with pytest.raises(ParameterError, match=f"{port}.*refused.*ray start --head"):
            ray_executor.require_answer(f"127.0.0.1:{port}")
        mute.listen(4)  # the system accepts, and nobody reads
        for address in (f"127.0.0.1:{port}", f"ray://localhost:{port}"):
            began = time.monotonic()
            with pytest.raises(ParameterError, match=f"{port}.*no answer in 0.2 s"):
                ray_executor.require_answer(address)
            assert time.monotonic() - began < 5.0
    for address in ("somewhere", ":6379", "host:port"):
        with pytest.raises(ParameterError, match="HOST:6379"):
            ray_executor.require_answer(address)


def test_an_address_where_grpc_answers_is_asked_no_more():
    grpc = pytest.importorskip("grpc", reason="grpcio is not installed: TensorBoard brings it")
    server = grpc.server(ThreadPoolExecutor(1))
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    ray_executor.require_answer(f"127.0.0.1:{port}")
    server.stop(None).wait()


@pytest.mark.slow
def test_the_executor_asks_before_ray_does(tmp_path):
    pytest.importorskip("ray", reason="ray is not installed: it is an extra")
    options = ExecutionOptions(executor="ray", ray_address="127.0.0.1:9", units=tmp_path / "units")
    began = time.monotonic()
    with pytest.raises(ParameterError, match="ray-address"), options.open_executor():
        pass
    assert time.monotonic() - began < 30.0  # the import of Ray
    assert list(tmp_path.iterdir()) == []


def test_a_command_that_is_refused_leaves_no_folder_of_units(tmp_path):
    options = ExecutionOptions(processes=2, units=tmp_path / "units")
    with pytest.raises(ParameterError, match="storage"), options.open_executor():
        raise ParameterError("storage", "a.db", "is a file of this machine")
    assert list(tmp_path.iterdir()) == []


def test_refused_parameters_of_jobs_leave_no_folder(tmp_path):
    for text in ("alone", "timeout_min=0"):
        with pytest.raises(ParameterError, match="slurm"):
            ExecutionOptions(executor="submitit", units=tmp_path / "units", slurm=(text,))
    pytest.importorskip("submitit", reason="submitit is not installed: it is an extra")
    for text in ("slurm_nothing=1", "nothing=1", "other_time=3", "nodes=many"):
        with pytest.raises(ParameterError, match="not understood"):
            ExecutionOptions(executor="submitit", units=tmp_path / "units", slurm=(text,))
    assert list(tmp_path.iterdir()) == []


def test_a_stated_memory_bounds_a_single_process_too(tmp_path):
    units = [Unit("large", allocates, (3.0,))]
    with ExecutionOptions(units=tmp_path).open_runner() as runner:
        assert runner.executor is None
    with (
        ExecutionOptions(units=tmp_path, worker_memory=2.0).open_runner() as runner,
        pytest.raises(ShakeError, match="--worker-memory") if sys.platform == "linux" else nullcontext(),
    ):
        assert isinstance(runner.executor, LocalExecutor) and runner.executor.workers == 1
        runner.run(units)


def test_calls_are_taken_one_by_one_as_there_is_room():
    begun, ended = [], []

    def calls():
        for number in range(4):
            begun.append(number)
            yield Call(f"{number}", divides, (number + 1,))
            if number == 1:  # nothing at present, until those at work have ended
                while len(ended) < 2:
                    yield None

    with LocalExecutor(1) as executor:
        for index, outcome in executor.results(calls()):
            ended.append(index)
            assert decoded(outcome.content) == 1 / (index + 1)
            assert len(begun) <= len(ended) + 1
    assert ended == begun == [0, 1, 2, 3]


def test_nothing_but_the_options_knows_an_engine():
    engine = re.compile(
        r"^ *(from|import) (ray|submitit|agents\.execution\.\w+_executor)\b", re.MULTILINE
    )
    root = Path(execution.__file__).parents[1]
    files = [file for file in root.rglob("*.py") if engine.search(file.read_text(encoding="utf-8"))]
    own = {"options.py", "ray_executor.py", "submitit_executor.py"}
    assert {file.name for file in files} == own and {file.parent.name for file in files} == {"execution"}
