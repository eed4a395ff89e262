"""The tests of nonlinear parts as one run: key numbers, figures, and lines for the terminal."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from agents.studies.components.bench import (
    EXPONENTS,
    LEVELS,
    ComponentSetup,
    StoreyLoop,
    TablePeriod,
    elastoplastic_energy,
    growing_cycles,
    sinusoidal_table,
    steady_loop,
    valve_flow,
)
from agents.studies.components.figures import (
    DUCTILITY,
    LITRES_A_MINUTE,
    friction_figure,
    valve_figure,
    yielding_figure,
)
from shake_env.files import write_text
from shake_env.model.nonlinearity import Friction


def components(bench: ComponentSetup, folder: Path | None) -> dict[str, Any]:
    """Run the tests; return their key numbers, and write them and figures where there is a folder."""
    law = bench.friction
    storey = growing_cycles(bench)
    own = sinusoidal_table(bench, law)
    coulomb = Friction(coulomb=law.coulomb, smoothing_velocity=law.smoothing_velocity)
    tables = sinusoidal_table(bench, coulomb, LEVELS)
    measured = {
        "yielding": yielding_numbers(bench, storey),
        "friction": friction_numbers(bench, own, tables),
        "valve": valve_numbers(bench),
    }
    if folder is None:
        return measured
    numbers = folder / "components.json"
    write_text(numbers, json.dumps(measured, indent=1, allow_nan=False) + "\n")
    paths = [numbers, *yielding_figure(bench, storey, folder)]
    paths += friction_figure(bench, own, tables, folder)
    paths += valve_figure(bench, folder)
    return measured | {"files": [str(path) for path in paths]}


def yielding_numbers(bench: ComponentSetup, loop: StoreyLoop) -> dict[str, Any]:
    """Return the storey's law and the energy of each cycle, in SI."""
    law = bench.yielding
    limits = elastoplastic_energy(bench, law, loop.amplitudes)
    at = np.array([DUCTILITY * law.yield_drift])
    return {
        "stiffness": bench.stiffness,
        "stiffness_ratio": law.stiffness_ratio,
        "yield_drift": law.yield_drift,
        "yield_force": bench.yield_force,
        "exponent": law.exponent,
        "largest_force": float(np.max(np.abs(loop.force))),
        "cycles": [
            {"drift": float(d), "energy": float(e), "elastoplastic_energy": float(limit)}
            for d, e, limit in zip(loop.amplitudes, loop.cycle_energy, limits, strict=True)
        ],
        "exponents": [
            {
                "exponent": n,
                "drift": float(at[0]),
                "energy": float(steady_loop(bench, replace(law, exponent=n), at)[2][0]),
                "elastoplastic_energy": float(elastoplastic_energy(bench, law, at)[0]),
            }
            for n in EXPONENTS
        ],
    }


def friction_numbers(bench: ComponentSetup, own: TablePeriod, tables: TablePeriod) -> dict[str, Any]:
    """Return what friction takes from the table in a period, and the spike that it leaves, in SI."""
    free = tables.acceleration[:, [0]]
    spikes = np.max(np.abs(tables.acceleration - free), axis=0)
    peaks = np.max(np.abs(tables.acceleration), axis=0)
    strokes = 0.5 * np.ptp(tables.displacement, axis=0)
    law = bench.friction
    return {
        "frequency": bench.frequency,
        "current": bench.current,
        "coulomb": law.coulomb,
        "static": law.static,
        "viscous": law.viscous,
        "smoothing_velocity": law.smoothing_velocity,
        "stribeck_velocity": law.stribeck_velocity,
        "energy": float(own.energy[0]),
        "displacement": float(strokes[0]),
        "velocity": float(np.max(np.abs(tables.velocity[:, 0]))),
        "ringing_frequency": float(bench.plant.natural_frequencies[-1]),
        "tables": [
            {
                "coulomb": level,
                "energy": float(energy),
                "ideal_energy": float(4.0 * level * stroke),
                "peak_acceleration": float(peak),
                "spike": float(spike),
            }
            for level, energy, stroke, peak, spike in zip(
                LEVELS, tables.energy, strokes, peaks, spikes, strict=True
            )
        ],
    }


def valve_numbers(bench: ComponentSetup) -> dict[str, Any]:
    """Return the valve's rated flow and its share at some load pressures, in SI."""
    valve = bench.valve
    orifice, travel = replace(valve, dead_band=0.0), valve.spool_limit
    shares = np.array([-1.0, 0.0, 0.5, 2.0 / 3.0, 1.0])
    spool = np.full_like(shares, travel)
    flow = valve_flow(bench, orifice, spool, shares * valve.supply_pressure)
    rated = bench.plant.actuator.flow_gain * travel
    return {
        "supply_pressure": valve.supply_pressure,
        "spool_limit": travel,
        "dead_band": valve.dead_band,
        "rated_flow": rated,
        "rated_velocity": rated / bench.plant.actuator.piston_area,
        "flow": [
            {"pressure_ratio": float(p), "flow_ratio": float(q / rated)}
            for p, q in zip(shares, flow, strict=True)
        ],
    }


def print_numbers(numbers: dict[str, Any], console: Console) -> None:
    """Print the key numbers in a laboratory's units."""
    y, f, v = numbers["yielding"], numbers["friction"], numbers["valve"]
    console.print(
        f"Storey: k {1e-3 * y['stiffness']:.1f} kN/m, then {y['stiffness_ratio']:g} k; yields at "
        f"{1e3 * y['yield_drift']:g} mm and {y['yield_force']:.0f} N."
    )
    console.print("  energy a cycle: " + ", ".join(
        f"{c['energy']:.2f} J at {1e3 * c['drift']:g} mm" for c in y["cycles"]
    ))  # fmt: skip
    for e in y["exponents"]:
        share = 100.0 * e["energy"] / e["elastoplastic_energy"]
        console.print(
            f"  exponent {e['exponent']:g}: {e['energy']:.2f} J at {1e3 * e['drift']:g} mm, "
            f"{share:.1f} % of the elastoplastic loop"
        )
    console.print(
        f"Table at {f['frequency']:g} Hz and {1e3 * f['displacement']:.1f} mm: friction takes "
        f"{f['energy']:.1f} J a period; with Coulomb friction alone"
    )
    for t in f["tables"]:
        console.print(
            f"  {t['coulomb']:.0f} N: {round(t['energy'], 1) + 0.0:.1f} J a period, peak acceleration "
            f"{t['peak_acceleration']:.2f} m/s^2, of it spike {t['spike']:.2f} m/s^2"
        )
    shares = ", ".join(f"{q['flow_ratio']:.3f} at {q['pressure_ratio']:.2f} P_s" for q in v["flow"])
    console.print(
        f"Valve: {LITRES_A_MINUTE * v['rated_flow']:.0f} l/min or {v['rated_velocity']:.2f} m/s at "
        f"{1e6 * v['spool_limit']:g} um without load; share of it {shares}"
    )
