"""Results of the protocol as JSON files, and as the tables of a Markdown page."""

from __future__ import annotations

import json
from os import PathLike
from pathlib import Path
from typing import Any

from agents.marked_page import has_place, put
from agents.run_directory import described, read_json, write_text
from shake_env.errors import FileError

PREFIX = "evaluation_"  # of a result's file name in docs/results
COLUMNS = (
    "controller", "runs", "cost / {yardstick}", "IQM", "worst 5 %", "cost / {reference}",
    "P(better than {reference})", "shear % rms", "accel. % rms", "failures", "us",
)  # fmt: skip


def write_result(result: dict[str, Any], file: str | PathLike[str]) -> None:
    """Write a result; a reader never sees half of it."""
    file = Path(file)
    write_text(file, _dumps(result))


def _dumps(result: dict[str, Any]) -> str:
    """Return JSON with the episodes of a run on one line, so that a result is a page and not a roll."""
    long = {"episodes": result["episodes"], "earthquakes": result["earthquakes"]}
    rest = {key: value for key, value in result.items() if key not in long}
    head = json.dumps(rest, indent=1)[:-2]
    tail = ",\n".join(f' "{key}": {json.dumps(value)}' for key, value in long.items())
    return f"{head},\n{tail}\n}}\n"


def read_result(file: Path) -> dict[str, Any]:
    """Return the result that a file holds.

    Raises
    ------
    FileError
        If it is missing, not complete or no result of the protocol.
    """
    result = read_json(file)
    lacks = [key for key in _KEYS if key not in result]
    for row in result.get("rows", ()) if not lacks else ():
        name = row.get("controller") if isinstance(row, dict) else None
        if name not in result["episodes"] or not set(_ROW) <= set(row):
            lacks.append(f"rows.{name}")
    if lacks:
        remedy = f"is no complete result of shake evaluate (see {described(lacks)}): make it anew"
        raise FileError("file", str(file), remedy)
    return result


_KEYS = (
    "format", "scenario", "version", "seed", "earthquakes", "reference", "yardstick", "optimal_cost",
    "rows", "episodes",
)  # fmt: skip
_ROW = (
    "controller", "runs", "sources", "relative_cost", "interquartile_mean", "worst_twentieth",
    "reference_cost", "probability_of_improvement", "base_shear_rms_error", "acceleration_rms_error",
    "failures", "episodes", "decision_time", "code", "machine",
)  # fmt: skip


def read_results(folder: str | PathLike[str]) -> dict[str, dict[str, Any]]:
    """Return the results of a folder by the name of their files, without its prefix.

    Raises
    ------
    FileError
        If one is not complete.
    """
    folder = Path(folder)
    return {
        file.stem.removeprefix(PREFIX): read_result(file)
        for file in sorted(folder.glob(f"{PREFIX}*.json"))
    }


def markdown(result: dict[str, Any]) -> str:
    """Return a result as a Markdown table with what is needed to read it."""
    same = result["yardstick"] == result["reference"]
    head = [column.format(**result) for column in COLUMNS]
    names = ["drift_error", "energy_error", "regret_closed", "optimality"]
    shown = [name for name in names if any(row[name] is not None for row in result["rows"])]
    titles = {"regret_closed": "regret closed %", "optimality": "cost / J*"}
    head[8:8] = [titles.get(name, f"{name.removesuffix('_error')} off % (median)") for name in shown]
    if same:
        del head[5]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for row in ranked(result):
        cells = [
            row["controller"],
            str(row["runs"]) if row["sources"] else "-",
            _cost(row["relative_cost"]),
            _cost(row["interquartile_mean"]),
            _cost(row["worst_twentieth"]),
            *([] if same else [_cost(row["reference_cost"])]),
            interval(row["probability_of_improvement"], 2),
            interval(row["base_shear_rms_error"], 2, 100.0),
            *(interval(row[n], 3 if n == "optimality" else 1, _scale(n)) for n in shown),
            interval(row["acceleration_rms_error"], 1, 100.0),
            f"{row['failures']} of {row['episodes']}",
            "-" if row["decision_time"] is None else f"{1e6 * row['decision_time']:.0f}",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    seed = "recorded" if result["seed"] is None else f"seeds from {result['seed']}"
    optimum = result["optimal_cost"]
    codes = dict.fromkeys(str(row["code"]) for row in result["rows"])
    machines = dict.fromkeys(str(row["machine"]) for row in result["rows"])
    lines += [
        "",
        f"{len(result['earthquakes'])} earthquakes, {seed}; version {result['version']} "
        f"({', '.join(codes)}), {'; '.join(machines)}."
        + ("" if optimum is None else f" J* = {optimum:.6g}."),
    ]
    return "\n".join(lines) + "\n"


def _cost(found: dict[str, float]) -> str:
    return interval(found, 3 if found["high"] < 10.0 else 1)


def _scale(name: str) -> float:
    return 1.0 if name == "optimality" else 100.0


def ranked(result: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the rows by cost, the yardstick first."""
    first = result["yardstick"]
    return sorted(result["rows"], key=lambda r: (r["controller"] != first, r["relative_cost"]["value"]))


def interval(found: dict[str, float] | None, digits: int, scale: float = 1.0) -> str:
    """Return ``value [low, high]``; the value alone where there is no interval, a dash for None."""
    if found is None:
        return "-"
    value, low, high = (f"{scale * found[key]:.{digits}f}" for key in ("value", "low", "high"))
    return value if low == value == high else f"{value} [{low}, {high}]"


def put_tables(page: str | PathLike[str], results: dict[str, dict[str, Any]]) -> list[str]:
    """Put the tables of results into a page, each at ``<!-- evaluation NAME -->``.

    Returns
    -------
    Names of results that the page has no place for.

    Raises
    ------
    ParameterError
        If a place has no end; see `marked_page.put`.
    """
    page = Path(page)
    missing = []
    for name, result in results.items():
        if has_place(page, f"evaluation {name}"):
            put(page, f"evaluation {name}", markdown(result), end=name)
        else:
            missing.append(name)
    return missing
