"""Writing a scenario as a TOML file: complete and commented, or into a file whose comments stay."""

from __future__ import annotations

import inspect
import json
import math
import os
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, is_dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

from shake_env.errors import FileError, ParameterError
from shake_env.files import write_text
from shake_env.motion.targets import RecordedMotion
from shake_env.records import Record, write_record
from shake_env.scenario.builder import NONE
from shake_env.scenario.field_paths import Steps
from shake_env.scenario.field_table import OF_THE_SIGNAL, Field, fields_of, item_kinds, plain_docstring
from shake_env.scenario.forms import recorded_file
from shake_env.scenario.observation import UNITS, Sensor
from shake_env.scenario.quantities import format_quantity, is_unit
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.scenario_file import SCHEMA, WHOLE, parse_toml, read_scenario
from shake_env.scenario.uncertainty import Uniform

SCHEMA_FILE = "scenario.schema.json"
# Fields of a scenario by the file that they stand in where a scenario is written in parts; the rest
# stands in the last one.
PARTS: Mapping[str, tuple[Steps, ...]] = {
    "table": (
        ("table",), ("actuator",), ("current_limit",), ("delay",), ("limits",),
        ("nonlinearity", "friction"), ("nonlinearity", "valve"), ("nonlinearity", "stops"),
    ),
    "specimen": (("specimen",), ("nonlinearity", "yielding")),
    "sensors": (("sensing",),),
    "test": ((),),
}  # fmt: skip
_HEADING = """\
#:schema ./{schema}
# Numbers are in SI, or quantities with a unit ("70 mm"); "none" leaves out what may be left out.
schema = {version}
"""


@dataclass
class _Section:
    """A table of a TOML file."""

    steps: Steps
    heading: str
    about: str  # comment above the heading
    lines: list[str] = field(default_factory=list)


def scenario_toml(scenario: Scenario, record_file: Callable[[Record], str] | None = None) -> str:
    """Return a scenario as the text of a complete, commented TOML file.

    Parameters
    ----------
    scenario
        What to write.
    record_file
        Returns the path of a file for a record that is not one of the package's; None refuses those.
    """
    return _heading() + _text(_sections(scenario, record_file))


def write_scenario(
    scenario: Scenario, file: str | os.PathLike[str], *, parts: bool = False
) -> list[Path]:
    """Write a scenario as a TOML file, and return the paths of the files that were written.

    A file that is there already keeps its comments and its order: values that differ are changed in it.
    Beside it stand the schema that editors read and recorded motions that are not the package's own.

    Parameters
    ----------
    scenario
        What to write.
    file
        The file, which ends in ``.toml``.
    parts
        Whether table, specimen, sensors and test are written to a file each, which this one includes.

    Raises
    ------
    ParameterError
        If the file's name does not end in ``.toml``.
    FileError
        If it cannot be written.
    ScenarioError, ParameterError
        If the file is there already and is no scenario.
    """
    file = Path(file)
    if file.suffix != ".toml":
        raise ParameterError("write", str(file), "must end in .toml")
    written: list[Path] = []
    records: dict[Record, str] = {}

    def record_file(record: Record) -> str:
        if record not in records:
            path = file.with_name(f"{file.stem}_record_{len(records) + 1}.csv")
            written.append(write_record(record, path))
            records[record] = path.name
        return records[record]

    if file.exists():
        texts = {file: _updated(scenario, file, record_file)}
    elif parts:
        texts = _parts(scenario, file, record_file)
    else:
        texts = {file: scenario_toml(scenario, record_file)}
    schema = resources.files(__package__).joinpath(SCHEMA_FILE).read_text(encoding="utf-8")
    for path, text in {**texts, file.with_name(SCHEMA_FILE): schema}.items():
        if not path.exists() or path.read_bytes() != text.encode():
            write_text(path, text)
            written.append(path)
    return written


def _heading() -> str:
    return _HEADING.format(schema=SCHEMA_FILE, version=SCHEMA)


def _parts(scenario: Scenario, file: Path, record_file: Callable[[Record], str]) -> dict[Path, str]:
    """Return the texts of a scenario in parts, by their paths."""
    names = {part: f"{file.stem}_{part}.toml" for part in PARTS}
    texts = {
        file: f"{_heading()}include = {json.dumps([*names.values()])}\nname = {_word(scenario.name)}\n"
    }
    for path in (file.with_name(name) for name in names.values()):
        if path.exists():
            raise FileError(str(path), "is there already", "take it away, or choose another name")
    sections = _sections(scenario, record_file)
    for part, name in names.items():
        texts[file.with_name(name)] = _heading() + _text(_of_part(sections, part))
    return texts


def _of_part(sections: list[_Section], part: str) -> list[_Section]:
    """Return the sections, and the lines of the first one, that stand in the file of a part."""

    def home(steps: Steps) -> str:
        return next(p for p, owned in PARTS.items() if any(steps[: len(o)] == o for o in owned))

    chosen = []
    for section in sections:
        own = [
            line
            for line in section.lines
            if home((*section.steps, line.partition(" ")[0])) == part
            and (section.steps or not line.startswith("name "))
        ]
        if own:
            chosen.append(replace(section, lines=own))
    return chosen


def _text(sections: list[_Section]) -> str:
    blocks = []
    for section in sections:
        heading = f"\n# {section.about}\n{section.heading}\n" if section.heading else ""
        blocks.append(heading + "".join(f"{line}\n" for line in section.lines))
    return "".join(blocks)


def _sections(scenario: Scenario, record_file: Callable[[Record], str] | None) -> list[_Section]:
    """Return the tables of a scenario's file in order; those without lines are left out."""
    root = _Section((), "", "")
    sections = [root, *_fill(root, scenario, "", record_file)]
    return [section for section in sections if section.lines or section.heading.startswith("[[")]


