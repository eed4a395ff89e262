"""Run directories and result files: nothing half written, damage named, one process at a time."""

import errno
import json
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from agents.evaluation import benchmark as bench
from agents.evaluation import result_files
from agents.policies.policy_file import load_policy
from agents.reporting.markdown_blocks import put_block
from agents.run_directory import (
    BEST,
    CONFIG,
    EVALUATIONS,
    POLICY,
    append_row,
    create_run_directory,
    evaluations_of_run,
    folder_contents,
    locked_folder,
    parse_json,
    policy_of_run,
    read_json,
    read_rows,
)
from agents.training.config import TrainConfig, read_config
from baselines.tuned_values import read_tuned
from shake_env.errors import FileError, RunDirectoryError, ShakeError
from shake_env.files import replacing, write_json
from shake_env.scenario.scenario_file import read_scenario


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path):
    file = tmp_path / "folder" / "a.json"
    write_json(file, {"a": 1})
    with pytest.raises(ZeroDivisionError), replacing(file) as partial:
        partial.write_text('{"a": 2')
        raise ZeroDivisionError
    assert json.loads(file.read_text()) == {"a": 1}
    assert [f.name for f in file.parent.iterdir()] == ["a.json"]


def test_a_folder_that_turns_read_only_names_the_file_itself(tmp_path, monkeypatch):
    def refuses(path, *arguments, **options):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    monkeypatch.setattr(Path, "write_bytes", refuses)
    monkeypatch.setattr(Path, "unlink", refuses)
    with pytest.raises(FileError, match=r"/a\.json'.*read-only"):
        write_json(tmp_path / "a.json", {})


@pytest.mark.parametrize(
    ("number", "remedy"),
    [(errno.ENOSPC, "disk is full"), (errno.EROFS, "read-only"), (errno.EACCES, "no permission")],
)
def test_an_error_of_the_operating_system_names_file_and_remedy(tmp_path, monkeypatch, number, remedy):
    def fails(descriptor):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", fails)
    with pytest.raises(FileError, match=rf"a\.json.*{remedy}"):
        write_json(tmp_path / "a.json", {})
    assert folder_contents(tmp_path) == []
    with pytest.raises(FileError, match=rf"rows\.jsonl.*{remedy}"):
        append_row(tmp_path / "rows.jsonl", {})


def test_what_is_written_names_the_file_and_never_replaces_a_device(tmp_path):
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "folder", tmp_path / "pipe"):
        with pytest.raises(FileError, match=rf"{path.name}.*a folder, a pipe or a device"):
            write_json(path, {})
    (tmp_path / "closed").symlink_to(tmp_path / "a.json")
    write_json(tmp_path / "closed", {})  # the file that a link leads to
    assert (tmp_path / "closed").is_symlink() and (tmp_path / "a.json").is_file()
    with pytest.raises(FileError, match=rf"{tmp_path}/a.json.*where a folder is needed"):
        write_json(tmp_path / "a.json" / "b", {})
    with pytest.raises(FileError, match=r"name longer|too long") as refusal:
        write_json(tmp_path / ("a" * 300), {})
    assert "partial" not in str(refusal.value)


@pytest.mark.skipif(not hasattr(resource, "RLIMIT_FSIZE"), reason="no limit on files here")
def test_every_writer_names_the_file_when_it_may_not_grow(tmp_path):
    """A limit on the size of files, in a process of its own, fails a write as a full disk does."""
    code = f"""
import resource
from agents.figure_style import new_figure, save_figure
from agents.reporting.csv_file import write_csv
from agents.training.event_log import event_log
from pathlib import Path
from shake_env.errors import FileError
from shake_env.records import load_record, write_record

folder = Path({str(tmp_path)!r})
record = load_record("napa2014_68150_hne")
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))


def events():
    with event_log(folder / "events") as logger:
        for step in range(100):
            logger.record("value", 1.0)
            logger.dump(step)


for name, write in {{
    "figure.png": lambda: save_figure(new_figure(3, 3), folder, "figure"),
    "rows.csv": lambda: write_csv(folder / "rows.csv", ["a"], [{{"a": 1.5}}] * 1000),
    "record.csv": lambda: write_record(record, folder / "record.csv"),
    "events": events,
}}.items():
    try:
        write()
    except FileError as error:
        assert name in str(error) and "ulimit" in str(error) and "partial" not in str(error), error
        print(name)
"""
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert out.stderr == ""
    assert out.stdout.split() == ["figure.png", "rows.csv", "record.csv", "events"]
    assert [each.name for each in tmp_path.iterdir()] == ["events"]


