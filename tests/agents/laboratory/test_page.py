"""The page of the sequence of shakes runs as it stands, on the logs that ship."""

import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

from agents.__main__ import main
from agents.laboratory.logs.findings import channel_faults
from agents.laboratory.logs.log_file import read_log
from agents.laboratory.logs.mapping import read_mapping
from agents.laboratory.sequence.state import read_sequence
from shake_env.scenario.scenario_file import parse_toml

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "howto" / "test_sequence.md").read_text(encoding="utf-8")
LOGS = [ROOT / "examples" / "laboratory" / f"shake{number}.h5" for number in (1, 2)]


def files_of_the_page(folder):
    for name, text in re.findall(r'```toml title="([\w.]+)"\n(.*?)```', PAGE, re.DOTALL):
        (folder / name).write_text(text, encoding="utf-8")
    for log in LOGS:
        shutil.copy(log, folder)


def lines_of_the_page():
    blocks = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    return [shlex.split(line)[1:] for block in blocks for line in block.splitlines() if line]


def test_the_logs_that_ship_are_those_of_the_page(tmp_path):
    files_of_the_page(tmp_path)
    scenario = parse_toml("frame.toml", (tmp_path / "frame.toml").read_text())
    for number, file in enumerate(LOGS, start=1):
        log = read_log(file)
        assert log.name == f"shake {number}"
        assert channel_faults(log) == []
        assert log.scenario.motion.record == scenario.motion.record
        assert file.stat().st_size < 100_000
    ratio = log.channels["target_acceleration"] / np.maximum(
        np.abs(read_log(LOGS[0]).channels["target_acceleration"]), 1e-9
    )
    assert np.median(np.abs(ratio)) == pytest.approx(4.0, rel=1e-6)
    assert set(read_mapping(tmp_path / "daq.toml").channels) <= set(log.channels)


def test_the_page_plans_and_closes_its_first_shake(tmp_path, monkeypatch, capsys):
    files_of_the_page(tmp_path)
    monkeypatch.chdir(tmp_path)
    lines = lines_of_the_page()[:3]
    assert [words[1] for words in lines] == ["plan", "next", "close"]
    lines[0][lines[0].index("40")] = "10"
    lines[1] += ["--override", "ten samples promise little"]
    for words in lines:
        assert main([*words, "--json"]) == 0, capsys.readouterr()
    sequence = read_sequence(tmp_path / "frame")
    assert sequence.number == 1
    assert sequence.posterior.logs[0][0] == "shake 1"


@pytest.mark.slow
def test_every_command_of_the_page_runs(tmp_path, monkeypatch, capsys):
    files_of_the_page(tmp_path)
    monkeypatch.chdir(tmp_path)
    for words in lines_of_the_page():
        if "--sampler-seconds" in words:
            words[words.index("--sampler-seconds") + 1] = "10"
        if "rehearse" in words:
            words[words.index("--truths") + 1] = "1"
        assert main(words) == 0, (words, capsys.readouterr())
    assert read_sequence(tmp_path / "frame").number == 2
