"""The capacity of a scenario's own table: its limits, its valve and its specimen."""

from __future__ import annotations

import math

from shake_env.motion.processing import RATED_VELOCITY, SOFT_STROKE, SUPPLY_PRESSURE, TableCapacity
from shake_env.scenario.limits import Limits
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.tables.table import DEFAULT_TABLE, TABLE_NAMES, named_table


def scenario_capacity(scenario: Scenario) -> TableCapacity:
    """Return what a motion must stay within to be repeated by a scenario's table.

    Displacement and velocity are the shares of the scenario's hard limits that the rating of Table I's
    table (70 mm, 0.6 m/s) has of the laboratory's (76 mm, 0.65 m/s); where the scenario has no such
    limit, the rating of the table that it names. The stroke also ends at the stops, the velocity at the
    steady flow of the largest current and of the spool's limit. The pressure is the limit of the load
    pressure or the supply's; where there is neither, the named table's. The acceleration is the lower of
    the limits of table and specimen.
    """
    limits, parts, actuator = scenario.limits, scenario.nonlinearity, scenario.actuator
    laboratory = Limits.laboratory()
    assert laboratory.table_displacement is not None and laboratory.table_velocity is not None
    stroke, velocity, rated_pressure = SOFT_STROKE, RATED_VELOCITY, SUPPLY_PRESSURE
    displacement_limit, velocity_limit = limits.table_displacement, limits.table_velocity
    if scenario.table != DEFAULT_TABLE and scenario.table in TABLE_NAMES:
        table = named_table(scenario.table)
        displacement_limit = displacement_limit or table["stroke"]
        velocity_limit = velocity_limit or table.velocity_abort
        rated_pressure = table.load_pressure
    if displacement_limit is not None:
        stroke *= displacement_limit / laboratory.table_displacement
    if velocity_limit is not None:
        velocity *= velocity_limit / laboratory.table_velocity
    flow = actuator.flow_gain / actuator.piston_area  # [1/s] velocity over spool position
    spool = min(parts.valve.spool_limit, scenario.current_limit * actuator.valve_gain)
    pressures = [parts.valve.supply_pressure, limits.load_pressure or math.inf]
    pressure = min(pressures) if math.isfinite(min(pressures)) else rated_pressure
    accelerations = (limits.table_acceleration, limits.specimen_acceleration)
    return TableCapacity(
        displacement=min(stroke, parts.stops.gap),
        velocity=min(velocity, flow * spool),
        acceleration=min((value for value in accelerations if value is not None), default=math.inf),
        force=pressure * actuator.piston_area,
        moving_mass=actuator.table_mass + scenario.specimen.mass,
        table_damping=actuator.table_damping,
    )