def test_a_run_directory_that_cannot_be_made_is_named_as_it_was_given(tmp_path, monkeypatch):
    def refused(path, *_, **__):
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    (tmp_path / "runs").mkdir()
    made = Path.mkdir
    monkeypatch.setattr(
        Path, "mkdir", lambda self, *a, **k: (refused if "partial" in self.name else made)(self, *a, **k)
    )
    with pytest.raises(FileError) as caught:
        create_run_directory(tmp_path / "runs" / "mine", lambda folder: None)
    assert caught.value.value == str(tmp_path / "runs" / "mine")


def test_a_folder_that_is_a_file_is_named(tmp_path):
    (tmp_path / "a").write_text("")
    with pytest.raises(FileError, match=r"/a"), locked_folder(tmp_path / "a"):
        pass


@pytest.mark.parametrize("cut", range(1, 40, 3))
def test_half_a_line_is_dropped_and_never_joined_with_the_next(tmp_path, cut):
    file = tmp_path / EVALUATIONS
    for steps in (0, 512):
        append_row(file, {"steps": steps, "cost_ratio": 242.11})
    whole = file.read_bytes()
    file.write_bytes(whole[:-cut])
    rows = read_rows(file)
    assert (
        rows
        == [{"steps": 0, "cost_ratio": 242.11}, {"steps": 512, "cost_ratio": 242.11}][: 1 + (cut == 1)]
    )
    append_row(file, {"steps": 512, "cost_ratio": 1.0})
    assert evaluations_of_run(tmp_path)[len(rows) :] == [(512, 1.0)]
    assert evaluations_of_run(tmp_path)[: len(rows)] == [
        (row["steps"], row["cost_ratio"]) for row in rows
    ]


def test_damage_within_a_file_of_rows_is_named_by_its_line(tmp_path):
    file = tmp_path / EVALUATIONS
    file.write_text('{"steps": 0, "cost_ratio": 1.0}\n{"steps": 1{"steps": 2}\n{"steps": 3}\n')
    with pytest.raises(RunDirectoryError, match="line 2"):
        evaluations_of_run(tmp_path)
    file.write_text('{"steps": 3}\n')
    with pytest.raises(RunDirectoryError, match="no evaluation"):
        evaluations_of_run(tmp_path)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (b'{"a": 1', "no complete JSON"),
        ('{"a": "ä"}'.encode("utf-16"), "no UTF-8"),
        (b"[" * 200_000, "nested too deeply"),
        (b"[1]", "no JSON object"),
        (b"1" * 10_000, "no complete JSON"),
    ],
)
def test_what_is_no_json_object_is_refused_in_one_sentence(tmp_path, text, reason):
    file = tmp_path / "a.json"
    file.write_bytes(text)
    with pytest.raises(FileError, match=reason):
        read_json(file)
    (tmp_path / CONFIG).write_bytes(text)
    with pytest.raises(RunDirectoryError, match=reason):
        read_config(tmp_path)


def test_only_regular_files_of_sane_size_are_read(tmp_path):
    os.mkfifo(tmp_path / "fifo")
    for path in (tmp_path, tmp_path / "fifo", tmp_path / "absent"):
        with pytest.raises(FileError, match=r"no such file|is a"):
            read_json(path)
    write_json(tmp_path / "a", list(range(100)))
    with pytest.raises(FileError, match="larger than 100 byte"):
        read_json(tmp_path / "a", largest=100)
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_json('{"a":' * 100_000)


def test_what_is_no_regular_file_is_called_what_it_is(tmp_path):
    """At every door: a result, a policy, a scenario file, tuned values, a page."""
    os.mkfifo(tmp_path / "fifo")
    doors = (read_json, load_policy, read_scenario, read_tuned, lambda path: put_block(path, "a", "b"))
    for path, words in (
        (tmp_path, "is a folder"),
        (tmp_path / "fifo", "is a pipe or a device"),
        (tmp_path / "absent", "there is no such file"),
    ):
        for read in doors:
            with pytest.raises(ShakeError, match=words):
                read(path)


