"""The whole reproduction in one call: tables as CSV, JSON and markdown, figures as PNG and SVG."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from agents.reporting.csv_file import write_csv
from agents.reporting.markdown_blocks import markdown_table
from agents.studies.reproduction import figures as figures
from agents.studies.reproduction import tables as tables
from agents.studies.reproduction.tables import MASS_RATIOS, MODELS, STORIES, WEIGHTS
from shake_env.files import write_text

DESIGN_WITHOUT_SPECIMEN = 1e-3  # mu of a design that takes the table as empty but keeps every weight
UNAWARE_MASS_RATIOS = (0.1, 0.2, 0.5, 1.0, 2.0)
TRADE_OFF_STORIES = (2, 10)
TRADE_OFF_MASS_RATIO = 0.5


def _silent(_: str) -> None:
    """Report nothing."""


# Matrices this small lose time to a second BLAS thread. threadpoolctl has no types.
@threadpool_limits.wrap(limits=1)  # type: ignore[untyped-decorator]
def reproduce(
    output: str | PathLike[str],
    progress: Callable[[str], None] = _silent,
    *,
    frequency_points: int = 600,
    sweep_points: int = 40,
) -> dict[str, Any]:
    """Recompute the paper's tables and figures, and what the corrected model adds, into `output`.

    Parameters
    ----------
    output
        Folder to write into; it is made if missing, and files of the same name are replaced.
    progress
        Called with one line as each part is finished.
    frequency_points
        Frequencies in Figures 3 and 4.
    sweep_points
        Added weights in each sweep, from 1e-12 to 10.

    Returns
    -------
    results
        What ``reproduction.json`` holds, and under ``files`` the paths written.
    """
    output = Path(output)
    started = time.perf_counter()
    output = Path(output)
    files: list[Path] = []

    def done(what: str) -> None:
        progress(f"[{time.perf_counter() - started:5.1f} s] {what}")

    cases = [(t, n, mu) for t in WEIGHTS for mu in MASS_RATIOS for n in STORIES]
    results: dict[str, Any] = {
        "source": "Gavin and Hoagg, Control Objectives for Seismic Simulators, ACC 2009",
        "arithmetic": tables.values_of_table_1(),
        "equations": tables.equation_effects(),
        "cells": [tables.cell_of_table(*case) for case in cases],
        "rounding": tables.rounding_of_the_added_weight("III", 2, 0.5),
    }
    done("Tables II and III: 18 cells, both models, two methods")

    weights = np.logspace(-12.0, 1.0, sweep_points)
    sweeps = [tables.sweep_added_weight(*case, model, weights) for model in MODELS for case in cases]
    results["sweep"] = {"added_weights": weights.tolist(), "curves": sweeps}
    done(f"added weight: {len(sweeps)} curves of {sweep_points} designs")

    ratios = [0.0, *np.logspace(-3.0, 3.0, 25).tolist(), math.inf]
    curves = {n: tables.trade_off(n, TRADE_OFF_MASS_RATIO, ratios) for n in TRADE_OFF_STORIES}
    results["trade_off"] = {str(n): rows for n, rows in curves.items()}
    unaware = {
        n: {
            "without": tables.unaware_design(n, UNAWARE_MASS_RATIOS, DESIGN_WITHOUT_SPECIMEN),
            "without, limit mu = 1e-9": tables.unaware_design(n, UNAWARE_MASS_RATIOS, 1e-9),
            "with": tables.unaware_design(n, UNAWARE_MASS_RATIOS, None),
        }
        for n in TRADE_OFF_STORIES
    }
    results["unaware"] = {str(n): rows for n, rows in unaware.items()}
    done("sampled designs: trade-off, and the design that does not know the specimen")

    frequencies = np.logspace(-2.0, 4.0, frequency_points)
    for table in WEIGHTS:
        files += figures.transfer_functions(table, frequencies, output)
        files += figures.added_weight(table, weights, sweeps, output)
    files += figures.trade_off(curves, TRADE_OFF_MASS_RATIO, output)
    files += figures.unaware_design(unaware, output)
    done("figures")

    files += [_write_csv(results["cells"], output), output / "reproduction.json", output / "tables.md"]
    write_text(files[-2], json.dumps(results, indent=1, allow_nan=False) + "\n")
    write_text(files[-1], reproduction_tables(results))
    done("tables written")
    return {**results, "seconds": time.perf_counter() - started, "files": [str(f) for f in files]}


COLUMNS = ("published", "as_printed", "as_printed_with_printed_weight", "corrected")


def _write_csv(cells: Sequence[dict[str, Any]], output: Path) -> Path:
    path = output / "tables_II_and_III.csv"
    norms = {"acceleration": "acceleration_m2_per_s4", "base_shear": "base_shear_N2"}
    rows = [
        {name: row[name] for name in ("table", "stories", "mass_ratio", "printed_added_weight")}
        | {
            f"{column}_{name}": None if row[column] is None else row[column][key]
            for column in ("motionless", *COLUMNS)
            for key, name in norms.items()
        }
        for row in cells
    ]
    write_csv(path, list(rows[0]), rows)
    return path


def _pair(norms: dict[str, Any] | None, floor: float = 0.0) -> str:
    """Return ``a : b``; a force norm within rounding of zero is given as 0."""
    if norms is None:
        return "no stable design"
    shear = norms["base_shear"]
    return f"{norms['acceleration']:.3g} : {'0' if shear < floor else format(shear, '.3g')}"


def reproduction_tables(results: dict[str, Any]) -> str:
    """Return every table of the paper's reproduction as Markdown."""
    parts = ["# Tables of the reproduction\n", "Written by `shake reproduce`; every number is computed,"]
    parts.append("except those under *published*.\n")
    curves = {
        (c["table"], c["stories"], c["mass_ratio"], c["model"]): c for c in results["sweep"]["curves"]
    }
    for table, (q_1, q_2) in WEIGHTS.items():
        parts.append(f"## Table {table}: q_1 = {q_1:g}, q_2 = {q_2:g}\n")
        parts.append("`||G~_1||^2 [(m/s^2)^2] : ||G~_2||^2 [N^2]`\n")
        rows = []
        for c in (c for c in results["cells"] if c["table"] == table):
            floor = 1e-16 * c["motionless"]["base_shear"]
            rows.append(
                [f"{c['stories']}", f"{c['mass_ratio']}"]
                + [_pair(c[column], floor) for column in ("published", "as_printed")]
                + [f"{_pair(c[COLUMNS[2]], floor)} ({c['printed_added_weight']:.1e})"]
                + [_pair(c["corrected"], floor), _pair(c["motionless"])]
            )
        parts.append(
            markdown_table(
                ["n_m", "mu", "published", "as printed, no added weight",
                 "as printed, 5 abs(lambda_min) as rounded here", "corrected", "motionless table"],
                rows,
            )
        )  # fmt: skip
        parts.append(f"## Added weight that would explain Table {table}\n")
        rows = []
        for c in (c for c in results["cells"] if c["table"] == table):
            line = [f"{c['stories']}", f"{c['mass_ratio']}"]
            for model in MODELS:
                e = curves[table, c["stories"], c["mass_ratio"], model]["explains"]
                for key in ("acceleration", "base_shear"):
                    line.append(", ".join(f"{w:.1e}" for w in e[key]) or "none")
                line.append(f"{e['both']:.1e} (x {e['missing_factor']:.2g})")
            rows.append(line)
        head = ["n_m", "mu"]
        for model in ("printed", "corrected"):
            head += [f"{model}: for G~_1", f"{model}: for G~_2", f"{model}: for both (misses by)"]
        parts.append(markdown_table(head, rows))
    parts.append("## Each printed difference by itself (n_m = 2, mu = 0.5)\n")
    rows = [
        [
            e["equations"],
            ", ".join(f"{f:.3f}" for f in e["damped_frequencies"]),
            f"{e['shear_ratio_motionless']:.3g}",
            f"{e['shear_ratio_perfect_tracking']:.3g}",
            _pair(
                None
                if e["table_II_acceleration"] is None
                else {"acceleration": e["table_II_acceleration"], "base_shear": e["table_II_base_shear"]}
            ),
        ]
        for e in results["equations"]
    ]
    head = ["equations", "natural frequencies [Hz]", "f_s / f~_s, motionless table"]
    head += ["f_s / f~_s, perfect tracking", "norms, Table II weights"]
    parts.append(markdown_table(head, rows))
    parts.append("## Same matrix, same smallest eigenvalue (Table III, n_m = 2, mu = 0.5)\n")
    rows = [[way, f"{value:.2e}"] for way, value in results["rounding"].items()]
    parts.append(markdown_table(["5 abs(lambda_min) by", "value"], rows))
    parts.append("## 200 Hz LQR that does not know the specimen\n")
    parts.append("rms errors of acceleration : base shear, relative to the target's\n")
    rows = []
    for stories, designs in results["unaware"].items():
        for name, entries in designs.items():
            pairs = [f"{r['acceleration_error']:.3f} : {r['base_shear_error']:.3f}" for r in entries]
            rows.append([stories, f"{name}" if name != "with" else "with knowledge of it", *pairs])
    parts.append(markdown_table(["n_m", "design", *[f"mu = {mu}" for mu in UNAWARE_MASS_RATIOS]], rows))
    return "\n".join(parts)
