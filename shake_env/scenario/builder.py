"""Parts of a scenario made of what is asked by field paths: on a command line, in a call or a file."""

from __future__ import annotations

import types
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from shake_env.errors import ParameterError, ScenarioError, ShakeError, unknown
from shake_env.model.parameters import Specimen
from shake_env.model.ranges import RANGES, Range, is_number
from shake_env.records import Record
from shake_env.scenario.field_paths import NOTHING, Node, nodes_of
from shake_env.scenario.field_table import (
    MISSING,
    OF_THE_SIGNAL,
    Field,
    fields_of,
    item_kinds,
    parts_of,
)
from shake_env.scenario.forms import FORMS, FormContext
from shake_env.scenario.observation import UNITS, Sensor
from shake_env.scenario.quantities import QuantityError, to_si
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uniform

# Fields that joined a part after JSON files of it were written: files without them are read.
LATER_FIELDS: dict[str, tuple[str, ...]] = {
    "Scenario": ("table",),
    "Specimen": ("coupled_masses", "coupled_stiffnesses", "coupled_dampings"),
}
NONE = "none"  # word for a value that is left out, where a field may have None


def with_fields(value: Any, changes: Mapping[str, Any]) -> Any:
    """Return a frozen value with fields changed by their paths, checked as at construction.

    Parameters
    ----------
    value
        A frozen dataclass, such as a `Scenario`.
    changes
        Path to new value. A path names nested fields with dots; sensors go by their signal, as in
        ``sensing.sensors.load_pressure.noise``, and None takes one away. A quantity in words
        (``"70 mm"``) is converted to SI. Two numbers make a `Uniform` range where one is expected, and
        a mapping of fields makes a part that is None so far. Fields of one part are changed together.
        Of a specimen with equal storeys, one of ``masses``, ``stiffnesses`` and ``dampings`` decides
        the number of storeys; the others are continued with their value.

    Raises
    ------
    ScenarioError
        If a path leads nowhere, or a value has another type than its field.
    ParameterError
        If a value is outside its range.
    """
    return Builder().part((type(value),), nodes_of(changes), value)


