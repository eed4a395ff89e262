"""Transient validation of the model, the future work of Gavin and Hoagg (2009, sec. V-B), in one call.

The closed loop is simulated on recorded and filtered-noise motions under a sampled-data LQR and under
the paper's continuous ones, every state and output is compared with what a table can do, and the
continuous loops are reduced by balanced truncation, with the error against its bound.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from agents.studies.validation import figures as figures
from agents.studies.validation import tables as output_files
from agents.studies.validation.ranges import RANGES, MotionCheck, check_motion
from agents.studies.validation.reduction import ReducedLoop, reduce_loop
from agents.studies.validation.responses import (
    UNAWARE,
    Group,
    Motion,
    continuous_loops,
    continuous_name,
    continuous_response,
    motion_groups,
    reduced_response,
    sampled_gains,
    sampled_responses,
    smooth_target,
)
from baselines.analysis.closed_loop import ERRORS
from shake_env.model.parameters import FloatArray
from shake_env.scenario.scenario import Scenario

SHOWN = "ridgecrest2019_clc_360"  # the record whose response is drawn
NOISE_MOTIONS = 3


def _silent(_: str) -> None:
    """Report nothing."""


# Matrices this small lose time to a second BLAS thread. threadpoolctl has no types.
@threadpool_limits.wrap(limits=1)  # type: ignore[untyped-decorator]
def validate(
    scenario: Scenario,
    output: Path | None = None,
    progress: Callable[[str], None] = _silent,
    *,
    noise: int = NOISE_MOTIONS,
) -> dict[str, Any]:
    """Validate the closed loop of a scenario on motions, and its balanced reduction.

    Parameters
    ----------
    scenario
        Plant, objective, rates and amplitude. Its limits and its current limit are put aside: what is
        asked is what a motion needs.
    output
        Folder for tables and figures; it is made if missing. None writes nothing.
    progress
        Called with one line as each part is finished.
    noise
        Filtered-noise motions of each kind; 0 leaves them out.

    Returns
    -------
    results
        What ``validation.json`` holds, and under ``files`` the paths written.
    """
    started = time.perf_counter()

    def done(what: str) -> None:
        progress(f"[{time.perf_counter() - started:5.1f} s] {what}")

    loops = {t: reduce_loop(t, loop) for t, loop in continuous_loops(scenario).items()}
    orders = ", ".join(f"{r.loop.system.order} to {r.summary['order']}" for r in loops.values())
    done(f"balanced reduction of both continuous loops: states {orders}")

    checks: list[MotionCheck] = []
    differences: list[dict[str, Any]] = []
    shown: dict[str, Motion] = {}
    for group in motion_groups(scenario, noise):
        outcome = _run_group(group, loops if group.scenario.ground == scenario.ground else None)
        for controller, motions in outcome.motions.items():
            for motion in motions:
                checks.append(check_motion(controller, group.name, motion.name, motion.signals))
                if motion.name == SHOWN:
                    shown[controller] = motion
        differences += outcome.differences
        if outcome.reduced_shown:
            shown |= outcome.reduced_shown
        done(f"{group.name}: {len(group.earthquakes)} motions under {len(outcome.motions)} controllers")

    results: dict[str, Any] = {
        "source": "Gavin and Hoagg, Control Objectives for Seismic Simulators, ACC 2009, section V-B",
        "scenario": _describe(scenario),
        "ranges": [asdict(known) for known in RANGES],
        "reduction": {table: r.summary for table, r in loops.items()},
        "reduced_responses": differences,
        "motions": [asdict(check) for check in checks],
    }
    files: list[Path] = []
    if output is not None:
        output = Path(output)
        files += output_files.write_validation(results, output)
        files += figures.draw_hankel_values(loops, output)
        files += figures.draw_transfer(loops, output)
        files += figures.draw_ranges(checks, output)
        files += figures.draw_transients(SHOWN, shown, output)
        done("tables and figures")
    return {**results, "seconds": time.perf_counter() - started, "files": [str(f) for f in files]}


def _describe(scenario: Scenario) -> dict[str, Any]:
    motion, specimen = scenario.motion, scenario.specimen
    return {
        "name": scenario.name,
        "stories": specimen.stories,
        "mass_ratio": specimen.mass / scenario.actuator.table_mass,
        "fixed_base_frequencies": specimen.fixed_base_frequencies.tolist(),
        "control_rate": scenario.control_rate,
        "amplitude": motion.amplitude,
        "highpass_frequency": scenario.ground.highpass_frequency,
        "as_printed": scenario.equations == type(scenario.equations).as_printed(),
    }


class _GroupResult:
    """What the controllers made of one group of motions."""

    def __init__(self) -> None:
        self.motions: dict[str, list[Motion]] = {}
        self.differences: list[dict[str, Any]] = []
        self.reduced_shown: dict[str, Motion] = {}


def _run_group(group: Group, reduced: dict[str, ReducedLoop] | None) -> _GroupResult:
    """Run every controller on a group; `reduced` is None where its plant is another one."""
    result = _GroupResult()
    for name, gain in sampled_gains(group.scenario).items():
        result.motions[name] = sampled_responses(group, gain)
    # The continuous controllers get the motions that the sampled ones were given.
    targets = [
        smooth_target(group.scenario, quake, len(motion.time))
        for quake, motion in zip(group.earthquakes, result.motions[UNAWARE], strict=True)
    ]
    loops = (
        continuous_loops(group.scenario) if reduced is None else {t: r.loop for t, r in reduced.items()}
    )
    for table, loop in loops.items():
        name = continuous_name(table)
        result.motions[name] = []
        for quake, target in zip(group.earthquakes, targets, strict=True):
            motion, response = continuous_response(loop, group.scenario, quake.name, target)
            result.motions[name].append(motion)
            if reduced is None:
                continue
            small = reduced[table]
            settled = small.chosen["settled"]
            other = reduced_response(loop, settled, small.outputs, group.scenario, target)
            columns = [loop.index[output] for output in small.outputs]
            full = response.outputs[:, columns]
            sizes = loop.sizes[columns]
            driven = max(float(np.sum(response.noise**2)), float(np.finfo(float).tiny))
            apart = np.sqrt(np.sum(((other.outputs - full) / sizes) ** 2) / driven)
            result.differences.append(
                {
                    "table": table,
                    "group": group.name,
                    "motion": quake.name,
                    "bound": settled.error_bound,
                    # A bound on the H-infinity norm is one on the energy of the difference over w's.
                    "energy_gain": float(apart),
                    "peak_difference": _relative(other.outputs, full, small.outputs),
                    "displacement_difference": _relative(
                        other.displacement[:, None], response.displacement[:, None], ["x"]
                    )["x"],
                }
            )
            if quake.name == SHOWN:
                signals = {o: other.outputs[:, i] for i, o in enumerate(small.outputs)}
                signals["table_displacement"] = other.displacement
                result.reduced_shown[f"{name}, reduced"] = Motion(quake.name, motion.time, signals)
    return result


def _relative(other: FloatArray, full: FloatArray, names: Sequence[str]) -> dict[str, float]:
    """Return the largest difference of each output over its own peak; errors among the outputs."""
    peak = np.max(np.abs(full), axis=0)
    apart = np.max(np.abs(other - full), axis=0)
    shown = [i for i, name in enumerate(names) if "drift" not in name or name == "drift_1"]
    shown.sort(key=lambda i: names[i] not in ERRORS)
    return {names[i]: float(apart[i] / peak[i]) if peak[i] > 0.0 else 0.0 for i in shown}
