"""Where commands write: numbered folders, and what cannot be written is found at once."""

import re
from pathlib import Path

import pytest

from agents.__main__ import main
from agents.cli.output_path import output_file, output_folder, without_empty_folders
from shake_env.errors import ParameterError


def test_the_usual_folder_is_numbered_and_a_given_one_never_overwritten(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    usual = Path("out/compare")
    assert output_folder(None, usual) == usual
    assert output_folder(None, usual) == usual  # nothing was written to it
    (usual / "comparison.json").write_text("{}")
    assert output_folder(None, usual) == Path("out/compare-2")
    (Path("out/compare-2") / "x").write_text("")
    assert output_folder(None, usual) == Path("out/compare-3")
    with pytest.raises(ParameterError, match="--force"):
        output_folder(usual, usual)
    assert output_folder(usual, usual, force=True) == usual
    file = Path("out/evaluate/linear.json")
    assert output_file(None, file) == file
    file.write_text("{}")
    assert output_file(None, file) == Path("out/evaluate/linear-2.json")
    assert output_file(file, Path("x.json")) == file


@pytest.mark.parametrize(
    "words",
    [
        "compare --output {}", "compare --report {}", "evaluate lqr --output {}/x.json",
        "robustness --output {}", "components --output {}", "validate --output {}",
        "reproduce --output {}", "export analytic {}/x.onnx", "watch --save {}/x.gif",
        "tune pid --scenario laboratory --output {}/x.json", "benchmark --results {}",
        "tune-training linear/ppo --storage {}/x.db",
        "motion mine.csv --output {}", "accept mine.csv --output {}", "accept --make {}/x.csv",
        "calibrate --output {}/x.json", "sequence rehearse --output {}/x.json",
        "gradient-noise --output {}/x.json",
    ],
)  # fmt: skip
def test_unwritable_output_is_found_before_the_work_begins(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "shake_env.simulation.simulation.Simulation.__init__", None
    )  # any use of it fails
    (tmp_path / "file").write_text("no folder")
    assert main(words.format(tmp_path / "file" / "below").split()) == 2
    err = capsys.readouterr().err.splitlines()[-1]
    assert "cannot be written (Not a directory)" in err and "below" in err


@pytest.mark.parametrize(
    "words",
    [
        "export mpc --scenario laboratory --to c --output {}/a/b",
        "export lqg --to fmu --output {}/a/b/x.fmu",
        "export nobody --to onnx --output {}/a/x.onnx",
        "rehearse pid --seconds 0.001 --output {}/a/b",
        "rehearse nobody --output {}/a/b",
        "compare --controllers nobody --output {}/a --report {}/b/c --logs {}/d",
        "plan nobody --output {}/a/b",
        "play --controller nobody --save {}/a/b/x.gif",
        "calibrate --seconds 0.001 --output {}/a/x.json",
        "sequence plan --folder {}/a --scenario laboratory --samples 0",
        "tune-training nobody --folder {}/a --storage {}/b/x.db --output {}/c/x.json",
        "train --config.episode-duration 0.001 --run-dir {}/a/run",
    ],
)
def test_a_command_that_fails_leaves_no_empty_folder(words, tmp_path, capsys):
    (tmp_path / "mine").mkdir()  # which is not the command's
    assert main(words.format(*[tmp_path / "mine"] * 3).split()) == 2
    assert [path.relative_to(tmp_path) for path in tmp_path.rglob("*")] == [Path("mine")]


def test_a_folder_that_was_there_and_one_with_files_stay(tmp_path):
    (tmp_path / "there").mkdir()
    with pytest.raises(ParameterError, match="wrong"), without_empty_folders():
        for name in ("there", "new/empty", "new/full"):
            output_folder(tmp_path / name, tmp_path)
        (tmp_path / "new/full/x").write_text("kept")
        raise ParameterError("x", 1, "wrong")
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["full", "new", "there", "x"]


@pytest.mark.parametrize(
    ("words", "field"),
    [
        ("rehearse pid --unpaced", "seconds"),
        ("play --save {}/x.gif", "seconds"),
        ("calibrate", "seconds"),
        ("compare", "duration"),
    ],
)
@pytest.mark.parametrize("value", ["0.001", "0", "-1", "nan", "inf"])
def test_a_time_without_a_control_period_is_refused_with_value_and_remedy(
    words, field, value, tmp_path, capsys
):
    assert main([*words.format(tmp_path).split(), f"--{field}", value]) == 2
    err = capsys.readouterr().err.splitlines()[-1]

    assert re.search(rf"{field} = {float(value)}: must ", err)
    assert not list(tmp_path.iterdir())
