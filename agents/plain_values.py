"""Plain JSON values to typed dataclasses, with an error that names the field; how two of them differ."""

from __future__ import annotations

import json
import types
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from shake_env.errors import ShakeError

Value = TypeVar("Value")


def typed(kind: type[Value], values: object, name: str = "") -> Value:
    """Return the dataclass `kind` (a configuration) that plain JSON values describe.

    Parameters
    ----------
    kind
        A dataclass of numbers, words, truth values, None, tuples, lists and mappings of these, and other
        dataclasses. Fields that are not given take their defaults.
    values
        What was read; an object that is no mapping is refused.
    name
        Of the value, for errors.

    Raises
    ------
    ValueError
        With one sentence, if a field is missing, unknown or of another type. What `kind` itself refuses
        it raises.
    """
    if not isinstance(values, Mapping):
        raise ValueError(f"{name or 'the whole'} must be a JSON object")
    hints: dict[str, Any] = _hints(kind)  # type: ignore[arg-type]  # mypy takes no type[T] as hashable
    prefix = f"{name}." if name else ""
    for key in values:
        if key not in hints:
            raise ValueError(f"{prefix}{key} is unknown")
    try:
        return kind(**{key: _typed(hints[key], value, prefix + key) for key, value in values.items()})
    except TypeError as error:  # a field without a default is not given
        raise ValueError(f"{name or 'the whole'} is incomplete ({error})") from None


@cache
def _hints(kind: type[Any]) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in fields(kind)}


def _typed(hint: Any, value: Any, name: str) -> Any:
    if hint is Any:
        return value
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        if value is None and type(None) in arguments:
            return None
        (rest,) = (each for each in arguments if each is not type(None))
        return _typed(rest, value, name)
    if origin is Literal:
        if value not in arguments:
            raise ValueError(f"{name} is {value!r}: known are {', '.join(map(repr, arguments))}")
        return value
    if origin in (tuple, list):
        if not isinstance(value, list | tuple):
            raise ValueError(f"{name} is {value!r}: must be a list")
        if origin is tuple and Ellipsis not in arguments and len(value) != len(arguments):
            raise ValueError(f"{name} is {value!r}: must hold {len(arguments)} values")
        return origin(_typed(arguments[0], each, name) for each in value)
    if origin in (dict, Mapping):
        if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
            raise ValueError(f"{name} is {value!r}: must be a JSON object")
        return {key: _typed(arguments[1], each, f"{name}.{key}") for key, each in value.items()}
    if is_dataclass(hint):
        return typed(hint, value, name)  # type: ignore[arg-type]  # a hint is a class, no value
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return value
    if not isinstance(value, hint) or (isinstance(value, bool) and hint is not bool):
        raise ValueError(f"{name} is {value!r}: must be of type {hint.__name__}")
    return value


def differences(one: object, other: object, name: str = "") -> dict[str, tuple[Any, Any]]:
    """Return the fields that differ between two dataclasses of one kind, by path, with both values."""
    if not is_dataclass(one) or type(one) is not type(other):
        return {} if one == other else {name: (one, other)}
    prefix = f"{name}." if name else ""
    return {
        path: pair
        for field in fields(one)
        for path, pair in differences(
            getattr(one, field.name), getattr(other, field.name), prefix + field.name
        ).items()
    }


def plain(values: dict[str, Any]) -> dict[str, Any]:
    """Return values (a configuration's) as JSON has them; what it lacks (a path) as text."""
    return cast("dict[str, Any]", json.loads(json.dumps(values, default=str)))


def plain_row(row: dict[str, Any]) -> dict[str, Any]:
    """Return a row for JSON, which has no NaN: what is not defined (a still table's lag) is null."""
    return {key: None if value != value else value for key, value in row.items()}


def of_type(hint: Any) -> Callable[[Any], Any]:
    """Return a conversion for `entry` that takes values of a type as `typed` does."""
    return lambda value: _typed(hint, value, "value")


def entry(content: Mapping[str, Any], key: str, convert: Callable[[Any], Value], what: str) -> Value:
    """Return an entry of plain JSON values, converted.

    Parameters
    ----------
    content
        What was read.
    key
        Of the entry.
    convert
        Of its value.
    what
        It must be, in words.

    Raises
    ------
    ValueError
        With one sentence that names the key, if it is missing or `convert` refuses its value. What is
        raised on purpose, a ShakeError, is passed on.
    """
    if key not in content:
        raise ValueError(f"the key {key!r} is missing")
    try:
        return convert(content[key])
    except ShakeError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError):
        raise ValueError(f"{key!r} must be {what}") from None
