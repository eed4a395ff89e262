"""An electric table as the actuator's own model: motor, ball screw and amplifier (docs/theory.md)."""

from __future__ import annotations

import math

from shake_env.errors import ParameterError
from shake_env.model.parameters import Actuator
from shake_env.model.ranges import is_number

# Of an electric table: with an area the motor's force is a pressure, and only their ratios act.
NOMINAL_AREA = 1e-3  # [m^2]
NOMINAL_MODULUS = 1e9  # [Pa]
NOMINAL_FLOW_GAIN = 76.0  # [m^2/s] of Table I; it sets the unit of a spool position that is no length


def electric_actuator(
    *,
    table_mass: float,
    screw_lead: float,
    winding_resistance: float,
    winding_inductance: float,
    torque_constant: float,
    back_emf_constant: float,
    amplifier_lag: float,
    table_damping: float = 0.0,
    table_stiffness: float = 0.0,
) -> Actuator:
    """Return a table on a ball screw, driven by a motor behind a voltage amplifier.

    A motor obeys the equations of an oil column (docs/theory.md): its current times the torque
    constant is the load pressure on a nominal piston of `NOMINAL_AREA`, its resistance the leakage,
    its back-EMF the piston's flow, and the amplifier's voltage, behind a lag, the valve's. The
    input is that voltage: `valve_gain` is in m/V.

    Parameters
    ----------
    table_mass, table_damping, table_stiffness
        As of any table [kg, N s/m, N/m]; the mass contains the rotor's, as it acts on the table.
    screw_lead
        [m] per revolution.
    winding_resistance, winding_inductance
        [ohm, H].
    torque_constant, back_emf_constant
        [N m/A, V s/rad].
    amplifier_lag
        [s] time constant from commanded to applied voltage.

    Raises
    ------
    ParameterError
        If a value is not above zero.
    """
    values = {
        "screw_lead": screw_lead,
        "winding_resistance": winding_resistance,
        "winding_inductance": winding_inductance,
        "torque_constant": torque_constant,
        "back_emf_constant": back_emf_constant,
    }
    for name, value in values.items():
        if not (is_number(value) and 0.0 < value < math.inf):
            raise ParameterError(name, value, "must be a finite number above 0")
    turn = 2.0 * math.pi / screw_lead  # [rad/m]
    pressure = torque_constant * turn / NOMINAL_AREA  # [Pa/A]
    oil = pressure**2 * back_emf_constant / (torque_constant * winding_inductance)  # [Pa/m^3]
    return Actuator(
        table_mass=table_mass,
        table_damping=table_damping,
        table_stiffness=table_stiffness,
        piston_area=NOMINAL_AREA,
        oil_volume=4.0 * NOMINAL_MODULUS / oil,
        bulk_modulus=NOMINAL_MODULUS,
        leakage=winding_resistance / (winding_inductance * oil),
        flow_gain=NOMINAL_FLOW_GAIN,
        valve_gain=NOMINAL_AREA / (back_emf_constant * turn * NOMINAL_FLOW_GAIN),
        valve_time_constant=amplifier_lag,
    )
