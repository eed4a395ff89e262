"""Any field of a scenario by its path, such as ``nonlinearity.friction.coulomb``."""

from __future__ import annotations

import types
import typing
from collections.abc import Mapping, Sized
from dataclasses import fields, is_dataclass, replace
from typing import Any

from shake_env.errors import ScenarioError, unknown
from shake_env.model.parameters import Specimen
from shake_env.model.ranges import RANGES
from shake_env.scenario.observation import Sensor
from shake_env.scenario.uncertainty import Uniform


def with_fields(value: Any, changes: Mapping[str, Any]) -> Any:
    """Return a frozen value with fields changed by their paths, checked as at construction.

    Parameters
    ----------
    value
        A frozen dataclass, such as a `Scenario`.
    changes
        Path to new value. A path names nested fields with dots; sensors go by their signal, as in
        ``sensing.sensors.load_pressure.noise``. Two numbers make a `Uniform` range where one is
        expected, and a mapping of fields makes a part that is None so far. Fields of one part are
        changed together. Of a specimen with equal storeys, one of ``masses``, ``stiffnesses`` and
        ``dampings`` decides the number of storeys; the others are continued with their value.

    Raises
    ------
    ScenarioError
        If a path leads nowhere.
    ParameterError
        If a value is outside its range.
    """
    if isinstance(value, Specimen):
        changes = _as_many_storeys(value, changes)
    together: dict[str, dict[str, Any]] = {}  # what is asked of each field, by the rest of the path
    for path, new in changes.items():
        first, _, rest = path.partition(".")
        if not rest:
            together.pop(first, None)  # a whole part replaces what was asked of its fields before
        together.setdefault(first, {})[rest] = new
    return _with_parts(value, together)


def _with_parts(value: Any, together: Mapping[str, Mapping[str, Any]]) -> Any:
    if isinstance(value, tuple) and value and all(isinstance(item, Sensor) for item in value):
        signals = [sensor.signal for sensor in value]
        for first in together:
            if first not in signals:
                raise unknown(ScenarioError, "sensor", first, signals)
        return tuple(
            _changed(sensor, None, together.get(sensor.signal, {}), sensor.signal) for sensor in value
        )
    if not is_dataclass(value) or isinstance(value, type):
        name = next(iter(together))
        raise ScenarioError("field path", name, f"is asked of {value!r}, which has no fields")
    known = [field.name for field in fields(value)]
    new: dict[str, Any] = {}
    for first, asked in together.items():
        if first not in known:
            raise unknown(ScenarioError, f"field of {type(value).__name__}", first, known)
        hint = typing.get_type_hints(type(value))[first]
        new[first] = _changed(getattr(value, first), hint, asked, first)
    return replace(value, **new)  # all at once: they are checked together


def _changed(old: Any, hint: Any, asked: Mapping[str, Any], name: str) -> Any:
    """Return a field's value with what is asked of it: itself (the empty path) and then its parts."""
    if "" in asked:
        old = _converted(hint, old, asked[""], name)
    parts = {path: new for path, new in asked.items() if path}
    return with_fields(old, parts) if parts else old


def _as_many_storeys(specimen: Specimen, changes: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the changes with the lists that are not given continued to the given number of storeys.

    Only where the storeys of the specimen are equal in them.
    """
    names = ("masses", "stiffnesses", "dampings")
    lengths = {len(changes[name]) for name in names if isinstance(changes.get(name), Sized)}
    if len(lengths) != 1 or not (number := lengths.pop()):
        return changes
    continued = {
        name: values[:1] * min(number, int(RANGES["Specimen.uniform"]["stories"].high) + 1)
        for name in names
        if name not in changes and len(set(values := getattr(specimen, name))) == 1
    }
    return {**continued, **changes}


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
