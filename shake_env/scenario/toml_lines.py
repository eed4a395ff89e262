"""Where in a TOML file each field stands; looked for when an error is to name it."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

from shake_env.scenario.field_paths import Steps

MOST_TRIES = 50  # ends that are tried of a value of several lines
_ENDS = ("]", '"""', "'''")  # one of these ends such a value


@dataclass(frozen=True)
class TomlSource:
    """A TOML file that has been read."""

    file: Path
    text: str

    def place(self, steps: Steps) -> str:
        """Return file and line of the field at a path, or of the nearest part above it."""
        for length in range(len(steps), 0, -1):
            if steps[:length] in self._lines:
                return f"{self.file}, line {self._lines[steps[:length]]}"
        return str(self.file)

    @cached_property
    def _lines(self) -> dict[Steps, int]:
        """Line, from 1 on, of every path at which something is written."""
        lines: dict[Steps, int] = {}
        counts: dict[Steps, int] = {}  # of the tables in each array
        above: Steps = ()
        for number, statement, tree in _statements(self.text):
            header = statement.lstrip().startswith("[")
            for steps, is_header in _written(tree, header, counts, above):
                for length in range(1, len(steps) + 1):
                    lines.setdefault(steps[:length], number)
                if is_header:
                    above = steps
        return lines


def _statements(text: str) -> Iterator[tuple[int, str, dict[str, Any]]]:
    """Yield number, text and content of every line, with those that a value goes on over."""
    lines = re.split("(?<=\n)", text)
    index = 0
    while index < len(lines):
        later = (end for end in range(index + 2, len(lines) + 1) if _may_end(lines[end - 1]))
        for end in (index + 1, *islice(later, MOST_TRIES)):
            statement = "".join(lines[index:end])
            tree = _parsed(statement)
            if tree is not None:
                yield index + 1, statement, tree
                break
        else:
            end = index + 1
        index = end


def _may_end(line: str) -> bool:
    return any(mark in line for mark in _ENDS)


def _parsed(statement: str) -> dict[str, Any] | None:
    try:
        return tomllib.loads(statement)
    except (ValueError, RecursionError):
        return None


def _written(
    tree: Any, header: bool, counts: dict[Steps, int], above: Steps
) -> Iterator[tuple[Steps, bool]]:
    """Yield the paths that a statement writes, and whether it is the heading of a table."""
    steps: Steps = () if header else above
    while isinstance(tree, dict) and len(tree) == 1 and header:
        name, tree = next(iter(tree.items()))
        steps = (*steps, name)
        if isinstance(tree, list):  # a heading in double brackets begins one more table
            counts[steps] = counts.get(steps, -1) + 1
            tree = {}
        if steps in counts:
            steps = (*steps, counts[steps])
    if header:
        yield steps, True
    else:
        for path in _paths(tree):
            yield (*steps, *path), False


def _paths(value: Any) -> Iterator[Steps]:
    """Yield the path of everything in a value of TOML, itself left out."""
    pairs = (
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    )
    for step, part in pairs:
        yield (step,)
        for path in _paths(part):
            yield (step, *path)
