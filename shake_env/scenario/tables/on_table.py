"""A scenario on another table: what belongs to a table, and how the rest follows from its capacity."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from shake_env.errors import ScenarioError
from shake_env.model.nonlinearity import StrokeStops
from shake_env.model.parameters import TABLE_MASS, Actuator, GroundFilter, Specimen
from shake_env.model.plant import REFERENCE_CURRENT, ground_filter, stationary_covariance
from shake_env.motion.processing import RATED_VELOCITY, fit_amplitude
from shake_env.motion.targets import FilteredNoise, Motion, MotionSet
from shake_env.scenario.capacity import scenario_capacity
from shake_env.scenario.limits import Limits
from shake_env.scenario.observation import Sensing
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.tables.table import Table

# Peaks over rms of the filtered noise. With the laboratory's 0.22, the peak displacement of 1000
# earthquakes is 65 mm at 99.9 %: 4.3 of its rms.
PEAK = 4.6
# Steady velocity of the objective's unit of input, over the rated velocity: as 25 mA with Table I.
UNIT_VELOCITY = REFERENCE_CURRENT * Actuator().velocity_gain / RATED_VELOCITY


def rated_input(table: Table) -> float:
    """Return the input [A or V] whose cost is that of 25 mA on the table of Table I."""
    return UNIT_VELOCITY * table["velocity"] / table.actuator.velocity_gain


def noise_amplitude(table: Table, specimen: Specimen, ground: GroundFilter) -> float:
    """Return the amplitude of filtered noise that a table can repeat, to two digits downwards.

    Peaks of displacement, velocity and of the force on table and specimen as one mass stay within
    stroke, rated velocity and force.
    """
    source = ground_filter(ground)
    variance = stationary_covariance(source.A, source.B)
    acceleration = float(np.sqrt(source.C[0] @ variance @ source.C[0]))
    displacement, velocity = np.sqrt(np.diag(variance))[-2:]
    force = (table["table_mass"] + specimen.mass) * acceleration
    limits = Limits.laboratory()
    largest = min(
        limits.soft_share * table["stroke"] / displacement,
        table["velocity"] / velocity,
        table.force / force,
        table["acceleration_abort"] / (2.0 * acceleration),
    )
    amplitude = float(largest) / PEAK
    digit = 10.0 ** (math.floor(math.log10(amplitude)) - 1)
    return round(math.floor(amplitude / digit + 1e-9) * digit, 12)


def table_limits(table: Table) -> Limits:
    """Return the limits at which a table's controller ends a test."""
    return replace(
        Limits.laboratory(),
        table_displacement=table["stroke"],
        table_velocity=table.velocity_abort,
        load_pressure=table.load_pressure,
        table_acceleration=table["acceleration_abort"],
        specimen_acceleration=2.0 * table["acceleration_abort"],
    )


def on_table(scenario: Scenario, table: Table) -> Scenario:
    """Return a scenario on a table; on the one that it has, as it is.

    The specimen keeps its mass ratio, storeys and frequencies. Actuator, input limit and its weight,
    control rate and steps are the new table's. Limits, stops, friction, valve, delay, sensors' ranges
    and the amplitude of the motion follow where the scenario has limits or such parts.

    Raises
    ------
    ScenarioError
        If the specimen's storeys differ, its mass is above the table's payload, or the scenario has the
        printed equations.
    """
    if table.name == scenario.table:
        return scenario
    return exchanged(scenario, table)


def exchanged(scenario: Scenario, table: Table) -> Scenario:
    """Return a scenario with everything that depends on the table taken from `table`; see `on_table`."""
    actuator = table.actuator
    uniform = scenario.specimen.uniform_values(scenario.actuator.table_mass)
    specimen = Specimen.uniform(**uniform, table_mass=actuator.table_mass)
    if specimen.mass > table["payload"]:
        raise ScenarioError(
            "mass_ratio",
            uniform["mass_ratio"],
            f"makes a specimen of {specimen.mass:.4g} kg; table {table.name} carries at most "
            f"{table['payload']:g} kg",
        )
    limited = scenario.limits.table_displacement is not None
    unit = rated_input(table) / REFERENCE_CURRENT
    weight = scenario.objective.current_weight
    changes = {
        "table": table.name,
        "actuator": actuator,
        "specimen": specimen,
        "objective": replace(scenario.objective, current_weight=weight / unit**2),
        "control_rate": table["control_rate"],
        "physics_step": table["physics_step"],
        "current_limit": table["input_limit"] if limited else scenario.current_limit * unit,
    }
    if scenario.delay:
        changes["delay"] = table["loop_delay"] / table["physics_step"]
    parts = scenario.nonlinearity
    if parts.friction.active:
        parts = replace(parts, friction=table.friction)
    if parts.valve.active:
        parts = replace(parts, valve=table.valve)
    if parts.stops.active:
        parts = replace(parts, stops=StrokeStops(gap=table["stroke"], **_stop(actuator.table_mass)))
    changes["nonlinearity"] = parts
    if limited:
        changes["limits"] = table_limits(table)
    if scenario.sensing.sensors is not None:
        changes["sensing"] = sensors_for(table, scenario.sensing)
    changed = replace(scenario, **changes)  # type: ignore[arg-type]  # each of its own type
    return replace(changed, motion=_fitted(changed, table)) if limited else changed


def _fitted(scenario: Scenario, table: Table) -> Motion:
    """Return the scenario's motion at the amplitude that its table can repeat."""
    motion = scenario.motion
    if isinstance(motion, FilteredNoise):
        return replace(motion, amplitude=noise_amplitude(table, scenario.specimen, scenario.ground))
    if isinstance(motion, MotionSet):
        members = (replace(scenario, motion=member) for member in motion.scaled)
        return MotionSet(tuple(_fitted(member, table) for member in members))  # type: ignore[misc]
    whole = replace(motion, amplitude=1.0)
    capacity = scenario_capacity(scenario)
    return fit_amplitude(whole, capacity, physics_step=scenario.physics_step).motion


def _stop(table_mass: float) -> dict[str, float]:
    """Return stiffness and damping of a stop that stops this mass as Table I's is stopped."""
    default = StrokeStops()
    share = table_mass / TABLE_MASS
    return {"stiffness": default.stiffness * share, "damping": default.damping * share}


def sensors_for(table: Table, sensing: Sensing) -> Sensing:
    """Return sensors whose noise and resolution are to the new table's ranges as before to the old."""
    fresh = Sensing.laboratory(
        displacement=table["stroke"],
        velocity=table.velocity_abort,
        pressure=table.load_pressure,
        spool=table.valve.spool_limit,
        acceleration=table["acceleration_abort"],
    )
    by_signal = {sensor.signal: sensor for sensor in fresh.sensors or ()}
    sensors = tuple(by_signal.get(sensor.signal, sensor) for sensor in sensing.sensors or ())
    return replace(sensing, sensors=sensors)
