"""The table of a scenario, specimen and sensors included, as a program: current in, signals out.

It is what `shake_env.simulation.transition` steps: the same discretised model with its nonlinear parts,
loop delay and sensors. The sensors have their low-passes and resolution, and neither noise nor offset.
The target is no part of it, for in the corrected equations a table feels its current only.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import shake_env
from agents.deployment.channels import Channel, current_channel, named_channels
from agents.deployment.controller_program import comment_text, usual_prefix, valve_numbers
from agents.deployment.program import Block, Precision, Program, flat
from agents.provenance import code_version
from shake_env.dynamics.linear import TableDynamics
from shake_env.dynamics.nonlinear import NonlinearDynamics, floor_rows
from shake_env.errors import ScenarioError
from shake_env.model.parameters import ModelEquations
from shake_env.scenario.digest import scenario_digest
from shake_env.scenario.observation import UNITS
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.transition import TableModel

SIGNALS = (
    "table_displacement", "table_velocity", "table_acceleration", "load_pressure", "spool_position",
    "base_shear",
)  # fmt: skip


def plant_program(
    scenario: Scenario, precision: Precision = "float64", prefix: str | None = None
) -> Program:
    """Return the nominal table of a scenario as a program.

    Raises
    ------
    ScenarioError
        If the equations are the printed ones, where the target drives the specimen directly.
    """
    if scenario.equations != ModelEquations():
        raise ScenarioError("equations", scenario.equations, "the exported table needs corrected ones")
    model = TableModel.from_scenario(scenario)
    block = _table(model.dynamics, scenario, *_sensors(scenario))
    provenance = {
        "program": f"shake-env {shake_env.__version__}, {code_version() or 'not a git checkout'}",
        "plant": "nominal table, specimen and sensors; sensors without noise and offset",
        "scenario": f"{scenario.name}, digest {scenario_digest(scenario)}",
    }
    return Program(
        name=prefix or usual_prefix("table", scenario, precision),
        title=comment_text(f"Shake table with specimen and sensors, scenario {scenario.name}"),
        block=block,
        inputs=(current_channel(scenario),),
        outputs=output_channels(scenario),
        period=scenario.control_period,
        accepts_any_input=False,
        provenance={key: comment_text(text) for key, text in provenance.items()},
        valve=valve_numbers(scenario.parts.valve),
        precision=precision,
        rounds_inputs=False,
    )


def output_channels(scenario: Scenario) -> tuple[Channel, ...]:
    """Return what the table gives, in SI: its signals, the floors' accelerations, the readings."""
    floors = [f"floor_acceleration_{i + 1}" for i in range(scenario.specimen.stories)]
    readings = scenario.observation.reading_names
    names = [*(f"{name} [{UNITS[name]}]" for name in SIGNALS), *(f"{f} [m/s^2]" for f in floors)]
    names += [f"measured {name} [{UNITS.get(name, 'm/s^2')}]" for name in readings]
    return named_channels(names, np.ones(len(names)))


def _sensors(scenario: Scenario) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Return arrays, integers and numbers of the outputs."""
    measurement, layout = TableModel.from_scenario(scenario).measurement, scenario.observation
    arrays: dict[str, Any] = {"floors": floor_rows(scenario.plant, scenario.nonlinearity.yielding)}
    integers: dict[str, Any] = {}
    if layout.reading_names:
        order = [channel.name for channel in output_channels(scenario)]
        arrays["resolution"] = measurement.resolution
        placed = zip(layout.reading_names, measurement.places.tolist(), strict=True)
        integers["places"] = [place if place >= 0 else order.index(name) for name, place in placed]
        integers["from_state"] = (measurement.places >= 0).astype(int).tolist()
        integers["rounds"] = measurement.rounded.astype(int).tolist()
    return arrays, integers, {"s": len(layout.reading_names)}


def _table(
    dynamics: TableDynamics | NonlinearDynamics,
    scenario: Scenario,
    arrays: dict[str, Any],
    integers: dict[str, Any],
    numbers: dict[str, Any],
) -> Block:
    numbers["limit"] = scenario.current_limit
    if isinstance(dynamics, TableDynamics):
        n, k = dynamics.states, dynamics.substeps
        arrays["matrix"] = dynamics.matrix[[*range(n), n + k - 1, n + 2 * k - 1]]
        numbers["n"] = n
        kind, summary = "linear_table", "linear table and specimen, one period at once"
    else:
        parts = dynamics.parts
        arrays |= {name: getattr(dynamics, name) for name in ("advance", "slope", "C", "D", "arrival")}
        m, q = dynamics.slope.shape
        valve = parts.valve
        numbers |= {
            "m": m, "q": q, "k": dynamics.substeps, "c": dynamics.arrival.shape[1] - 1,
            "stories": dynamics.stories, "flow_active": valve.flow_active,
            "friction": {**vars(parts.friction), "active": parts.friction.active},
            "coulomb": float(dynamics.coulomb),
            "stops": {**vars(parts.stops), "active": parts.stops.active},
            "yields": parts.yielding.active, "yielding": vars(parts.yielding),
            "spool_limit": valve.spool_limit if math.isfinite(valve.spool_limit) else None,
            "rate_limit": valve.spool_rate_limit if math.isfinite(valve.spool_rate_limit) else None,
            "second_order": valve.natural_frequency is not None,
            "rate_on_spool": dynamics.valve[0], "rate_on_current": dynamics.valve[1],
        }  # fmt: skip
        kind, summary = "nonlinear_table", "table and specimen with nonlinear parts, in physics steps"
    return Block(
        kind,
        summary,
        {name: flat(array) for name, array in arrays.items()},
        integers=integers,
        numbers=numbers,
    )
