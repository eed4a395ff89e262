"""The capacity of a scenario's own table: its limits, its valve and its specimen."""

from __future__ import annotations

import math

from shake_env.motion.processing import RATED_VELOCITY, SOFT_STROKE, SUPPLY_PRESSURE, TableCapacity
from shake_env.scenario.limits import Limits
from shake_env.scenario.scenario import Scenario


def scenario_capacity(scenario: Scenario) -> TableCapacity:
    """Return what a motion must stay within to be repeated by a scenario's table.

    Displacement and velocity are the shares of the scenario's hard limits that the rating of Table I's
    table (70 mm, 0.6 m/s) has of the laboratory's (76 mm, 0.65 m/s), and the rating itself where the
    scenario has no such limit. The stroke also ends at the stops, the velocity at the steady flow of the
    largest current and of the spool's limit. The pressure is the limit of the load pressure or the
    supply's, 21 MPa where there is neither. The acceleration is the lower of the limits of table and
    specimen.
    """
    limits, parts, actuator = scenario.limits, scenario.nonlinearity, scenario.actuator
    laboratory = Limits.laboratory()
    assert laboratory.table_displacement is not None and laboratory.table_velocity is not None
    stroke, velocity = SOFT_STROKE, RATED_VELOCITY
    if limits.table_displacement is not None:
        stroke *= limits.table_displacement / laboratory.table_displacement
    if limits.table_velocity is not None:
        velocity *= limits.table_velocity / laboratory.table_velocity
    flow = actuator.flow_gain / actuator.piston_area  # [1/s] velocity over spool position
    spool = min(parts.valve.spool_limit, scenario.current_limit * actuator.valve_gain)
    pressures = [parts.valve.supply_pressure, limits.load_pressure or math.inf]
    pressure = min(pressures) if math.isfinite(min(pressures)) else SUPPLY_PRESSURE
    accelerations = (limits.table_acceleration, limits.specimen_acceleration)
    return TableCapacity(
        displacement=min(stroke, parts.stops.gap),
        velocity=min(velocity, flow * spool),
        acceleration=min((value for value in accelerations if value is not None), default=math.inf),
        force=pressure * actuator.piston_area,
        moving_mass=actuator.table_mass + scenario.specimen.mass,
        table_damping=actuator.table_damping,
    )
