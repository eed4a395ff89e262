"""Any field of a scenario by its path, such as ``nonlinearity.friction.coulomb``."""

from __future__ import annotations

import types
import typing
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

from shake_env.errors import ScenarioError, unknown
from shake_env.sensing import Sensor
from shake_env.uncertainty import Uniform


def with_fields(value: Any, changes: Mapping[str, Any]) -> Any:
    """Return a frozen value with fields changed by their paths, checked as at construction.

    Parameters
    ----------
    value
        A frozen dataclass, such as a `Scenario`.
    changes
        Path to new value. A path names nested fields with dots; sensors go by their signal, as in
        ``sensing.sensors.load_pressure.noise``. Two numbers make a `Uniform` range where one is
        expected, and a mapping of fields makes a part that is None so far.

    Raises
    ------
    ScenarioError
        If a path leads nowhere.
    ParameterError
        If a value is outside its range.
    """
    for path, new in changes.items():
        value = _with_field(value, path.split("."), new, path)
    return value


def _with_field(value: Any, names: list[str], new: Any, path: str) -> Any:
    if not names:
        return new
    first, rest = names[0], names[1:]
    if isinstance(value, tuple) and value and all(isinstance(item, Sensor) for item in value):
        signals = [sensor.signal for sensor in value]
        if first not in signals:
            raise unknown(ScenarioError, f"sensor in {path}", first, signals)
        return tuple(
            _with_field(sensor, rest, new, path) if sensor.signal == first else sensor
            for sensor in value
        )
    if not is_dataclass(value) or isinstance(value, type):
        raise ScenarioError("field path", path, f"{first!r} is asked of {value!r}, which has no fields")
    known = [field.name for field in fields(value)]
    if first not in known:
        raise unknown(ScenarioError, f"field in {path}", first, known)
    old = getattr(value, first)
    if rest:
        changed = _with_field(old, rest, new, path)
    else:
        changed = _converted(typing.get_type_hints(type(value))[first], old, new, path)
    return replace(value, **{first: changed})


def _converted(hint: Any, old: Any, new: Any, path: str) -> Any:
    """Return `new` as what the field holds: ranges and parts may be given in plain values."""
    united = typing.get_origin(hint) in (typing.Union, types.UnionType)
    kinds = typing.get_args(hint) if united else (hint,)
    if Uniform in kinds and isinstance(new, list | tuple) and len(new) == 2:
        return Uniform(*new)
    parts = [kind for kind in kinds if is_dataclass(kind)]
    if parts and isinstance(new, Mapping):
        part: Any = parts[0]
        start = old if is_dataclass(old) else part()
        return with_fields(start, new)
    if parts and not (new is None and type(None) in kinds) and not is_dataclass(new):
        names = " or ".join(getattr(kind, "__name__", str(kind)) for kind in parts)
        raise ScenarioError(path, new, f"is a {names}: name one of its fields by a dot")
    return tuple(new) if isinstance(old, tuple) and isinstance(new, list) else new
