"""The fields of a scenario's parts: name, type, unit, range, default and meaning, from one place each.

Names, types and defaults come from the dataclasses (or the parameters of a constructor), meanings from
their comments or docstrings, units and ranges from :mod:`shake_env.model.ranges`. Reader, writer, JSON
schema and reference page of scenario files are made of these.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from typing import Any

from shake_env.model.ranges import RANGES, UNCERTAIN, Range

MISSING = dataclasses.MISSING  # default of a field that has none
# Constructors whose parameters have the ranges of another one's, by their names in `RANGES`.
_SAME_RANGES = {"equal_storeys": "Specimen.uniform", "recorded_file": "RecordedMotion"}
_MASS, _STIFFNESS, _DAMPING = (Range(-1e18, 1e18, unit) for unit in ("kg", "N/m", "N s/m"))
_HERTZ = RANGES["Specimen.uniform"]["storey_frequency"]
_RATIO = RANGES["Specimen.uniform"]["damping_ratio"]
_RAYLEIGH = {
    "damping_ratio": _RATIO,
    "rayleigh_frequencies": _HERTZ,
    "rayleigh_damping_ratios": _RATIO,
}
_FURTHER_RANGES = {
    "recorded_file": {"sampling_interval": Range(1e-9, 1e3, "s", optional=True)},
    "Specimen": {  # each entry of a matrix
        "coupled_masses": _MASS,
        "coupled_stiffnesses": _STIFFNESS,
        "coupled_dampings": _DAMPING,
    },
    "structure_matrices": {
        "mass": _MASS, "stiffness": _STIFFNESS, "damping": _DAMPING, **_RAYLEIGH
    },
    "structure_file": _RAYLEIGH,
    "measured_modes": {
        "masses": RANGES["Specimen"]["masses"], "frequencies": _HERTZ, "damping_ratios": _RATIO
    },
}  # fmt: skip
OF_THE_SIGNAL = "of the signal"  # unit of a sensor's fields, which the signal decides


@dataclass(frozen=True)
class Field:
    """A field of a part of a scenario."""

    name: str
    kinds: tuple[Any, ...]  # types that it may have
    default: Any  # MISSING: none
    allowed: Range | None  # of the number, of each number of a list, or of both ends of a `Uniform`
    meaning: str  # as the dataclass or the constructor documents it

    @property
    def unit(self) -> str | None:
        """SI unit of the number; None where it is no number."""
        if self.allowed is not None:
            return self.allowed.unit
        return "-" if float in self.kinds else None


@cache
def fields_of(kind: Any) -> tuple[Field, ...]:
    """Return the fields of a dataclass, or the keyword parameters of a constructor.

    A parameter without a default whose name begins with an underscore is provided by the reader and is
    no field.
    """
    hints = typing.get_type_hints(kind)
    ranges = _ranges(kind)
    if isinstance(kind, type) and is_dataclass(kind):
        pairs = [(f.name, _default(f)) for f in fields(kind) if f.init]
        meanings: Mapping[str, str] = _comments(kind)
    else:
        parameters = inspect.signature(kind).parameters.values()
        pairs = [
            (p.name, MISSING if p.default is p.empty else p.default)
            for p in parameters
            if not p.name.startswith("_")
        ]
        meanings = _parameters(inspect.getdoc(kind) or "")
    return tuple(
        Field(name, union_members(hints[name]), default, ranges.get(name), meanings.get(name, ""))
        for name, default in pairs
    )


def union_members(hint: Any) -> tuple[Any, ...]:
    """Return the members of a union type, those of its members included; the type itself otherwise."""
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return tuple(kind for each in typing.get_args(hint) for kind in union_members(each))
    return (hint,)


def parts_of(kinds: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the dataclasses among the types that a scenario's field may have."""
    return tuple(kind for kind in kinds if is_dataclass(kind))


def item_kinds(kinds: tuple[Any, ...]) -> tuple[Any, ...] | None:
    """Return the types of the items of a field that is a tuple; None where it is none."""
    for kind in kinds:
        if typing.get_origin(kind) is tuple:
            return union_members(typing.get_args(kind)[0])
    return None


def _ranges(kind: Callable[..., Any]) -> Mapping[str, Range]:
    name = kind.__qualname__
    if name == "Uncertainty":
        return UNCERTAIN
    return {**RANGES.get(_SAME_RANGES.get(name, name), {}), **_FURTHER_RANGES.get(name, {})}


def _default(field: dataclasses.Field[Any]) -> Any:
    if field.default_factory is not MISSING:
        return field.default_factory()
    return field.default


def _comments(kind: type) -> dict[str, str]:
    """Return what the source says of each field: the comment on its line, or the docstring below it."""
    source = inspect.getsource(kind)
    pattern = r"^    (\w+): [^#\n]*(?:# *(.+)|\n    \"\"\"([^\"]+)\"\"\")$"
    return {name: plain_docstring(a or b) for name, a, b in re.findall(pattern, source, re.MULTILINE)}


def _parameters(docstring: str) -> dict[str, str]:
    """Return what the section ``Parameters`` of a numpy docstring says of each parameter."""
    section = re.search(r"^Parameters\n-+\n(.*?)(?=\n\n\w|\Z)", docstring, re.MULTILINE | re.DOTALL)
    pattern = r"^(\w+)\n((?:    .+\n?)+)"
    return {
        name: plain_docstring(text)
        for name, text in re.findall(pattern, section[1] if section else "", re.M)
    }


def plain_docstring(text: str) -> str:
    """Return a docstring's text on one line, without its cross-references."""
    return re.sub(r":\w+:`[~!]?([^`]+)`", r"`\1`", " ".join(text.split()))
