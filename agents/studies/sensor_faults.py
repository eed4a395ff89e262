"""What a supervisor holds when sensors fail or the table differs: the study behind `docs/safety.md`.

``python -m agents.studies.sensor_faults --output FILE`` drives tables with hostile controllers under
each fault and writes how many broke a limit; ``--table FILE`` prints the rows of `docs/safety.md` from
it.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.evaluation.perturbations import observation_rescaling
from agents.studies.hostile_controllers import Hostile
from baselines.batch_controllers import Rescaled
from shake_env.controller import Controller, decide
from shake_env.files import write_json
from shake_env.safety.supervisor import Supervised
from shake_env.scenario.limits import REASONS
from shake_env.scenario.observation import ObservationLayout
from shake_env.scenario.presets import laboratory
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uncertainty, Uniform
from shake_env.simulation.simulation import Simulation

SPECIMENS = Uncertainty(mass_ratio=Uniform(0.1, 1.0), storey_frequency=Uniform(5.0, 9.0))
ONSET = (20, 200)  # control periods; a lasting fault begins somewhere between
SPIKES, LOST = 0.02, 0.1  # [-] share of the readings
FULL_SCALE = 1e3  # [-] of a laboratory sensor's noise
Fault = Callable[[int, NDArray[np.float32]], NDArray[np.float32]]


@dataclass(frozen=True)
class Case:
    """One row of the study."""

    name: str
    sensor: str | None = None  # "frozen", "dead", "missing", "spikes", "lost", "stale", "late", "offset"
    signal: str | None = None
    offset: float = 0.0  # [SI]
    delay: float | None = None  # [physics steps]
    factors: dict[str, float] = field(default_factory=dict)  # on the actuator's parameters
    required: bool = True  # whether the supervisor is to hold it

    def table(self, nominal: Scenario) -> Scenario:
        """Return the scenario that is driven."""
        actuator = replace(
            nominal.actuator,
            **{name: factor * getattr(nominal.actuator, name) for name, factor in self.factors.items()},
        )
        delay = nominal.delay if self.delay is None else self.delay
        return replace(nominal, actuator=actuator, delay=delay)


def _cases() -> list[Case]:
    signals = ("table_displacement", "table_velocity", "spool_position", "load_pressure")
    cases = [Case("no fault")]
    for signal in (*signals, "table_acceleration"):
        title = signal.replace("_", " ")
        cases += [Case(f"{kind} {title}", kind, signal) for kind in ("frozen", "dead")]
    cases.append(Case("missing table velocity (NaN)", "missing", "table_velocity"))
    cases += [
        Case("2 % spikes of full scale in every channel", "spikes"),
        Case("10 % lost samples, the last one shown again", "lost"),
        Case("10 % of each channel's readings lost, the last one shown again", "stale"),
        Case("observation one period late", "late"),
        Case("loop delay 4 physics steps", delay=4.0),
    ]
    for name in ("bulk_modulus", "valve_gain"):
        title = name.replace("_", " ")
        cases += [Case(f"{title} x{f}", factors={name: f}) for f in (0.7, 1.3)]
        cases += [Case(f"{title} x{f}", factors={name: f}, required=False) for f in (0.5, 1.5, 2.0)]
    cases += [
        Case(f"loop delay {d:g} physics steps", delay=d, required=False) for d in (7.5, 10.0, 20.0)
    ]
    cases.append(Case("displacement offset 10 mm", "offset", "table_displacement", 0.01, required=False))
    return cases


CASES = {case.name: case for case in _cases()}


def sensor_fault(case: Case, layout: ObservationLayout, lanes: int, seed: int) -> Fault:
    """Return what a case makes of the observations (lanes, n) of each period."""
    r = np.random.default_rng([seed, 99])
    onset, readings = r.integers(*ONSET, lanes), layout.readings
    at = None if case.signal is None else layout.reading_names.index(case.signal) + readings.start
    full = FULL_SCALE * layout.sensor_values("noise") / layout.reading_scale
    last: list[NDArray[np.float32]] = []

    def shown(k: int, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        reading, begun = observation.copy(), k >= onset
        before = last.pop() if last else observation.copy()
        if case.sensor == "frozen":
            reading[begun, at] = before[begun, at]
        elif case.sensor in ("dead", "missing"):
            reading[begun, at] = 0.0 if case.sensor == "dead" else np.nan
        elif case.sensor == "spikes":
            hit = r.random((lanes, len(full))) < SPIKES
            spike = r.choice([-1.0, 1.0], hit.shape) * full
            reading[:, readings] = np.where(hit, spike, reading[:, readings])
        elif case.sensor == "lost":
            hit = r.random(lanes) < LOST
            reading[hit] = before[hit]
        elif case.sensor == "stale":
            hit = r.random((lanes, len(full))) < LOST
            reading[:, readings] = np.where(hit, before[:, readings], reading[:, readings])
        elif case.sensor == "late":
            last.append(observation.copy())
            return before
        elif case.sensor == "offset":
            reading[:, at] += case.offset / layout.reading_scale[(at or 0) - readings.start]
        last.append(reading)
        return reading

    return shown


def broken_limits(
    case: Case, lanes: int, seed: int, steps: int, supervise: Callable[..., Controller] = Supervised
) -> tuple[NDArray[np.int64], Controller]:
    """Drive tables with hostile controllers under a case.

    Parameters
    ----------
    case
        What is wrong.
    lanes
        Number of tables, each with a specimen and a controller of its own.
    seed
        Of specimens, ground, noise, controllers and faults.
    steps
        Control periods.
    supervise
        What makes the supervisor from a controller and the nominal scenario.

    Returns
    -------
    code, supervisor
        (lanes,) 0, or one more than the index in `limits.REASONS`.
    """
    nominal = replace(laboratory(), uncertainty=SPECIMENS)
    true = case.table(nominal)
    supervisor = supervise(Hostile(nominal, lanes, seed), nominal)
    factor = observation_rescaling(true, nominal)
    driving: Controller = supervisor
    if not np.allclose(factor, 1.0, rtol=1e-12, atol=0.0):
        driving = Rescaled(supervisor, factor)
    simulation = Simulation(true, lanes)
    observation = simulation.start(
        range(lanes), [np.random.default_rng([seed, lane]) for lane in range(lanes)]
    )
    fault = sensor_fault(case, nominal.observation, lanes, seed)
    state: tuple[Any, ...] | None = None
    ended = np.zeros(lanes, dtype=bool)
    start, code = np.ones(lanes, dtype=bool), np.zeros(lanes, dtype=np.int64)
    for k in range(steps):
        action, state = decide(driving, fault(k, observation), state, start)
        wanted = np.nan_to_num(action[:, 0].astype(float), posinf=0.0, neginf=0.0)
        result = simulation.step(np.where(ended, 0.0, wanted))
        code = np.where(~ended & result.terminated, result.broken.astype(int), code)
        ended |= result.terminated | result.truncated
        simulation.rest(ended)
        start, observation = ended.copy(), result.observation
    return code, supervisor


def sensor_fault_study(
    cases: Sequence[Case],
    *,
    lanes: int = 80,
    seed: int = 0,
    steps: int = 400,
    on_case: Callable[[str, dict[str, Any]], None] = lambda name, row: None,
) -> dict[str, Any]:
    """Return the result of every case of sensor faults under the supervisor."""
    rows: dict[str, Any] = {}
    for case in cases:
        code, _ = broken_limits(case, lanes, seed, steps)
        broken = {REASONS[c - 1]: int(np.sum(code == c)) for c in np.unique(code[code > 0])}
        rows[case.name] = {
            "broken": int(np.count_nonzero(code)), "limits": broken, "required": case.required,
        }  # fmt: skip
        on_case(case.name, rows[case.name])
    return {"scenario": "laboratory", "lanes": lanes, "seed": seed, "steps": steps, "cases": rows}


def sensor_fault_table(result: dict[str, Any]) -> str:
    """Return the rows of `docs/safety.md` from a result of the study of sensor faults."""
    lines = []
    for required, title in ((True, "held"), (False, "outside")):
        lines += ["", f"| {title} | limits broken, of {result['lanes']} tables |", "|---|---|"]
        for name, row in result["cases"].items():
            if row["required"] == required:
                lines.append(f"| {name} | {row['broken']} |")
    return "\n".join(lines[1:])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study, or print its table."""
    parser = argparse.ArgumentParser(prog="python -m agents.studies.sensor_faults", description=__doc__)
    parser.add_argument("--output", type=Path, help="file that the result is written to, as JSON")
    parser.add_argument("--table", type=Path, help="print the table of this result and run nothing")
    parser.add_argument("--tables", type=int, default=80, help="tables of each case (default 80)")
    parser.add_argument("--seed", type=int, default=0, help="of everything that is drawn (default 0)")
    parser.add_argument(
        "--steps", type=int, default=400, help="control periods of a test (default 400: 2 s)"
    )
    given = parser.parse_args(arguments)
    if given.table is not None:
        print(sensor_fault_table(json.loads(given.table.read_text(encoding="utf-8"))))
        return 0

    def tell(name: str, row: dict[str, Any]) -> None:
        print(f"{name}: {row['broken']} of {given.tables} {row['limits'] or ''}", flush=True)

    result = sensor_fault_study(
        list(CASES.values()), lanes=given.tables, seed=given.seed, steps=given.steps, on_case=tell
    )
    if given.output is not None:
        write_json(given.output, result, 1)
    held = all(not row["broken"] for row in result["cases"].values() if row["required"])
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
