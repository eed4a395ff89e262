"""Result files of the laboratory's studies: rows that a later call adds to."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from agents.provenance import code_version
from agents.reporting.markdown_blocks import markdown_table
from shake_env.errors import FileError
from shake_env.files import write_json
from shake_env.scenario.digest import scenario_digest
from shake_env.scenario.scenario import Scenario

SPECIMEN = ("specimen_mass", "storey_stiffness_1", "storey_stiffness_2")
TESTS = "laboratory_test_"  # stem of results that only compare what one test tells


class ResultFile:
    """A JSON file of rows, each of one data set or hidden plant, and of what they come to.

    Parameters
    ----------
    path
        The file; None: nothing is kept.
    command
        What makes it.
    scenario
        Of the study; its digest must be that of the file.
    options
        That decide each row.

    Raises
    ------
    FileError
        If there is a file of another study, scenario or options.
    """

    def __init__(
        self, path: Path | None, command: str, scenario: Scenario, options: Mapping[str, Any]
    ) -> None:
        self.path = path
        self._head: dict[str, Any] = {
            "command": command,
            "scenario": scenario.name,
            "digest": scenario_digest(scenario),
            "options": json.loads(json.dumps(options)),
            "code": code_version(),
        }
        self.rows: list[dict[str, Any]] = []
        if path is None or not path.is_file():
            return
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            rows = content["rows"]
            stated = {key: content[key] for key in self._head}
        except (OSError, ValueError, KeyError, TypeError):
            raise FileError(
                "output", str(path), "is no result of this study: name another file"
            ) from None
        for key in ("command", "digest", "options"):
            if stated[key] != self._head[key]:
                remedy = f"holds rows of another {key}: name another file"
                raise FileError("output", str(path), remedy)
        self.rows = rows

    def write_rows(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Replace the file by rows of a study that goes on."""
        if self.path is not None:
            write_json(self.path, {**self._head, "rows": list(rows)})

    def write(self, result: Mapping[str, Any]) -> None:
        """Replace the file by the whole result, rows included."""
        if self.path is not None:
            write_json(self.path, {**self._head, **result})


def laboratory_tables(folder: str | PathLike[str]) -> str | None:
    """Return the tables of the laboratory's figures, as Markdown; None where there is no result.

    Parameters
    ----------
    folder
        With ``laboratory_*.json``, which `shake calibrate` and `shake sequence rehearse` write.
    """
    parts, tests = [], []
    for file in sorted(Path(folder).glob("laboratory_*.json")):
        result = json.loads(file.read_text(encoding="utf-8"))
        if result["command"] == "shake calibrate" and "p_values" in result:
            tests.append(result)
            if not file.stem.startswith(TESTS):
                parts.append(_calibration(file.stem, result))
        elif result["command"] == "shake sequence rehearse" and "coverage" in result:
            parts.append(_rehearsal(file.stem, result))
    if len(tests) > 1:
        parts.append(_tests(tests))
    return "\n".join(parts) if parts else None


def calibration_cells(result: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return a row for each parameter: name, p-value, share within 90 %, median error, width."""
    return [
        (
            name,
            f"{result['p_values'][name]:.3f}",
            f"{100 * result['inside_90'][name]:.0f} %",
            f"{100 * result['median_error'][name]:.2g} %",
            f"{100 * result['median_width'][name]:.2g} %",
        )
        for name in result["p_values"]
    ]


def _calibration(name: str, result: Mapping[str, Any]) -> str:
    options = result["options"]
    text = (
        f"`{name}`: {result['data_sets']} logs of `{result['scenario']}`, {options['seconds']:g} s, "
        f"{len(result['failures'])} not identified, {result['seconds_each']:.1f} s of processor time "
        "each. Uniform ranks have a p-value of at least 0.01.\n\n"
    )
    rows = [(f"`{name}`", *cells) for name, *cells in calibration_cells(result)]
    head = ("parameter", "p-value of ranks", "within 90 %", "median error", "width over prior's")
    text += markdown_table(head, rows)
    if "forecast" in result:
        checked = result["forecast"]
        shares = sorted(checked["coverage"].items(), key=lambda pair: pair[1])
        (low, least), (high, most) = shares[0], shares[-1]
        text += (
            f"\nOf {checked['shakes']} shakes drawn from the belief, {100 * checked['mean']:.1f} % lie "
            f"within the {100 * checked['probability']:.0f} % intervals of a forecast of "
            f"{checked['samples']} samples (`{low}` {100 * least:.1f} %, `{high}` {100 * most:.1f} %).\n"
        )
    return text


def _tests(results: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of what one test tells of the specimen, by sensors, drive and channels."""
    rows = []
    for result in results:
        options, errors = result["options"], result["median_error"]
        drive = options["controller"]
        current = drive == "none"
        rows.append(
            (
                f"`{result['scenario']}`",
                "noise of current" if current else f"filtered noise under `{drive}`",
                "-" if current else f"{options['amplitude']:g}",
                f"{options['seconds']:g} s",
                ", ".join(f"`{name}`" for name in options["without"]) or "-",
                str(result["data_sets"] - len(result["failures"])),
                *(f"{100 * errors[name]:.2g} %" for name in SPECIMEN),
            )
        )
    head = (
        "sensors", "drive", "amplitude", "length", "left out", "logs", "specimen's mass",
        "stiffness of storey 1", "of storey 2",
    )  # fmt: skip
    text = "Median error of what one log tells, the parameters drawn from the prior:\n\n"
    return text + markdown_table(head, rows)


def _rehearsal(name: str, result: Mapping[str, Any]) -> str:
    options = result["options"]
    text = (
        f"`{name}`: {result['truths']} hidden plants of `{result['scenario']}`, amplitudes "
        f"{', '.join(f'{a:g}' for a in options['amplitudes'])}, {len(result['failed'])} ended early.\n\n"
    )

    def ratio(values: Sequence[float] | None) -> str:
        return "-" if values is None else f"{values[1]:.2f} [{values[0]:.2f}, {values[2]:.2f}]"

    share = "-" if result["coverage"] is None else f"{100 * result['coverage']:.0f} %"
    row = (
        "wider than the model" if options["wider"] else "from the prior",
        "yes" if options["discrepancy"] else "no",
        share,
        ratio(result["error_over_informed"]),
        ratio(result["error_over_nominal"]),
        str(result["limits_broken"]),
    )
    head = (
        "hidden plants", "discrepancy", "within 90 %", "error over that with the true plant",
        "error over the nominal design's", "limits broken",
    )  # fmt: skip
    text += markdown_table(head, [row])
    if result.get("iteration_damage") is not None:
        text += (
            "\nEnergy that the specimen took before the last shake, over that of one perfect test, and "
            f"that shake's base-shear error: {ratio(result['damage'])} and {ratio(result['error'])} in "
            "the sequence; "
            f"{ratio(result['iteration_damage'])} and {ratio(result['iteration_error'])} with a "
            "transfer-function iteration of seven tests with the whole motion, the first of which "
            "measures the response.\n"
        )
    return text
