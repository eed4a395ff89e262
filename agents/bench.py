"""The classical bench: every controller on every named scenario, as files and tables in the docs."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict
from os import PathLike
from pathlib import Path
from typing import Any

import shake_env
from agents.compare import CLAIRVOYANT, Comparison, GroupSummary, compare, plain_row
from agents.marked_page import put
from baselines.registry import reference_name
from shake_env import make_scenario
from shake_env.errors import ParameterError

TEST_SEED = 4_000_000  # neither training's, evaluation's, validation's nor `shake compare`'s
SCENARIOS = ("linear", "laboratory", "unknown-specimen", "yielding", "records")


def bench(
    scenario_name: str,
    earthquakes: int,
    names: Sequence[str] = (CLAIRVOYANT, "all"),
    on_progress: Callable[[str, float], None] = lambda controller, share: None,
) -> dict[str, Any]:
    """Return the result of all controllers on test earthquakes of a scenario, as plain JSON values.

    Parameters
    ----------
    scenario_name
        A named scenario.
    earthquakes
        Number of filtered-noise earthquakes; `records` are run on the six records instead.
    names
        As for `compare`.
    on_progress
        Told the controller that runs and its share done, 0 to 1.
    """
    if earthquakes < 2:
        raise ParameterError("earthquakes", earthquakes, "an interval needs at least 2")
    scenario = make_scenario(scenario_name)
    recorded = scenario_name == "records"
    found = compare(
        scenario,
        names,
        noise=0 if recorded else earthquakes,
        records=recorded,
        seed=TEST_SEED,
        on_progress=on_progress,
    )
    return {
        "scenario": scenario_name,
        "version": shake_env.__version__,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "seed": None if recorded else TEST_SEED,
        "reference": reference_name(scenario),
        "skipped": found.skipped,
        "rows": [plain_row(asdict(row)) for row in ranked(found)],
    }


def ranked(found: Comparison) -> list[GroupSummary]:
    """Return the summaries by cost, the clairvoyant first and no control last."""
    ends = {CLAIRVOYANT: -1, "none": 1}
    return sorted(found.summaries, key=lambda row: (ends.get(row.controller, 0), row.relative_cost))


def markdown(result: dict[str, Any]) -> str:
    """Return a result as a Markdown table."""
    head = (
        f"| controller | cost / {result['reference']} [95 %] | accel. % rms, peak | shear % rms, peak "
        "| lag ms | spectrum % | Arias | drift | energy | ended | us |"
    )
    lines = [head, "|---|---|---|---|---|---|---|---|---|---|---|"]
    for row in result["rows"]:
        digits = 3 if row["relative_cost_high"] < 10.0 else 1
        low, high = row["relative_cost_low"], row["relative_cost_high"]
        lag = "-" if row["delay"] is None else f"{1e3 * row['delay']:.1f}"
        lines.append(
            f"| {row['controller']} | {row['relative_cost']:.{digits}f} [{low:.{digits}f}, "
            f"{high:.{digits}f}] | {100 * row['acceleration_rms_error']:.1f}, "
            f"{100 * row['acceleration_peak_error']:.0f} | {100 * row['base_shear_rms_error']:.1f}, "
            f"{100 * row['base_shear_peak_error']:.0f} | {lag} | {100 * row['spectral_error']:.0f} | "
            f"{row['arias_ratio']:.2f} | {row['drift_ratio']:.2f} | {row['energy_ratio']:.2f} | "
            f"{row['broken_limits']} | {_microseconds(row['decision_time'])} |"
        )
    number = result["rows"][0]["earthquakes"]
    lines.append("")
    for row in result["rows"]:
        if row["damage"] is not None:
            lines.append(
                f"`{row['controller']}` takes {row['tests']} tests of each earthquake, the one that "
                f"counts included; before that one the specimen has dissipated {row['damage']:.1f} "
                "times the energy of a perfect test (median)."
            )
    seed = "recorded" if result["seed"] is None else f"seeds from {result['seed']}"
    lines.append(f"{number} earthquakes, {seed}, version {result['version']}, {result['machine']}.")
    return "\n".join(lines) + "\n"


def _microseconds(seconds: float | None) -> str:
    return "-" if seconds is None else f"{1e6 * seconds:.0f}"


def put_tables(page: str | PathLike[str], results: Sequence[dict[str, Any]]) -> None:
    """Put the tables of results into a page, each at ``<!-- bench NAME -->``; see `marked_page.put`."""
    page = Path(page)
    for result in results:
        put(page, f"bench {result['scenario']}", markdown(result), end=result["scenario"])


def read_results(folder: str | PathLike[str]) -> list[dict[str, Any]]:
    """Return the results that a folder holds, in the order of `SCENARIOS`."""
    folder = Path(folder)
    files = [folder / f"bench_{name}.json" for name in SCENARIOS]
    return [json.loads(file.read_text(encoding="utf-8")) for file in files if file.exists()]
