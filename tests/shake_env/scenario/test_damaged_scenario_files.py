"""Damaged scenario files: read rightly, or refused with file, line and field; never another error."""

import re
from functools import cache

import numpy as np
import pytest
from random_scenarios import random_scenario

from shake_env.errors import ShakeError
from shake_env.scenario.field_table import fields_of
from shake_env.scenario.observation import Sensor
from shake_env.scenario.presets import NAMED
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.scenario_file import parse_toml
from shake_env.scenario.scenario_writer import scenario_toml

WORDS = ("name", "table", "train_on", "record")  # fields that are texts
UNITS = ("kg", "m", "Pa", "s", "A", "N s/m", "m^3", "m/s^2", "kelvin", "mm^9")
BYTES = tuple("\"#=[]{}.,-+0129eE_ \n\t\\'abc\x00\x7f\xe9")


@cache
def lines_of(text):
    """Index of every line that gives a field, with the field's path and its value as it is written."""
    section, arrays, found = "", {}, []
    for index, line in enumerate(text.split("\n")):
        heading = re.fullmatch(r"(\[+)([\w.-]+)\]+", line)
        if heading:
            section = heading[2] + "."
            if heading[1] == "[[":
                arrays[heading[2]] = arrays.get(heading[2], -1) + 1
                section = f"{heading[2]}[{arrays[heading[2]]}]."
        elif (pair := re.match(r"(\w+) = (.*?)(?:  # .*)?$", line)) and pair[1] != "schema":
            found.append((index, section + pair[1], pair[2]))
    return found


def with_line(text, index, *lines):
    every = text.split("\n")
    return "\n".join([*every[:index], *lines, *every[index + 1 :]])


def mutated(text, stream):
    """Return a damaged text, and what its error must name: line and field, line alone, or nothing."""
    index, path, value = lines_of(text)[int(stream.integers(len(lines_of(text))))]
    name, line = path.rpartition(".")[2], text.split("\n")[index]
    number = re.search(r'"(\S+) ([^"]+)"', value)
    kind = int(stream.integers(9))
    if kind == 0:  # a misspelt name
        cut = int(stream.integers(len(name)))
        wrong = name[:cut] + name[cut + 1 :] + "x"
        return with_line(text, index, line.replace(name, wrong, 1)), (index, path[: -len(name)] + wrong)
    if kind == 1 and number and name not in WORDS:  # the unit of another quantity
        unit = str(stream.choice([u for u in UNITS if u[-1] != number[2][-1]]))
        return with_line(text, index, line.replace(number[0], f'"{number[1]} {unit}"', 1)), (index, path)
    if kind == 2 and name not in WORDS:  # another type
        wrong = str(stream.choice(["1979-05-27", '"many"', "[[1]]", "{ a = 1 }", '[true, "x"]', "[]"]))
        if wrong != "[]" or not value.startswith("["):
            return with_line(text, index, f"{name} = {wrong}"), (index, path)
    if kind == 3 and name not in WORDS and value not in ("true", "false"):  # far out of range
        wrong = '"-1e30"' if stream.integers(2) else "-1e30"
        if not value.startswith("["):
            return with_line(text, index, f"{name} = {wrong}"), (index, path)
    if kind == 4:  # said twice
        return with_line(text, index, line, line), (index + 1, "")
    if kind == 5:  # left out
        return with_line(text, index), None
    if kind == 6:  # a part of the text is lost
        start, length = int(stream.integers(len(text))), int(stream.integers(1, 200))
        return text[:start] + text[start + length :], None
    characters = list(text)  # some characters are others
    for _ in range(int(stream.integers(1, 6))):
        characters[int(stream.integers(len(characters)))] = str(stream.choice(BYTES))
    return "".join(characters), None


def check(text, stream, folder):
    damaged, named = mutated(text, stream)
    file = folder / "mine.toml"
    try:
        scenario = parse_toml(file, damaged)
    except ShakeError as error:
        message = str(error)
        assert message.startswith(str(file)), message
        if named is not None:
            index, path = named
            assert message.startswith(f"{file}, line {index + 1}"), (message, named, damaged)
            assert not path or f", {path}" in message, (message, named)
        return "refused"
    assert named is None, (named, damaged)
    assert parse_toml(file, scenario_toml(scenario)) == scenario
    return "read"


def texts(number, seed):
    """The texts of the named scenarios, and of random ones whose records are the package's."""
    found = [scenario_toml(make()) for make in NAMED.values()]
    stream = np.random.default_rng(seed)
    while len(found) < number:
        try:
            found.append(scenario_toml(random_scenario(stream)))
        except ShakeError:  # it holds a record that is in no file
            continue
    return found


def check_many(number, seed, folder):
    stream = np.random.default_rng(seed)
    known = texts(12, seed)
    outcomes = [check(known[i % len(known)], stream, folder) for i in range(number)]
    assert 0.1 < outcomes.count("read") / number < 0.6
    return outcomes


def test_damaged_files_are_read_or_refused_by_line_and_field(tmp_path):
    check_many(100, 1, tmp_path)


@pytest.mark.slow
def test_many_damaged_files_are_read_or_refused_by_line_and_field(tmp_path):
    check_many(20_000, 2, tmp_path)


def test_the_lines_of_a_file_are_those_of_its_fields():
    found = lines_of(scenario_toml(NAMED["records"]()))
    assert {"actuator.table_mass", "motion.motions[5].record", "control_rate"} <= {
        p for _, p, _ in found
    }
    names = {path.split(".")[-1] for _, path, _ in found}
    assert {each.name for each in fields_of(Sensor)} - {"signal"} <= names
    assert len(found) > 100 and {"delay", "name"} <= names & {f.name for f in fields_of(Scenario)}
