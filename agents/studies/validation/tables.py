"""Tables of the validation: JSON, CSV, markdown and the terminal."""

from __future__ import annotations

import json
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from rich.console import Console

from agents.reporting.csv_file import write_csv
from agents.reporting.markdown_blocks import markdown_table
from agents.reporting.terminal import print_table
from shake_env.files import write_text

Rows = list[list[str]]

SHORT = {
    "load_pressure": "pressure", "spool_position": "spool", "current": "current",
    "table_velocity": "velocity", "table_displacement": "stroke",
    "table_acceleration": "acceleration", "storey_drift": "drift",
}  # fmt: skip


def write_validation(results: dict[str, Any], folder: str | PathLike[str]) -> list[Path]:
    """Write validation.json, ranges.csv, reduction.csv and validation.md; return their paths."""
    folder = Path(folder)
    paths = [folder / n for n in ("validation.json", "ranges.csv", "reduction.csv", "validation.md")]
    write_text(paths[0], json.dumps(results, indent=1, allow_nan=False) + "\n")
    flat = [
        {k: m[k] for k in ("controller", "group", "motion")} | check
        for m in results["motions"]
        for check in m["checks"]
    ]
    write_csv(paths[1], list(flat[0]), flat)
    orders = [{"table": t} | row for t, r in results["reduction"].items() for row in r["orders"]]
    write_csv(paths[2], list(orders[0]), orders)
    write_text(paths[3], validation_tables(results))
    return paths


def peaks_table(motions: Sequence[dict[str, Any]]) -> tuple[list[str], Rows]:
    """Return the table of peaks: a row a response, ``*`` above rated, ``**`` above limit."""
    head = ["controller", "motion"]
    head += [f"{SHORT[c['quantity']]} [{c['unit']}]" for c in motions[0]["checks"]]
    head += ["factor", "by", "but stroke", "by", "specimen"]
    marks = {"within": "", "above rated": "*", "above limit": "**"}
    rows = [
        [m["controller"], m["motion"]]
        + [f"{c['peak']:.3g}{marks[c['verdict']]}" for c in m["checks"]]
        + [f"{m['factor_to_rated']:.3g}", SHORT[m["decided_by"]]]
        + [f"{m['factor_to_rated_but_stroke']:.3g}", SHORT[m["decided_by_but_stroke"]]]
        + [f"{m['factor_for_specimen']:.3g}"]
        for m in motions
    ]
    return head, rows


def exceeded_table(motions: Sequence[dict[str, Any]]) -> tuple[list[str], Rows]:
    """Return who exceeds what: responses above the rated size and the limit, by group and controller."""
    quantities = [c["quantity"] for c in motions[0]["checks"]]
    head = ["motions", "controller", *[SHORT[q] for q in quantities]]
    keys = dict.fromkeys((m["group"], m["controller"]) for m in motions)
    rows = []
    for group, controller in keys:
        of = [m for m in motions if (m["group"], m["controller"]) == (group, controller)]
        row = [f"{group} ({len(of)})", controller]
        for i in range(len(quantities)):
            verdicts = [m["checks"][i]["verdict"] for m in of]
            limit, any_ = verdicts.count("above limit"), len(of) - verdicts.count("within")
            row.append("-" if any_ == 0 else f"{any_} ({limit})")
        rows.append(row)
    return head, rows


def fidelity_table(motions: Sequence[dict[str, Any]]) -> tuple[list[str], Rows]:
    """Return how well each controller tracks, and how far the specimen is led astray."""
    head = ["motions", "controller", "acceleration error %", "shear error %", "peak drift / reference"]
    keys = dict.fromkeys((m["group"], m["controller"]) for m in motions)
    rows = []
    for group, controller in keys:
        of = [m for m in motions if (m["group"], m["controller"]) == (group, controller)]
        row = [group, controller]
        for key, factor in (("acceleration_error", 100.0), ("base_shear_error", 100.0)):
            row.append(_span([factor * m[key] for m in of if m[key] is not None]))
        row.append(_span([m["drift_ratio"] for m in of if m["drift_ratio"] is not None]))
        rows.append(row)
    return head, rows


def _span(values: Sequence[float]) -> str:
    if not values:
        return "-"
    low, high = f"{min(values):.3g}", f"{max(values):.3g}"
    return low if low == high else f"{low} to {high}"


def reduction_table(reduction: dict[str, Any]) -> tuple[list[str], Rows]:
    """Return bound and errors of every order, relative to the closed loop's norm."""
    head = ["table", "order", "bound", "error, cut", "error, settled", "fastest pole, settled [rad/s]"]
    rows = []
    for table, r in reduction.items():
        for row in r["orders"]:
            order = f"**{row['order']}**" if row["order"] == r["order"] else str(row["order"])
            errors = [f"{row[k]:.3g}" for k in ("bound", "error_cut", "error_settled")]
            rows.append([table, order, *errors, f"{row['fastest_pole_settled']:.3g}"])
    return head, rows


