"""Every public function that takes a path takes a string, a Path and any other os.PathLike."""

import ast
import os
from pathlib import Path

import pytest

from agents.reporting.markdown_blocks import has_place
from shake_env import RECORD_NAMES, load_record
from shake_env.records import read_motion, write_record

ROOT = Path(__file__).parents[1]
# Inside a run directory or behind a command, which make the paths themselves.
INNER = {"run_directory.py", "output_path.py", "motion.py", "files.py", "study_storage.py"}


def path_parameters(source):
    """Public functions with a parameter that is annotated as a bare Path."""
    return [
        f"{node.name}({argument.arg})"
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_")
        for argument in (*node.args.args, *node.args.kwonlyargs)
        if argument.annotation is not None and ast.unparse(argument.annotation) == "Path"
    ]


@pytest.mark.parametrize("package", ["shake_env", "baselines", "agents"])
def test_no_public_function_asks_for_a_path_alone(package):
    for file in sorted((ROOT / package).rglob("*.py")):
        if file.name not in INNER:
            assert path_parameters(file.read_text(encoding="utf-8")) == [], file


def test_the_rule_can_fail():
    assert path_parameters("def read(file: Path, n: int): ...") == ["read(file)"]


class OwnPath:
    def __init__(self, path):
        self.path = path

    def __fspath__(self):
        return str(self.path)


@pytest.mark.parametrize("kind", [str, Path, OwnPath, os.fspath])
def test_strings_and_other_paths_are_the_same_file(kind, tmp_path):
    path = tmp_path / "record.csv"
    write_record(load_record(RECORD_NAMES[0]), kind(path))
    (record,) = read_motion(kind(path))
    assert len(record.acceleration) == len(load_record(RECORD_NAMES[0]).acceleration)
    assert not has_place(kind(path), "a place")
