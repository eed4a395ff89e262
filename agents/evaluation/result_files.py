"""Result files of the evaluation protocol: written whole, read with every field checked."""

from __future__ import annotations

import json
from os import PathLike
from pathlib import Path
from typing import Any

from agents.run_directory import names_in_words, read_json
from shake_env.errors import FileError
from shake_env.files import write_text
from shake_env.renamed import RESULT_KEYS

PREFIX = "evaluation_"  # of a result's file name in docs/results


def write_result(result: dict[str, Any], file: str | PathLike[str]) -> None:
    """Write a result of the evaluation protocol; a reader never sees half of it."""
    file = Path(file)
    write_text(file, _dumps(result))


def _dumps(result: dict[str, Any]) -> str:
    """Return JSON with the episodes of a run on one line, which keeps a result readable."""
    long = {"episodes": result["episodes"], "earthquakes": result["earthquakes"]}
    rest = {key: value for key, value in result.items() if key not in long}
    head = json.dumps(rest, indent=1)[:-2]
    tail = ",\n".join(f' "{key}": {json.dumps(value)}' for key, value in long.items())
    return f"{head},\n{tail}\n}}\n"


def read_result(file: str | PathLike[str]) -> dict[str, Any]:
    """Return the result of the evaluation protocol that a file holds.

    Raises
    ------
    FileError
        If it is missing, not complete or no result of the protocol.
    """
    file = Path(file)
    result = {RESULT_KEYS.get(key, key): value for key, value in read_json(file).items()}
    lacks = [key for key in _KEYS if key not in result]
    for row in result.get("rows", ()) if not lacks else ():
        name = row.get("controller") if isinstance(row, dict) else None
        if name not in result["episodes"] or not set(_ROW) <= set(row):
            lacks.append(f"rows.{name}")
    if lacks:
        remedy = f"is no complete result of shake evaluate (see {names_in_words(lacks)}): make it anew"
        raise FileError("file", str(file), remedy)
    return result


_KEYS = (
    "format", "scenario", "version", "seed", "earthquakes", "reference", "normaliser", "optimal_cost",
    "rows", "episodes",
)  # fmt: skip


_ROW = (
    "controller", "runs", "sources", "relative_cost", "interquartile_mean", "worst_twentieth",
    "reference_cost", "probability_of_improvement", "base_shear_rms_error", "acceleration_rms_error",
    "failures", "episodes", "decision_time", "code", "machine",
)  # fmt: skip


def read_results(folder: str | PathLike[str]) -> dict[str, dict[str, Any]]:
    """Return the protocol's results of a folder by the name of their files, without its prefix.

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