def test_a_strangers_configuration_is_refused_with_what_lies_beside_it(tmp_path):
    write_json(tmp_path / CONFIG, {})
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(RunDirectoryError, match=r"beside it lies: thesis\.tex"):
        read_config(tmp_path)


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"algorithm": "magic"}, "algorithm is 'magic': known are 'ppo'"),
        ({"algorithm": 5}, "algorithm is 5"),
        ({"net_arch": 64}, "net_arch is 64: must be a list"),
        ({"net_arch": ["wide"]}, "net_arch is 'wide'"),
        ({"seed": None}, "seed is None"),
        ({"ppo": []}, "ppo must be a JSON object"),
        ({"ppo": {"n_envs": True}}, "ppo.n_envs is True"),
        ({"ppo": {"n_envs": -64}}, "n_envs"),
        ({"later_option": 1}, "later_option is unknown"),
        ({"scenario": {"set": "x"}}, "scenario.set"),
    ],
    ids=str,
)
def test_a_configuration_is_checked_field_by_field(tmp_path, changed, reason):
    write_json(tmp_path / CONFIG, {**TrainConfig().to_json(), **changed})
    with pytest.raises(RunDirectoryError, match=reason):
        read_config(tmp_path)


def test_a_configuration_without_its_parts_is_none(tmp_path):
    values = TrainConfig().to_json()
    del values["algorithm"], values["net_arch"]
    write_json(tmp_path / CONFIG, values)
    with pytest.raises(RunDirectoryError, match="algorithm, net_arch not given"):
        read_config(tmp_path)


HOLD = (
    "import sys, time, pathlib\n"
    "from agents.run_directory import locked_folder\n"
    "with locked_folder(pathlib.Path(sys.argv[1])):\n"
    "    print('held', flush=True)\n"
    "    time.sleep(600)\n"
)


def test_another_process_is_refused_by_its_number_and_a_dead_ones_lock_taken_over(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout.readline().strip() == "held"
        with (
            pytest.raises(RunDirectoryError, match=rf"process {process.pid} on host"),
            locked_folder(tmp_path),
        ):
            pass
    finally:
        process.kill()
        process.communicate()
    (tmp_path / f".result.json.{process.pid}.partial").write_text("half")
    (tmp_path / "notes.partial").write_text("mine")
    again = pytest.raises(RunDirectoryError, match=f"process {os.getpid()}")
    with locked_folder(tmp_path), again, locked_folder(tmp_path, 0.1):
        pass
    assert sorted(f.name for f in tmp_path.iterdir() if f.name != ".lock") == ["notes.partial"]


def test_a_directory_is_made_with_its_first_files_or_not_at_all(tmp_path):
    run = tmp_path / "runs" / "a"

    def fails(folder):
        write_json(folder / CONFIG, {})
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        create_run_directory(run, fails)
    assert list(run.parent.iterdir()) == []
    create_run_directory(run, lambda folder: write_json(folder / CONFIG, {}))
    assert folder_contents(run) == [CONFIG]
    with pytest.raises(FileError):  # another process came first
        shutil.move(run, tmp_path / "b")
        create_run_directory(run, lambda folder: shutil.copytree(tmp_path / "b", run) and None)


def test_an_unfinished_run_stands_for_its_best_policy(tmp_path):
    assert policy_of_run(tmp_path) == tmp_path / POLICY
    (tmp_path / BEST).write_bytes(b"")
    assert policy_of_run(tmp_path) == tmp_path / BEST
    (tmp_path / POLICY).write_bytes(b"")
    assert policy_of_run(tmp_path) == tmp_path / POLICY


def test_results_of_the_documentation_are_complete_and_others_are_named(tmp_path, request):
    folder = request.config.rootpath / "docs" / "results"
    for file in sorted(folder.glob("bench_*.json")):
        assert bench.read_benchmark(file)["scenario"] == file.stem.removeprefix("bench_")
    assert len(result_files.read_results(folder)) > 3
    result = bench.read_benchmark(folder / "bench_linear.json")
    for damage in (
        lambda r: r.pop("reference"),
        lambda r: r["rows"].clear(),
        lambda r: r["rows"][0].pop("relative_cost"),
        lambda r: r["rows"][0].update(relative_cost="1"),
        lambda r: r.update(rows="none"),
    ):
        other = json.loads(json.dumps(result))
        damage(other)
        write_json(tmp_path / "bench_linear.json", other)
        with pytest.raises(FileError, match="no complete result of shake benchmark"):
            bench.read_benchmarks(tmp_path)
    protocol = json.loads((folder / "evaluation_linear.json").read_text())
    protocol["episodes"].popitem()
    write_json(tmp_path / "evaluation_linear.json", protocol)
    with pytest.raises(FileError, match="no complete result of shake evaluate"):
        result_files.read_results(tmp_path)