class Builder:
    """Makes frozen values of what is asked of their fields.

    Parameters
    ----------
    complete
        Whether every field must be given, as plain values: quantities in words and forms are refused.
    """

    def __init__(self, *, complete: bool = False) -> None:
        self._complete = complete
        self._scenario: Scenario | None = None  # with every part but its motion
        self._actuator: Any = None
        self._physics_step: float | None = None

    def field(self, about: Field, node: Node, old: Any, inherited: Range | None = None) -> Any:
        """Return a field's value.

        Parameters
        ----------
        about
            The field.
        node
            What is asked of it.
        old
            Its value so far, which holds where nothing else is asked.
        inherited
            Range of numbers that have none of their own: the ends of a `Uniform`, or a sensor's.
        """
        allowed = about.allowed or inherited
        if allowed is not None and allowed.unit == OF_THE_SIGNAL and inherited is not None:
            allowed = replace(allowed, unit=inherited.unit)
        if node.value is not NOTHING:
            old = self._value(about.kinds, node.value, allowed, node)
        if not node.parts:
            return old
        items, parts = item_kinds(about.kinds), parts_of(about.kinds)
        if items is not None and Sensor in items:
            return self._sensors(node, old)
        if items is not None and parts_of(items):
            return self._sequence(Field("", items, MISSING, None, ""), node, old)
        if not parts:
            named = next(iter(node.parts.values())).place
            raise ScenarioError(named, node.given(), f"{about.name} has no fields")
        return self.part(parts, node, old, allowed)

    def part(self, kinds: tuple[Any, ...], node: Node, old: Any, inherited: Range | None = None) -> Any:
        """Return a part, one of `kinds`, with what is asked of its fields."""
        forms = {name: make for kind in kinds for name, make in FORMS.get(kind, {}).items()}
        chosen = [] if self._complete else [name for name in node.parts if name in forms]
        if chosen:
            return self._formed(forms, chosen[0], node)
        kind = _nearest(kinds, node, old)
        if kind is Specimen:
            self._continue_storeys(node, old)
        fields = {about.name: about for about in fields_of(kind)}
        known = {*fields, *forms, *(about.name for each in kinds for about in fields_of(each))}
        for name, part in node.parts.items():
            if name not in fields:
                raise _unknown_field(part, known)
        start = old if type(old) is kind and not self._complete else None
        new: dict[str, Any] = {}
        for name in sorted(fields, key=("specimen", "motion").__contains__):
            if name not in node.parts:
                needed = self._complete and name not in LATER_FIELDS.get(kind.__name__, ())
                if start is None and (needed or fields[name].default is MISSING):
                    place = _joined(node, name)
                    raise ScenarioError(place, None, "is missing: every field must be there")
                continue
            default = None if fields[name].default is MISSING else fields[name].default
            previous = default if start is None else getattr(start, name)
            if kind is Scenario and start is not None:
                self._actuator = new.get("actuator", start.actuator)
                self._physics_step = new.get("physics_step", start.physics_step)
                if name == "motion":
                    start = self._scenario = _made(replace, node, start, **new)
                    new = {}
            new[name] = self.field(fields[name], node.parts[name], previous, inherited)
        return _made(kind, node, **new) if start is None else _made(replace, node, start, **new)

    def _formed(self, forms: Mapping[str, Callable[..., Any]], name: str, node: Node) -> Any:
        """Return a part that is given by one of its other forms."""
        if len(node.parts) > 1:
            others = [str(other) for other in node.parts if other != name]
            raise ScenarioError(
                node.place, [name, *others], f"is given by {name} or by other fields, and not by both"
            )
        if self._actuator is None:
            raise ScenarioError(node.place, name, "can be given as a part of a scenario only")
        form, make = node.parts[name], forms[name]
        if not form.parts:
            raise ScenarioError(form.place, form.value, "must have fields")
        fields = {about.name: about for about in fields_of(make)}
        for part_name, part in form.parts.items():
            if part_name not in fields:
                raise _unknown_field(part, set(fields))
        missing = [n for n, about in fields.items() if about.default is MISSING and n not in form.parts]
        if missing:
            raise ScenarioError(form.place, form.given(), f"needs {', '.join(missing)}, too")
        values = {each: self.field(fields[each], part, None) for each, part in form.parts.items()}
        folder = Path() if node.source is None else node.source.file.parent
        context = FormContext(folder, self._actuator, self._scenario)
        return _made(make, form, **values, _context=context)

    def _sensors(self, node: Node, old: Any) -> tuple[Sensor, ...] | None:
        """Return sensors by their signals: those of old that are not taken away, and new ones."""
        sensors = {sensor.signal: sensor for sensor in old or ()}
        for signal, part in node.parts.items():
            if signal not in UNITS or not isinstance(signal, str):
                error = unknown(ScenarioError, "sensor", str(signal), UNITS)
                raise ScenarioError(part.place, part.given(), error.remedy)
            if part.value is None or (part.value == NONE and not part.parts):
                sensors.pop(signal, None)
                continue
            name = part.parts.get("signal")
            if name is None:
                name = part.child("signal")
                name.value = signal
            elif name.value != signal:
                raise ScenarioError(name.place, name.value, f"must be {signal!r}")
            unit = Range(0.0, 0.0, UNITS[signal])
            sensors[signal] = self.part((Sensor,), part, sensors.get(signal), unit)
        return tuple(sensors.values())

    def _sequence(self, about: Field, node: Node, old: Any) -> tuple[Any, ...]:
        """Return parts by their places, from 0 on."""
        items = dict(enumerate(old or ()))
        for place, part in node.parts.items():
            items[place] = self.field(about, part, items.get(place))
        if sorted(items, key=str) != sorted(range(len(items)), key=str):
            raise ScenarioError(node.place, [*items], "must be numbered from [0] on, without a gap")
        return tuple(items[number] for number in range(len(items)))

    def _continue_storeys(self, node: Node, old: Any) -> None:
        """Continue lists that are not given to the number of storeys of those that are.

        Only where the storeys of the old specimen are equal in them.
        """
        if not isinstance(old, Specimen):
            return
        names = ("masses", "stiffnesses", "dampings")
        given = [node.parts[name].value for name in names if name in node.parts]
        lengths = {len(value) for value in given if isinstance(value, list | tuple | np.ndarray)}
        if len(lengths) != 1 or not (number := lengths.pop()):
            return
        for name in names:
            values = getattr(old, name)
            if name not in node.parts and len(set(values)) == 1:
                most = int(RANGES["Specimen.uniform"]["stories"].high) + 1
                node.child(name).value = values[:1] * min(number, most)

    def _value(self, kinds: tuple[Any, ...], value: Any, allowed: Range | None, node: Node) -> Any:
        """Return a value that was given as a whole, as one of `kinds`."""
        words = isinstance(value, str) and not self._complete
        if types.NoneType in kinds and (value is None or (words and value == NONE)):
            return None
        parts = parts_of(kinds)
        if Record in kinds and isinstance(value, Mapping):
            return _record(value, node)
        if isinstance(value, parts) or (bool in kinds and isinstance(value, bool | np.bool_)):
            return value
        if str in kinds and isinstance(value, str):
            return value
        if float in kinds or int in kinds:
            number = self._number(value, allowed, node) if float in kinds else value
            if is_number(number) and (float in kinds or isinstance(number, int | np.integer)):
                if allowed is not None and not allowed.holds(number):
                    raise ParameterError(node.place, value, allowed.remedy)
                return number
        if isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim == 1):
            if Uniform in kinds and len(value) == 2:
                ends = [self._value((float,), v, allowed, n) for v, n in _items(value, node)]
                return _made(Uniform, node, *ends)
            items = item_kinds(kinds)
            if items is not None:
                return tuple(self._value(items, v, allowed, n) for v, n in _items(value, node))
        if parts:
            names = " or ".join(getattr(kind, "__name__", str(kind)) for kind in parts)
            raise ScenarioError(node.place, value, f"is no {names}: name one of its fields by a dot")
        raise ScenarioError(node.place, value, f"must be {_expected(kinds, allowed)}")

    def _number(self, value: Any, allowed: Range | None, node: Node) -> Any:
        """Return what a text says as a number of the field's unit; other values as they are."""
        if not isinstance(value, str):
            return value
        if value in ("inf", "-inf"):
            return float(value)
        if self._complete:
            return value
        unit = "-" if allowed is None else allowed.unit
        try:
            if unit == "physics steps" and self._physics_step is not None and value[-1:].isalpha():
                return to_si(value, "s") / self._physics_step
            return to_si(value, unit)
        except QuantityError as error:
            raise ScenarioError(node.place, value, str(error)) from None


