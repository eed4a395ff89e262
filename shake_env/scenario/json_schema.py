"""The JSON schema of scenario files, by which editors complete, explain and check them.

It is less strict than the reader: it does not convert units, and does not see how fields depend on one
another.
"""

from __future__ import annotations

import inspect
import math
import types
from typing import Any

from shake_env.model.ranges import Range
from shake_env.scenario.builder import NONE
from shake_env.scenario.field_table import (
    MISSING,
    OF_THE_SIGNAL,
    Field,
    fields_of,
    item_kinds,
    parts_of,
    plain_docstring,
)
from shake_env.scenario.forms import FORMS
from shake_env.scenario.observation import UNITS, Sensor
from shake_env.scenario.presets import NAMED
from shake_env.scenario.quantities import is_unit
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.scenario_file import SCHEMA
from shake_env.scenario.uncertainty import Uniform

Schema = dict[str, Any]
_NUMBER = r"^\s*[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?"


def scenario_schema() -> Schema:
    """Return the schema as plain JSON values (draft 7)."""
    definitions: dict[str, Schema] = {}
    head: dict[str, Schema] = {
        "schema": {"const": SCHEMA, "description": "Version of the format of the file."},
        "include": {
            "type": "array",
            "items": {"type": "string", "pattern": r"\.toml$"},
            "description": "Files whose fields hold where this one says nothing else; relative to it.",
        },
        "base": {
            "enum": [*NAMED],
            "description": "Named scenario whose values hold where nothing else is said; unset: linear.",
        },
    }
    body = _part(Scenario, definitions, "")
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "Scenario of a shake table",
        **body,
        "properties": {**head, **body["properties"]},
        "required": ["schema"],
        "definitions": dict(sorted(definitions.items())),
    }


def _part(kind: Any, definitions: dict[str, Schema], unit: str) -> Schema:
    """Return the schema of a part given by its fields; `unit` is that of a sensor's signal."""
    return {
        "type": "object",
        "description": plain_docstring((inspect.getdoc(kind) or "").split("\n\n")[0]).replace(
            "None", NONE
        ),
        "properties": {about.name: _field(about, definitions, unit) for about in fields_of(kind)},
        "additionalProperties": False,
    }


def _reference(kind: Any, definitions: dict[str, Schema]) -> Schema:
    name = kind.__name__
    if name not in definitions:
        definitions[name] = {}  # before its own parts
        own = _part(kind, definitions, "")
        forms = [_form(form, make, definitions) for form, make in FORMS.get(kind, {}).items()]
        definitions[name] = {"anyOf": [own, *forms]} if forms else own
    return {"$ref": f"#/definitions/{name}"}


def _form(name: str, make: Any, definitions: dict[str, Schema]) -> Schema:
    required = [about.name for about in fields_of(make) if about.default is MISSING]
    return {
        "type": "object",
        "properties": {name: {**_part(make, definitions, ""), "required": required}},
        "required": [name],
        "additionalProperties": False,
    }


def _field(about: Field, definitions: dict[str, Schema], signal_unit: str = "") -> Schema:
    allowed = about.allowed
    unit = about.unit or ""
    unit = signal_unit if unit == OF_THE_SIGNAL else unit
    choices: list[Schema] = []
    items = item_kinds(about.kinds)
    if bool in about.kinds:
        choices.append({"type": "boolean"})
    if float in about.kinds or int in about.kinds:
        choices += _numbers(allowed, unit, whole=float not in about.kinds)
    if str in about.kinds:
        choices.append({"type": "string"})
    if Uniform in about.kinds:
        ends: Schema = {"anyOf": _numbers(allowed, unit)}
        choices.append({"type": "array", "items": ends, "minItems": 2, "maxItems": 2})
        choices.append(
            {
                "type": "object",
                "properties": {"low": ends, "high": ends},
                "required": ["low", "high"],
                "additionalProperties": False,
            }
        )
    elif items is not None and Sensor in items:
        signals = {
            signal: {"anyOf": [_part(Sensor, definitions, UNITS[signal]), {"const": NONE}]}
            for signal in UNITS
        }
        choices.append({"type": "object", "properties": signals, "additionalProperties": False})
    elif items is not None:
        parts = [_reference(kind, definitions) for kind in parts_of(items)]
        each = parts or _numbers(allowed, unit)
        if item_kinds(items) is not None:  # rows of a matrix
            row: Schema = {"type": "array", "items": {"anyOf": each}}
            each = [*each, row] if float in items else [row]
        choices.append({"type": "array", "items": {"anyOf": each}, "minItems": 1})
    else:
        choices += [
            _reference(kind, definitions) for kind in parts_of(about.kinds) if kind.__name__ != "Record"
        ]
    if types.NoneType in about.kinds:
        choices.append({"const": NONE})
    texts = [about.meaning, "" if allowed is None else f"Range: {allowed.interval}."]
    description = (
        " ".join(text for text in texts if text).replace(OF_THE_SIGNAL, unit).replace("None", NONE)
    )
    schema = choices[0] if len(choices) == 1 and "$ref" not in choices[0] else {"anyOf": choices}
    return {**schema, "description": description} if description else schema


def _numbers(allowed: Range | None, unit: str, *, whole: bool = False) -> list[Schema]:
    """Return the schemas of a number in SI and of a quantity with a unit."""
    number: Schema = {"type": "integer" if whole else "number"}
    if allowed is not None:
        number["minimum"] = 0 if allowed.zero else allowed.low
        if math.isfinite(allowed.high):
            number["maximum"] = allowed.high
    if whole or not (is_unit(unit or "-") or unit == "physics steps"):
        return [number]
    return [number, {"type": "string", "pattern": _NUMBER}]