def responses_table(differences: Sequence[dict[str, Any]]) -> tuple[list[str], Rows]:
    """Return how far the reduced model's response is from the full one's, over the full one's peak."""
    names = list(differences[0]["peak_difference"])
    head = [
        "table",
        "motions",
        *[name.replace("_", " ") for name in names],
        "displacement",
        "energy / bound",
    ]
    rows = []
    for table, group in dict.fromkeys((d["table"], d["group"]) for d in differences):
        of = [d for d in differences if (d["table"], d["group"]) == (table, group)]
        row = [table, group]
        row += [f"{max(d['peak_difference'][name] for d in of):.1e}" for name in names]
        row.append(f"{max(d['displacement_difference'] for d in of):.1e}")
        row.append(f"{max(d['energy_gain'] / d['bound'] for d in of):.1e}")
        rows.append(row)
    return head, rows


def validation_tables(results: dict[str, Any]) -> str:
    """Return every table of the transient validation as Markdown."""
    motions, reduction = results["motions"], results["reduction"]
    parts = ["# Tables of the transient validation\n", "Written by `shake validate-transients`.\n"]
    parts.append("## Ranges\n")
    rows = [
        [SHORT[r["quantity"]], f"{r['rated'] * r['factor']:.3g}", f"{r['limit'] * r['factor']:.3g}",
         r["unit"], r["reason"]]
        for r in results["ranges"]
    ]  # fmt: skip
    parts.append(markdown_table(["quantity", "rated", "limit", "unit", "reason"], rows))
    parts.append("## Who exceeds what\n")
    parts.append("Responses above the rated size, in brackets those above the limit.\n")
    parts.append(markdown_table(*exceeded_table(motions)))
    parts.append("## Peaks and amplitude factors\n")
    parts.append("`*` above the rated size, `**` above the limit. The factor on the present amplitude")
    parts.append("brings the table to its rated sizes, then the same without the stroke, then the")
    parts.append("specimen to 1 % of drift. Above 1 there is room to spare.\n")
    for group in dict.fromkeys(m["group"] for m in motions):
        parts.append(f"### {group}\n")
        parts.append(markdown_table(*peaks_table([m for m in motions if m["group"] == group])))
    parts.append("## Fidelity\n")
    parts.append(markdown_table(*fidelity_table(motions)))
    parts.append("## Balanced reduction\n")
    for table, r in reduction.items():
        bound = r["error_bound"] / r["h_infinity_norm"]
        parts.append(
            f"Weights of Table {table}: {r['full_order']} states, poles from "
            f"{-r['slowest_pole']:.2g} to {r['fastest_pole']:.3g} rad/s; kept {r['order']} states, "
            f"fastest {r['reduced_fastest_pole']:.3g} rad/s, bound {bound:.2g} of the norm; largest "
            f"stable step {r['largest_stable_step']:.2g} s, then "
            f"{r['reduced_largest_stable_step']:.2g} s.\n"
        )
    parts.append(markdown_table(*reduction_table(reduction)))
    parts.append("## Full against reduced responses\n")
    parts.append("Largest difference over the full response's peak, settled model.\n")
    parts.append(markdown_table(*responses_table(results["reduced_responses"])))
    return "\n".join(parts)


def print_validation(results: dict[str, Any], console: Console) -> None:
    """Print what fits a terminal: who exceeds what, amplitude factors, the reduction."""
    motions = results["motions"]
    _print(console, "Responses above the rated size (above the limit)", exceeded_table(motions))
    rows = [
        [m["motion"], m["controller"], f"{m['factor_to_rated']:.3g}", SHORT[m["decided_by"]],
         f"{m['factor_to_rated_but_stroke']:.3g}", SHORT[m["decided_by_but_stroke"]],
         f"{m['factor_for_specimen']:.3g}"]
        for m in motions
    ]  # fmt: skip
    head = ["motion", "controller", "factor", "by", "but stroke", "by", "specimen"]
    _print(console, "Amplitude factor that brings a motion to the rated size", (head, rows))
    for table, r in results["reduction"].items():
        console.print(
            f"Continuous {table}: {r['full_order']} states to {r['order']}, fastest pole "
            f"{r['fastest_pole']:.3g} to {r['reduced_fastest_pole']:.3g} rad/s, error at most "
            f"{r['error_bound'] / r['h_infinity_norm']:.2g} of the norm."
        )


def _print(console: Console, title: str, table: tuple[list[str], Rows]) -> None:
    print_table(console, table[0], table[1], title=title, names=2)