def _fill(
    section: _Section, part: Any, unit: str, record_file: Callable[[Record], str] | None
) -> Iterator[_Section]:
    """Write the fields of a part into its section, and yield the sections of its own parts.

    `unit` is that of a sensor's signal.
    """
    kind: Any = type(part)
    for about in fields_of(kind):
        value = getattr(part, about.name)
        steps = (*section.steps, about.name)
        items = item_kinds(about.kinds)
        if is_dataclass(value) and not isinstance(value, Uniform):
            yield from _part(steps, value, "", record_file)
        elif items is not None and Sensor in items and value is not None:
            for sensor in value:
                yield from _part((*steps, sensor.signal), sensor, UNITS[sensor.signal], record_file)
        elif items is not None and any(is_dataclass(kind) for kind in items) and value is not None:
            for number, item in enumerate(value):
                yield from _part((*steps, number), item, "", record_file)
        elif not (isinstance(part, Sensor) and about.name == "signal"):
            section.lines.append(_line(about, value, unit))


def _part(
    steps: Steps, part: Any, unit: str, record_file: Callable[[Record], str] | None
) -> Iterator[_Section]:
    names = ".".join(str(step) for step in steps if isinstance(step, str))
    listed = isinstance(steps[-1], int)
    about = plain_docstring((inspect.getdoc(type(part)) or "").split("\n\n")[0]).replace("None", NONE)
    section = _Section(steps, f"[[{names}]]" if listed else f"[{names}]", about)
    if isinstance(part, RecordedMotion) and isinstance(part.record, Record):
        if record_file is None:
            raise FileError(
                "motion.record", part.record.name, "is in no file: write the scenario to one"
            )
        if listed:
            yield section
        form = _Section(
            (*steps, "file"),
            f"[{names}.file]",
            plain_docstring(recorded_file.__doc__ or "").split(";")[0],
        )
        known = {"path": record_file(part.record), "name": part.record.name, "scale_to_table": False}
        for each in fields_of(recorded_file):
            value = known.get(each.name, getattr(part, each.name, each.default))
            form.lines.append(_line(each, value, ""))
        yield form
        return
    sections = [*_fill(section, part, unit, record_file)]
    yield section
    yield from sections


def _line(about: Field, value: Any, signal_unit: str) -> str:
    unit = about.unit or ""
    unit = signal_unit if unit == OF_THE_SIGNAL else unit
    comment = f"  # {about.meaning.replace('None', NONE)}" if about.meaning else ""
    return f"{about.name} = {_written(value, unit)}{comment}"


def _written(value: Any, unit: str) -> str:
    """Return a value in TOML; numbers with their unit, so that they read back to the last bit."""
    if value is None:
        return f'"{NONE}"'
    if isinstance(value, str):
        return _word(value)
    if isinstance(value, Uniform):
        value = (value.low, value.high)
    if isinstance(value, tuple):
        return "[" + ", ".join(_written(item, unit) for item in value) + "]"
    number = value.item() if hasattr(value, "item") else value  # numpy's
    if isinstance(number, bool):
        return str(number).lower()
    if not math.isfinite(number):
        return "inf" if number > 0 else "-inf"
    return (
        f'"{format_quantity(number, unit)}"' if unit not in ("", "-") and is_unit(unit) else repr(number)
    )


def _word(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


# Into a file that is there


def _updated(scenario: Scenario, file: Path, record_file: Callable[[Record], str]) -> str:
    """Return the text of a file with the values of a scenario; its comments and its order stay."""
    import tomlkit  # not needed for reading

    text = file.read_bytes().decode("utf-8-sig")
    values, new = _values(read_scenario(file)), _values(scenario)
    if values == new:
        return text
    document = tomlkit.parse(text)
    for (name,) in WHOLE:  # what the file itself says there holds alone, so that all is said there
        if values[name] == new[name]:
            continue
        if not _in_place(document.get(name, {}), values[name], new[name]):
            sections = [s for s in _sections(scenario, record_file) if s.steps[:1] == (name,)]
            document[name] = tomlkit.parse(_text(sections))[name]
            values[name] = new[name]
        elif "file" in new[name]:  # say what the file may leave to the reader
            for field_name in ("name", "amplitude", "scale_to_table"):
                del values[name]["file"][field_name]
    if "name" not in document and new["name"] == file.stem:
        values["name"] = file.stem
    _change(document, values, new)
    changed = tomlkit.dumps(document)
    if _values(parse_toml(file, changed)) != new:
        raise FileError(str(file), scenario.name, "cannot be changed in place: write to a new file")
    return changed


def _in_place(own: Mapping[str, Any], old: dict[str, Any], new: dict[str, Any]) -> bool:
    """Return whether a section of a file has the fields of the new one, so that values can change."""
    same = set(own) == set(old) == set(new) and old.get("motions") == new.get("motions")
    return same and old.get("file", {}).get("path") == new.get("file", {}).get("path")


def _values(scenario: Scenario) -> dict[str, Any]:
    """Return what a scenario's file says; a record goes by its samples."""

    def samples(record: Record) -> str:
        return f"{record.digest.hex()} {record.sampling_interval!r}"

    return tomllib.loads(scenario_toml(scenario, samples))


def _change(table: Any, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    """Set in a table what differs between the values that it has and those that it is to have."""
    import tomlkit

    for name in [name for name in old if name not in new]:
        table[name] = NONE  # a sensor, or a part that is left out
    for name, value in new.items():
        if isinstance(value, dict) and isinstance(old.get(name, {}), dict):
            if value != old.get(name):
                if name not in table:
                    table[name] = tomlkit.table()
                _change(table[name], old.get(name, {}), value)
        elif name not in old or old[name] != value:
            table[name] = value
