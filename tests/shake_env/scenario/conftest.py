"""Scenario files for the tests of this folder."""

import shutil
from pathlib import Path

import pytest

RECORD = Path(__file__).parents[2] / "data" / "CICLC_trimmed.v1"


@pytest.fixture
def write(tmp_path):
    """A function that writes a file, with the version ahead of its text, and returns its path."""
    shutil.copy(RECORD, tmp_path / "CICLC.v1")

    def written(text, name="my.toml"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"schema = 1\n{text}", encoding="utf-8")
        return path

    return written
