"""CSV files: a cell of text never begins a formula; numbers stay numbers."""

import csv

import pytest

from agents.reporting.csv_file import FORMULA, csv_cell, write_csv


@pytest.mark.parametrize("mark", FORMULA)
def test_a_text_that_begins_a_formula_is_quoted(mark, tmp_path):
    text = f"{mark}cmd|' /C calc'!A0"
    write_csv(tmp_path / "a.csv", ["name", "value"], [{"name": text, "value": -1.5}])
    with (tmp_path / "a.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows == [["name", "value"], ["'" + text, "-1.5"]]


def test_numbers_none_and_plain_text_are_unchanged(tmp_path):
    row = {"a": 1e-17, "b": None, "c": "plain - text", "d": -3, "e": 'with "quotes", comma'}
    write_csv(str(tmp_path / "a.csv"), list(row), [row])
    with (tmp_path / "a.csv").open(newline="", encoding="utf-8") as file:
        values = next(iter(csv.DictReader(file)))
    assert values == {"a": "1e-17", "b": "", "c": "plain - text", "d": "-3", "e": 'with "quotes", comma'}
    assert csv_cell(float("-inf")) == float("-inf")


def test_a_missing_column_is_an_error_and_not_an_empty_cell(tmp_path):
    with pytest.raises(KeyError):
        write_csv(tmp_path / "a.csv", ["a", "b"], [{"a": 1}])
