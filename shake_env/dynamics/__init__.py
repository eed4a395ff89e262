"""The update of one control period, in the array API; ground and reference specimen."""

from shake_env.dynamics.ground import GroundMaps, GroundPeriod, GroundRowLayout, filter_state
from shake_env.dynamics.linear import PeriodResponse, TableDynamics, as_like
from shake_env.dynamics.nonlinear import (
    NonlinearDynamics,
    apply,
    arrival,
    commands_under_way,
    controlled_plant,
    controlled_scale,
    floor_rows,
    specimen_with_slip,
)
from shake_env.dynamics.yielding_reference import YieldingReference

__all__ = [
    "GroundMaps",
    "GroundPeriod",
    "GroundRowLayout",
    "NonlinearDynamics",
    "PeriodResponse",
    "TableDynamics",
    "YieldingReference",
    "apply",
    "arrival",
    "as_like",
    "commands_under_way",
    "controlled_plant",
    "controlled_scale",
    "filter_state",
    "floor_rows",
    "specimen_with_slip",
]
