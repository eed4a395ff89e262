"""Where commands write: numbered folders, and what cannot be written is found at once."""

from pathlib import Path

import pytest

from agents.__main__ import main
from agents.cli.output_path import output_file, output_folder
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