def _record(values: Mapping[str, Any], node: Node) -> Record:
    """Return the record of its plain values, as `scenario_fields` gives them."""
    try:
        attribution = tuple((str(key), str(text)) for key, text in values["attribution"])
        samples = np.asarray(values["acceleration"], dtype=float)
        interval = float(values["sampling_interval"])
        return Record(str(values["name"]), samples, interval, attribution)
    except (KeyError, TypeError, ValueError) as error:
        remedy = "must be an object of name, sampling_interval, attribution and acceleration"
        if isinstance(error, ShakeError):
            remedy = str(error)
        raise ScenarioError(node.place, sorted(map(str, values)), remedy) from None


def _items(values: Iterable[Any], node: Node) -> Iterator[tuple[Any, Node]]:
    """Yield the items of a list, each with its node."""
    for number, value in enumerate(values):
        yield value, Node((*node.steps, number), node.source)


def _made(make: Callable[..., Any], node: Node, *arguments: Any, **values: Any) -> Any:
    """Return what a constructor makes; its errors name file, line and path of the field."""
    try:
        return make(*arguments, **values)
    except ShakeError as error:
        nearest = node.nearest(error.field)
        place = _joined(node, error.field) if nearest is node else nearest.place
        raise type(error)(place, error.value, error.remedy) from None


def _joined(node: Node, name: str) -> str:
    """Return where a field would stand that is not given."""
    separator = "." if node.source is None else ": "
    return separator.join(filter(None, (node.place, name)))


def _nearest(kinds: tuple[Any, ...], node: Node, old: Any) -> Any:
    """Return the kind whose fields have most names in common with those that are asked for."""

    def rank(kind: Any) -> tuple[int, bool]:
        return len({about.name for about in fields_of(kind)} & set(node.parts)), type(old) is kind

    return max(kinds, key=rank)


def _unknown_field(part: Node, known: set[str]) -> ShakeError:
    name = str(part.steps[-1])
    return ScenarioError(
        part.place, part.given(), "is no field: " + unknown(ScenarioError, "", name, known).remedy
    )


def _expected(kinds: tuple[Any, ...], allowed: Range | None) -> str:
    """Return in words what a field may be."""
    unit = "" if allowed is None or allowed.unit == "-" else f" [{allowed.unit}]"
    words = {
        float: f"a number{unit}", int: "a whole number", str: "a text", bool: "true or false",
        types.NoneType: "none",
    }  # fmt: skip
    named = [words[kind] for kind in words if kind in kinds]
    items = item_kinds(kinds)
    if items is not None and not any(is_dataclass(kind) for kind in items):
        named.insert(0, f"a list of numbers{unit}")
    return " or ".join(named)
