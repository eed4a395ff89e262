"""Scenario files: TOML for people, and the JSON that ``shake show-scenario --json`` prints.

A JSON file holds every field by its path, as plain values. A TOML file holds what it says, on top of the
named scenario that it begins with and of the files that it includes; see ``docs/howto/files.md``.
"""

from __future__ import annotations

import json
import math
import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from shake_env.errors import ScenarioError, ShakeError, unknown
from shake_env.files import no_file
from shake_env.records import Record
from shake_env.scenario.builder import Builder
from shake_env.scenario.field_paths import NOTHING, Node, Steps, nodes_of
from shake_env.scenario.observation import Sensor
from shake_env.scenario.presets import NAMED
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.tables.on_table import on_table
from shake_env.scenario.tables.table import TABLE_NAMES, named_table
from shake_env.scenario.toml_lines import TomlSource

LARGEST = 10_000_000  # [bytes] of a JSON file; one of a hundred storeys has 10 000
LARGEST_TOML = 1_000_000  # [bytes]
ENTRIES = ("name", "fields", "observation", "scenarios")  # of a JSON file; the last two are not read
MISSPELT = 0.85  # likeness to a known name from which another one is taken for an error
SCHEMA = 1  # version of the TOML files
SUFFIXES = (".toml", ".json")
WHOLE = (("specimen",), ("motion",))  # sections of which one file says everything


def is_scenario_file(name: object) -> bool:
    """Return whether a scenario is named by the path of its file."""
    return isinstance(name, os.PathLike) or (isinstance(name, str) and name.endswith(SUFFIXES))


def flattened(value: Any, path: str = "", *, samples: bool = False) -> Iterator[tuple[str, Any]]:
    """Yield path and plain value of every field of a scenario's value; infinite numbers as words.

    A record from a file is its name, or (`samples`) an object with all that it holds.
    """
    if isinstance(value, Record):
        yield path, _plain_record(value) if samples else value.name
    elif is_dataclass(value) and not isinstance(value, type):
        for item in fields(value):
            below = f"{path}.{item.name}".lstrip(".")
            yield from flattened(getattr(value, item.name), below, samples=samples)
    elif isinstance(value, tuple) and value and all(isinstance(item, Sensor) for item in value):
        for sensor in value:
            yield from flattened(sensor, f"{path}.{sensor.signal}", samples=samples)
    elif isinstance(value, tuple) and value and is_dataclass(value[0]):
        for number, item in enumerate(value):
            yield from flattened(item, f"{path}[{number}]", samples=samples)
    elif isinstance(value, float) and not math.isfinite(value):
        yield path, str(value)
    else:
        yield path, list(value) if isinstance(value, tuple) else value


def scenario_fields(scenario: Scenario) -> dict[str, Any]:
    """Return every field of a scenario by its path, as plain JSON values."""
    return dict(flattened(scenario, samples=True))


def _plain_record(record: Record) -> dict[str, Any]:
    return {
        "name": record.name,
        "sampling_interval": record.sampling_interval,
        "attribution": [list(line) for line in record.attribution],
        "acceleration": record.acceleration.tolist(),
    }


def scenario_of(values: Mapping[str, Any]) -> Scenario:
    """Return the scenario of which :func:`scenario_fields` made these values; all must be there.

    Raises
    ------
    ScenarioError
        If a field is missing, unknown, given twice, or of another type.
    ParameterError
        If a value is outside its range.
    """
    scenario: Scenario = Builder(complete=True).part((Scenario,), nodes_of(values, once=True), None)
    return scenario


def read_scenario(file: str | os.PathLike[str]) -> Scenario:
    """Return the scenario that a file holds: TOML where its name ends in ``.toml``, JSON otherwise.

    Raises
    ------
    ScenarioError
        If the file cannot be read or is none of these, or a field is unknown, of another type, given
        twice, or (of JSON) missing. The message names file, line, field and value.
    ParameterError
        If a value is outside its range.
    RecordError
        If a recorded motion that the file names cannot be read.
    """
    path = Path(file)
    return parse_toml(path, _text(path, LARGEST_TOML)) if path.suffix == ".toml" else _read_json(path)


def _read_json(file: Path) -> Scenario:
    content = _object(file)
    for name in content:
        if name not in ENTRIES:
            raise unknown(ScenarioError, f"entry of {file}", name, ENTRIES)
    if not isinstance(content.get("fields"), dict):
        raise ScenarioError(
            "scenario file",
            str(file),
            "has no object 'fields': write one by shake show-scenario --json > FILE",
        )
    try:
        scenario = scenario_of(content["fields"])
    except ShakeError as error:
        raise type(error)(f"{file}, {error.field}", error.value, error.remedy) from None
    if content.get("name", scenario.name) != scenario.name:
        raise ScenarioError(
            f"name in {file}", content["name"], f"contradicts its field {scenario.name!r}"
        )
    return scenario


