"""Named test sets of one's own records: strict reading, results by event."""

import hashlib
import json
import shutil
from pathlib import Path

import pytest
from rich.console import Console

from agents.__main__ import main
from agents.motions.channels import MotionOptions
from agents.motions.motion_set import read_motion_set
from shake_env import make_scenario
from shake_env.errors import FileError

DATA = Path(__file__).parents[2] / "data" / "CICLC_trimmed.v1"
OTHER = "time [s],acceleration [m/s^2]\n" + "\n".join(
    f"{0.01 * i:.2f},{(i % 7 - 3) * (i < 300) * 0.3:.3f}" for i in range(400)
)


def entry(path, event_name="A", /, **changes):
    fields = {
        "file": path.name,
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "source": "own array",
        "licence": "CC0-1.0",
        "event": event_name,
    } | changes
    lines = [f"{key} = {json.dumps(value)}" for key, value in fields.items() if value is not None]
    return "[[motion]]\n" + "\n".join(lines) + "\n"


@pytest.fixture
def folder(tmp_path):
    """A set of two files, one with a column chosen."""
    shutil.copy(DATA, tmp_path / "one.v1")
    (tmp_path / "two.csv").write_text(OTHER)
    write(tmp_path, entry(tmp_path / "one.v1", column="2"), entry(tmp_path / "two.csv", "B"))
    return tmp_path


def write(folder, *entries, head='schema = 1\nname = "mine"\n'):
    (folder / "motions.toml").write_text(head + "".join(entries))


def test_a_set_is_compared_and_evaluated_by_event(folder, capsys):
    words = ["--motion-set", str(folder), "--scenario", "linear", "--json"]
    run = ["compare", "--controllers", "lqr", "none", "--no-records", "--num-noise-motions", "0"]
    assert main([*run, *words]) == 0
    compared = json.loads(capsys.readouterr().out)
    assert list(compared["by_event"]) == ["A", "B"]
    assert compared["by_event"]["A"]["lqr"] == 1.0 < compared["by_event"]["A"]["none"]
    assert main(["evaluate", "none", *words, "--no-fidelity"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert len(result["earthquakes"]) == 2 and result["events"] == ["A", "B"] and result["seed"] is None
    assert result["motion_set"]["name"] == "mine"
    assert result["motion_set"]["files"][1]["licence"] == "CC0-1.0"
    cost = {name: each["cost"][0] for name, each in result["episodes"].items()}
    for i, event in enumerate("AB"):
        ratio = cost["none"][i] / cost["lqr"][i]
        assert compared["by_event"][event]["none"] == pytest.approx(ratio, rel=1e-5)
    from agents.reporting.evaluation_tables import evaluation_markdown

    assert "| cost / bound by event | A (1) | B (1) |" in evaluation_markdown(result)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"licence": None}, "motion 1.licence.*is missing"),
        ({"source": " "}, "motion 1.source.*must be words"),
        ({"event": 3}, "motion 1.event.*must be words"),
        ({"sha256": "0" * 64}, "motion 1.sha256.*another file, or the digest is wrong"),
        ({"file": "absent.csv"}, "motion 1.file.*no such file"),
        ({"file": "../two.csv"}, "motion 1.file.*in the folder of the set"),
        ({"licens": "CC0"}, "motion 1.licens.*did you mean 'licence'"),
        ({"sampling_interval": "0.01"}, "motion 1.sampling_interval.*another type"),
        ({"allow_large": 1}, "motion 1.allow_large.*another type"),
    ],
)
def test_a_fault_is_named_with_field_and_remedy(folder, changes, words):
    write(folder, entry(folder / "two.csv", **changes))
    with pytest.raises(FileError, match=words):
        read_motion_set(folder)


def test_a_manifest_is_whole(folder):
    one = entry(folder / "two.csv")
    for text, words in (
        ('name = "mine"\n' + one, "schema.*must be 1"),
        ("schema = 1\n" + one, "name.*is missing"),
        ('schema = 1\nname = "mine"\n', "at least one"),
        ('schema = 1\nname = "mine"\n' + one + one, "motion 2.file.*named twice"),
        ("schema = [", "is no TOML"),
    ):
        (folder / "motions.toml").write_text(text)
        with pytest.raises(FileError, match=words):
            read_motion_set(folder)
    (folder / "motions.toml").unlink()
    with pytest.raises(FileError, match="describe the records in it"):
        read_motion_set(folder)


def test_a_file_is_in_a_set_once(folder):
    table = folder / "two.csv"
    whole, column = entry(table, units="g"), entry(table, column="2")
    shutil.copy(table, folder / "copy.csv")
    for entries in ((whole, column), (column, whole), (whole, entry(folder / "copy.csv"))):
        write(folder, *entries)
        with pytest.raises(FileError, match=r"motion 2.file.*named twice, see motion 1; .*every column"):
            read_motion_set(folder)
    write(folder, column, column)
    with pytest.raises(FileError, match=r"motion 2.file.*named twice, see motion 1$"):
        read_motion_set(folder)
    write(folder, column, entry(table, column="3"))
    assert len(read_motion_set(folder).motions) == 2


def test_a_column_by_its_title_and_by_its_number_is_one(folder):
    table = folder / "two.csv"
    title = "acceleration [m/s^2]"
    write(folder, entry(table, column="2"), entry(table, column=title))
    known = read_motion_set(folder)
    with pytest.raises(FileError, match=r"motion 2 of mine = .*has the samples of motion 1"):
        known.earthquakes(MotionOptions(), make_scenario("linear"), scale=True, console=Console())


def test_the_manifest_may_be_named_for_its_folder(folder):
    assert read_motion_set(folder / "motions.toml") == read_motion_set(folder)
    with pytest.raises(FileError, match=r"two.csv.*is no folder: name the folder"):
        read_motion_set(folder / "two.csv")


def test_a_set_and_single_motions_are_not_mixed(folder, capsys):
    words = ["compare", "--motion-set", str(folder), "--motion", str(folder / "two.csv"), "--json"]
    assert main(words) == 2
    assert "--motion-set" in capsys.readouterr().err
