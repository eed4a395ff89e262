"""The classical controllers on every named scenario, as result files and tables in the docs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, fields
from os import PathLike
from pathlib import Path
from typing import Any

import shake_env
from agents.evaluation.bound import causal_bound
from agents.evaluation.comparison import compare
from agents.evaluation.controller_set import ALL, values_to_json
from agents.evaluation.results import Comparison, GroupSummary
from agents.plain_values import plain_row
from agents.policies.registry import ORACLE
from agents.provenance import machine
from agents.run_directory import names_in_words, read_json
from agents.seeds import TEST_SEED
from baselines.registry import reference_name
from baselines.tuned_values import TunedValues
from shake_env import make_scenario
from shake_env.errors import FileError, ParameterError
from shake_env.model.parameters import is_number
from shake_env.scenario.scenario_file import is_scenario_file, scenario_fields

SCENARIOS = ("linear", "laboratory", "unknown-specimen", "yielding", "records")
CONTROLLERS = (ORACLE, ALL)


def run_benchmark(
    scenario_name: str,
    earthquakes: int,
    names: Sequence[str] = CONTROLLERS,
    tuned: TunedValues | None = None,
    on_progress: Callable[[str, float], None] = lambda controller, share: None,
) -> dict[str, Any]:
    """Return the result of all controllers on test earthquakes of a scenario, as plain JSON values.

    Parameters
    ----------
    scenario_name
        A named scenario, or a scenario file.
    earthquakes
        Number of filtered-noise earthquakes; `records` are run on the six records instead.
    names
        As for `compare`.
    tuned
        Tuned values of a file that was named; see `baselines.registry.parameter_values`.
    on_progress
        Told the controller that runs, or ``bound``, and its share done, 0 to 1.
    """
    if earthquakes < 2:
        raise ParameterError("earthquakes", earthquakes, "an interval needs at least 2")
    scenario = make_scenario(scenario_name)
    recorded = scenario.reserved_for_testing
    comparison = compare(
        scenario,
        names,
        noise=0 if recorded else earthquakes,
        records=recorded,
        seed=TEST_SEED,
        tuned=tuned,
        bound=True,
        on_progress=on_progress,
    )
    return {
        "scenario": scenario_label(scenario_name),
        "fields": _file_fields(scenario_name),
        "version": shake_env.__version__,
        "machine": machine(),
        "seed": None if recorded else TEST_SEED,
        "reference": reference_name(scenario),
        "information": comparison.information,
        "bound": comparison.bound_to_json(),
        "causal_bound": causal_bound(scenario),
        "controllers": list(names),
        "skipped": comparison.skipped,
        "warnings": comparison.warnings,
        "values": values_to_json(comparison.values),
        "rows": [plain_row(asdict(row)) for row in ranked_summaries(comparison)],
    }


def ranked_summaries(comparison: Comparison) -> list[GroupSummary]:
    """Return a benchmark's summaries by cost, no control last."""
    return sorted(comparison.summaries, key=lambda row: (row.controller == "none", row.relative_cost))


def scenario_label(scenario_name: str) -> str:
    """Return what a scenario's benchmark is called: its name, or that of its file without the ending."""
    return Path(scenario_name).stem if is_scenario_file(scenario_name) else scenario_name


def _file_fields(scenario_name: str) -> dict[str, Any] | None:
    """Return every field of a scenario from a file; None of a named one, which its name stands for."""
    if not is_scenario_file(scenario_name):
        return None
    return scenario_fields(make_scenario(scenario_name))


def result_file(folder: str | PathLike[str], scenario_name: str) -> Path:
    """Return the file of a scenario's benchmark, by its name or its own file."""
    return Path(folder) / f"bench_{scenario_label(scenario_name)}.json"


def read_benchmark(file: str | PathLike[str]) -> dict[str, Any]:
    """Return the result of a benchmark that a file holds.

    Raises
    ------
    FileError
        If it is missing, not complete or no result of :func:`run_benchmark`.
    """
    file = Path(file)
    result = read_json(file)
    result = _ADDED | result
    lacks = [key for key in _KEYS if key not in result]
    rows: Any = result.get("rows")
    if not lacks and not (isinstance(rows, list) and rows and all(isinstance(r, dict) for r in rows)):
        lacks = ["rows"]
    for row in () if lacks else rows:
        for name in _ADDED_FIGURES:
            row.setdefault(name, "-" if name in _WORDS else None)
        lacks += [f"rows.{f.name}" for f in fields(GroupSummary) if not _fits(row, f.name)]
    if lacks:
        parts = names_in_words(dict.fromkeys(lacks))
        remedy = f"is no complete result of shake benchmark (see {parts}): run it with --rerun"
        raise FileError("file", str(file), remedy)
    return result


_KEYS = ("scenario", "version", "machine", "seed", "reference", "skipped", "rows")
_ADDED = {"information": "", "bound": None, "causal_bound": None}  # by versions after the first
_WORDS = ("controller", "group", "information")
# What is not defined for some controllers: a lag of a still table, a decision made beforehand.
_OPTIONAL = (
    "delay", "spectral_error", "arias_ratio", "drift_ratio", "energy_ratio", "decision_time", "damage",
    "bound_cost", "bound_cost_low", "bound_cost_high", "regret_closed",
)  # fmt: skip
_ADDED_FIGURES = ("information", *_OPTIONAL[-4:])  # of a row, likewise


def _fits(row: dict[str, Any], name: str) -> bool:
    value = row.get(name, row)
    if value is None:
        return name in _OPTIONAL
    return isinstance(value, str) if name in _WORDS else is_number(value)


def read_benchmarks(folder: str | PathLike[str]) -> list[dict[str, Any]]:
    """Return the benchmarks that a folder holds, in the order of `SCENARIOS`.

    Raises
    ------
    FileError
        If one is not complete.
    """
    folder = Path(folder)
    files = [result_file(folder, name) for name in SCENARIOS]
    return [read_benchmark(file) for file in files if file.exists()]


def difference_of_result(
    known: dict[str, Any], scenario_name: str, asked: int, names: Sequence[str], tuned: Path | None
) -> str:
    """Return in what a benchmark's result differs from what is asked for, in words; empty: in nothing.

    Parameters
    ----------
    known
        A result of `run_benchmark`.
    scenario_name
        The scenario that is asked for, or its file.
    asked
        Number of earthquakes.
    names
        Of the controllers.
    tuned
        File of tuned values that is named.
    """
    number = known["rows"][0]["earthquakes"]
    if known["scenario"] != scenario_label(scenario_name):
        return f"is of {known['scenario']}, not {scenario_label(scenario_name)}"
    if known.get("fields") != _file_fields(scenario_name):
        return f"is of another scenario that is called {scenario_label(scenario_name)}, too"
    if known["seed"] is not None and number != asked:
        return f"was made with {number} earthquakes, not {asked}"
    before = known.get("controllers", list(CONTROLLERS))
    if before != list(names):
        return f"was made with the controllers {' '.join(before)}, not {' '.join(names)}"
    sources = {each["source"] for each in known.get("values", {}).values()}
    if tuned is not None or "file" in sources:
        return "was made with other tuned values, or with values that may have changed"
    return ""