def _text(path: Path, largest: int) -> str:
    """Return the text of a regular file."""

    def refused(why: str) -> ScenarioError:
        return ScenarioError("scenario file", str(path), why)

    try:
        if not path.is_file():
            raise refused(no_file(path))
        if path.stat().st_size > largest:
            raise refused(f"is larger than {largest // 1_000_000} MB, so it is no scenario")
        return path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise refused(f"cannot be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        kind = path.suffix.removeprefix(".").upper() if path.suffix in SUFFIXES else "JSON"
        raise refused(f"is no {kind} ({error})") from None
    except ValueError as error:
        if isinstance(error, ShakeError):
            raise
        raise refused(f"cannot be read ({error})") from None  # a null character in the path


def _object(path: Path) -> dict[str, Any]:
    """Return the JSON object of a file."""
    try:
        content = json.loads(_text(path, LARGEST), object_pairs_hook=_once, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        if isinstance(error, ShakeError):
            raise
        remedy = f"is no JSON ({error}): write it by shake show-scenario --json > FILE"
        raise ScenarioError("scenario file", str(path), remedy) from None
    if not isinstance(content, dict):
        raise ScenarioError(
            "scenario file",
            str(path),
            "must hold one JSON object, as shake show-scenario --json prints it",
        )
    return content


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ScenarioError("scenario file", twice, "stands twice in one object: remove one of them")
    return content


def _no_constant(word: str) -> Any:
    raise ValueError(f"{word} is no JSON number; an infinite value is the word 'inf'")


# TOML


def parse_toml(file: str | os.PathLike[str], text: str) -> Scenario:
    """Return the scenario of a TOML file whose text is in memory; see :func:`read_scenario`.

    Parameters
    ----------
    file
        What messages call it, and what paths in it are relative to.
    text
        Its text.
    """
    file = Path(file)
    tree = _tree(TomlSource(file, text), (), set())
    base = tree.parts.pop("base", None)
    start = "linear" if base is None else base.value
    if not isinstance(start, str) or start not in NAMED:
        assert base is not None
        remedy = unknown(ScenarioError, "", str(start), NAMED).remedy
        raise ScenarioError(base.place, base.given(), f"is no named scenario: {remedy}")
    if "name" not in tree.parts:
        tree.child("name").value = file.stem
    scenario: Scenario = Builder().part((Scenario,), tree, _on_its_table(NAMED[start](), tree))
    return scenario


def _on_its_table(scenario: Scenario, tree: Node) -> Scenario:
    """Return a scenario on the table that a file names, before what else it says."""
    node = tree.parts.get("table")
    if node is None:
        return scenario
    name = node.value if isinstance(node.value, str) else ""
    misspelt = get_close_matches(name, TABLE_NAMES, 1, MISSPELT)
    if node.value not in TABLE_NAMES and "actuator" in tree.parts and not misspelt:
        return scenario  # a table without a name here is what the file says of its actuator
    try:
        return on_table(scenario, named_table(node.value))
    except ShakeError as error:
        raise type(error)(node.place, node.given(), error.remedy) from None


def _tree(source: TomlSource, including: tuple[Path, ...], files: set[Path]) -> Node:
    """Return what a file and those that it includes ask for; `files` are those that were read."""
    file = source.file
    tree = _node(_table(source), (), source)
    schema = tree.parts.pop("schema", None)
    if schema is None:
        raise ScenarioError(str(file), None, f"says no version: begin with schema = {SCHEMA}")
    if type(schema.value) is not int or schema.value != SCHEMA:
        raise ScenarioError(
            schema.place, schema.given(), f"must be {SCHEMA}, the version that this program reads"
        )
    include = tree.parts.pop("include", None)
    names = [] if include is None else include.value
    if not isinstance(names, list) or not all(isinstance(name, str) and name for name in names):
        assert include is not None
        raise ScenarioError(include.place, include.given(), "must be a list of names of files")
    files.add(file.resolve())
    below = Node()
    for number, name in enumerate(names):
        other = file.parent / name
        place = source.place(("include", number))
        if other.suffix != ".toml":
            raise ScenarioError(f"{place}, include", name, "must end in .toml")
        if other.resolve() in (*including, file.resolve()):
            raise ScenarioError(f"{place}, include", name, "includes this file itself: a circle")
        if other.resolve() in files:
            continue
        try:
            text = _text(other, LARGEST_TOML)
        except ScenarioError as error:
            raise ScenarioError(f"{place}, include", str(other), error.remedy) from None
        part = _tree(TomlSource(other, text), (*including, file.resolve()), files)
        _merge(below, part, replacing=False)
    _merge(tree, below, replacing=True)
    return tree


def _table(source: TomlSource) -> dict[str, Any]:
    try:
        return tomllib.loads(source.text)
    except (ValueError, RecursionError) as error:
        position = re.search(r" \(at line (\d+), column \d+\)", str(error))
        lines = source.text.split("\n")
        number = int(position[1]) if position else len(lines)
        why = str(error)[: position.start()] if position else str(error)
        text = lines[number - 1].strip()[:80]
        raise ScenarioError(f"{source.file}, line {number}", text, f"is no TOML: {why}") from None


def _node(value: Any, steps: Steps, source: TomlSource) -> Node:
    node = Node(steps, source)
    if isinstance(value, dict):
        node.parts = {name: _node(part, (*steps, name), source) for name, part in value.items()}
    elif isinstance(value, list) and any(isinstance(item, dict) for item in value):
        node.value = ()  # the tables of an array stand for themselves
        node.parts = {i: _node(item, (*steps, i), source) for i, item in enumerate(value)}
    else:
        node.value = value
    return node


def _merge(tree: Node, other: Node, *, replacing: bool) -> None:
    """Add to a tree what another says; what both say stays (`replacing`), or is refused."""
    for step, part in other.parts.items():
        own = tree.parts.get(step)
        if own is None:
            tree.parts[step] = part
        elif _is_section(own) and _is_section(part):
            _merge(own, part, replacing=replacing)
        elif not replacing:
            raise ScenarioError(part.place, part.given(), f"is given in {own.place}, too: remove one")


def _is_section(node: Node) -> bool:
    return bool(node.parts) and node.value is NOTHING and node.steps not in WHOLE
