"""A scenario as plain values by path, and back: the JSON that ``shake scenario --json`` prints."""

from __future__ import annotations

import json
import math
import os
import re
import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from shake_env.errors import ScenarioError, ShakeError, unknown
from shake_env.records import Record
from shake_env.scenario.observation import Sensor
from shake_env.scenario.scenario import Scenario

LARGEST = 10_000_000  # [bytes] of a scenario file; one of a hundred storeys has 10 000
ENTRIES = ("name", "fields", "observation", "scenarios")  # of a file; the last two are not read
_STEP = re.compile(r"([^.\[\]]+)|\[(\d{1,6})\]")


def flattened(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield path and plain value of every field of a frozen value; infinite numbers as words."""
    if isinstance(value, Record):
        yield path, value.name
    elif is_dataclass(value) and not isinstance(value, type):
        for item in fields(value):
            yield from flattened(getattr(value, item.name), f"{path}.{item.name}".lstrip("."))
    elif isinstance(value, tuple) and value and all(isinstance(item, Sensor) for item in value):
        for sensor in value:
            yield from flattened(sensor, f"{path}.{sensor.signal}")
    elif isinstance(value, tuple) and value and is_dataclass(value[0]):
        for number, item in enumerate(value):
            yield from flattened(item, f"{path}[{number}]")
    elif isinstance(value, float) and not math.isfinite(value):
        yield path, str(value)
    else:
        yield path, list(value) if isinstance(value, tuple) else value


def scenario_fields(scenario: Scenario) -> dict[str, Any]:
    """Return every field of a scenario by its path, as plain JSON values.

    Raises
    ------
    ScenarioError
        If the scenario holds what these values cannot say: a record that was read from a file.
    """
    values = dict(flattened(scenario))
    if scenario_of(values) != scenario:
        raise ScenarioError(
            "motion",
            values.get("motion.record", scenario.motion),
            "is no embedded record, so that no scenario file can name it: read it with read_motion",
        )
    return values


def scenario_of(values: Mapping[str, Any]) -> Scenario:
    """Return the scenario of which :func:`scenario_fields` made these values; all must be there.

    Raises
    ------
    ScenarioError
        If a field is missing, unknown, given twice, or of another type.
    ParameterError
        If a value is outside its range.
    """
    tree: dict[str, Any] = {}
    for path, value in values.items():
        _insert(tree, path, value)
    scenario: Scenario = _built(Scenario, tree, "")
    return scenario


def read_scenario(file: str | os.PathLike[str]) -> Scenario:
    """Return the scenario that a JSON file of ``shake scenario --json`` holds.

    Raises
    ------
    ScenarioError
        If the file cannot be read or is no such JSON, or a field is missing, unknown or of another type.
    ParameterError
        If a value is outside its range.
    """
    found = _object(Path(file))
    for name in found:
        if name not in ENTRIES:
            raise unknown(ScenarioError, f"entry of {file}", name, ENTRIES)
    if not isinstance(found.get("fields"), dict):
        raise ScenarioError(
            "scenario file",
            str(file),
            "has no object 'fields': write one by shake scenario --json > FILE",
        )
    try:
        scenario = scenario_of(found["fields"])
    except ShakeError as error:
        raise type(error)(f"{file}, {error.field}", error.value, error.remedy) from None
    if found.get("name", scenario.name) != scenario.name:
        raise ScenarioError(f"name in {file}", found["name"], f"contradicts its field {scenario.name!r}")
    return scenario


def _object(path: Path) -> dict[str, Any]:
    """Return the JSON object of a file."""

    def refused(why: str) -> ScenarioError:
        return ScenarioError("scenario file", str(path), why)

    try:
        if not path.is_file():
            raise refused("there is no such file")
        if path.stat().st_size > LARGEST:
            raise refused(f"is larger than {LARGEST // 1_000_000} MB, so it is no scenario")
        text = path.read_text(encoding="utf-8-sig")
        found = json.loads(text, object_pairs_hook=_once, parse_constant=_no_constant)
    except OSError as error:
        raise refused(f"cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        if isinstance(error, ShakeError):
            raise
        raise refused(f"is no JSON ({error}): write it by shake scenario --json > FILE") from None
    if not isinstance(found, dict):
        raise refused("must hold one JSON object, as shake scenario --json prints it")
    return found


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ScenarioError("scenario file", twice, "stands twice in one object: remove one of them")
    return found


def _no_constant(word: str) -> Any:
    raise ValueError(f"{word} is no JSON number; an infinite value is the word 'inf'")


def _insert(tree: dict[str, Any], path: str, value: Any) -> None:
    steps: list[str | int] = [name or int(number) for name, number in _STEP.findall(path)]
    written = "".join(f"[{s}]" if isinstance(s, int) else f".{s}" for s in steps).lstrip(".")
    if not steps or written != path:
        raise ScenarioError("field path", path, "must be names with dots between them")
    node: dict[Any, Any] = tree
    for step in steps[:-1]:
        node = node.setdefault(step, {})
        if not isinstance(node, dict):
            raise ScenarioError("field path", path, "a part of it has a value already: remove one")
    if steps[-1] in node:
        raise ScenarioError("field path", path, "has fields of its own already: remove one of them")
    node[steps[-1]] = _Leaf(value)


class _Leaf:
    """A value at the end of a path, which may itself be a mapping by mistake."""

    def __init__(self, value: Any) -> None:
        self.value = value


def _built(hint: Any, node: Any, path: str) -> Any:
    """Return `node` as what a field of type `hint` holds."""
    kinds = _kinds(hint)
    if isinstance(node, _Leaf):
        return _leaf(kinds, node.value, path)
    for kind in kinds:
        if typing.get_origin(kind) is tuple:
            return _tuple(typing.get_args(kind)[0], node, path)
    parts = [kind for kind in kinds if is_dataclass(kind) and kind is not Record]
    if not parts:
        raise ScenarioError("field path", f"{path}.{next(iter(node))}", f"{path} has no fields")
    kind = _nearest(parts, node)
    hints = typing.get_type_hints(kind)
    names = [item.name for item in fields(kind) if item.init]
    where = f"{path}." if path else ""
    for name in node:
        if name not in names:
            raise unknown(ScenarioError, "field", f"{where}{name}", [f"{where}{n}" for n in names])
    for name in names:
        if name not in node:
            raise ScenarioError(f"{where}{name}", None, "is missing: every field must be there")
    return kind(**{name: _built(hints[name], node[name], f"{where}{name}") for name in names})


def _kinds(hint: Any) -> tuple[Any, ...]:
    """Return the members of a union, those of its members included; the type itself otherwise."""
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return tuple(kind for each in typing.get_args(hint) for kind in _kinds(each))
    return (hint,)


def _nearest(parts: list[Any], node: Mapping[Any, Any]) -> Any:
    """Return the kind whose fields have most names in common with those of a node."""

    def differences(kind: Any) -> int:
        return len({item.name for item in fields(kind) if item.init} ^ set(node))

    return min(parts, key=differences)


def _tuple(hint: Any, node: Mapping[Any, Any], path: str) -> tuple[Any, ...]:
    if hint is Sensor:
        sensors = tuple(_built(hint, each, f"{path}.{signal}") for signal, each in node.items())
        for signal, sensor in zip(node, sensors, strict=True):
            if sensor.signal != signal:
                raise ScenarioError(f"{path}.{signal}.signal", sensor.signal, f"must be {signal!r}")
        return sensors
    if list(node) != [*range(len(node))]:
        raise ScenarioError(path, list(node), "must be numbered from [0] on, without a gap")
    return tuple(_built(hint, each, f"{path}[{number}]") for number, each in node.items())


def _leaf(kinds: tuple[Any, ...], value: Any, path: str) -> Any:
    for kind in kinds:
        if kind is float and value in ("inf", "-inf"):
            return float(value)
        if kind is float and type(value) in (int, float):
            return value
        if kind in (bool, int, str, types.NoneType) and type(value) is kind:
            return value
        if typing.get_origin(kind) is tuple and isinstance(value, list | tuple):
            each = typing.get_args(kind)[0]
            return tuple(_leaf(_kinds(each), item, f"{path}[{i}]") for i, item in enumerate(value))
    names = [getattr(kind, "__name__", str(kind)) for kind in kinds]
    named = ["null" if name == "NoneType" else name for name in names]
    raise ScenarioError(path, value, f"must be a {' or '.join(named)}")
