"""The commands ``shake export`` (C, FMU) and ``shake rehearse``."""

import json
import shutil

import pytest

from agents.__main__ import main

pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler is installed"
)


def result(capsys, *words):
    assert main([*words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_export_writes_a_folder_of_c(tmp_path, capsys):
    words = ("export", "pid", "--scenario", "laboratory", "--to", "c", "--precision", "float32")
    found = result(capsys, *words, "--prefix", "mine", "--output", str(tmp_path / "pid"))
    assert found["name"] == "mine"
    assert set(found["files"]) == {
        "mine.h", "mine.c", "mine_test.c", "mine_recorded.h", "mine_udp.c", "Makefile",
    }  # fmt: skip
    assert "typedef float mine_real;" in (tmp_path / "pid" / "mine.h").read_text(encoding="utf-8")


def test_export_writes_the_table_as_an_fmu(tmp_path, capsys):
    file = tmp_path / "table.fmu"
    words = ("export", "table", "--scenario", "laboratory", "--to", "fmu", "--fmi", "2.0")
    assert result(capsys, *words, "--output", str(file))["fmi"] == "2.0"
    assert file.stat().st_size > 1000


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["lqg", "--to", "fmu"], "output = None: must end in .fmu"),
        (["apg", "x.onnx", "--output", "y.onnx"], "is given twice"),
        (["apg", "x.onnx", "--safety-supervisor"], "the policy alone"),
        (["table", "--to", "c", "--safety-supervisor", "--output", "{}"], "no controller"),
        (["pid", "x.fmu", "--to", "fmu", "--precision", "float32"], "option of the C program"),
        (
            ["lqr-friction-ff", "--scenario", "laboratory", "--to", "c", "--output", "{}"],
            "lqr-friction-ff': has no C form where signals are measured",
        ),
        (["pid", "--to", "c", "--prefix", "1st"], "C identifier"),
        (["pid", "--to", "c", "--prefix", "é"], "C identifier"),
        (["pid", "--to", "c", "--prefix", "output_feedback", "--output", "{}"], "choose another"),
        (
            ["mpc", "--scenario", "laboratory", "--to", "c", "--output", "{}"],
            "no C form: it solves",
        ),
        (["lqg", "--to", "c", "--output", "{}"], "nothing to estimate"),
    ],
)
def test_what_cannot_be_exported_is_said(words, message, tmp_path, capsys):
    assert main(["export", *(word.format(tmp_path / "folder") for word in words)]) == 2
    assert message in " ".join(capsys.readouterr().err.split())


def test_rehearse_counts_and_logs(tmp_path, capsys):
    found = result(
        capsys, "rehearse", "pid", "--seconds", "0.5", "--unpaced", "--faults", "lost", "corrupt",
        "--fault-rate", "0.1", "--output", str(tmp_path / "log"),
    )  # fmt: skip
    assert found["hard_limits_broken"] == 0 and found["unnoticed"] == []
    assert set(found["injected"]) == {"lost", "corrupt"}
    assert (tmp_path / "log" / "test-1.csv").is_file() and (tmp_path / "log" / "test-1.h5").is_file()


def test_an_unknown_fault_is_named(capsys):
    assert main(["rehearse", "pid", "--faults", "broken"]) == 2
    assert "known: " in capsys.readouterr().err
