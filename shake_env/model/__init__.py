"""Parameters, the coupled plant, its discretisation and its nonlinear parts."""

from shake_env.model.discretization import (
    DiscretePlant,
    DiscreteStateSpace,
    check_directions,
    first_order_hold,
    noise_covariance,
    zero_order_hold,
)
from shake_env.model.inputs import checked_action, checked_options, checked_seed, checked_seeds
from shake_env.model.motor import electric_actuator
from shake_env.model.nonlinearity import Friction, Nonlinearity, ServoValve, StrokeStops, Yielding
from shake_env.model.parameters import (
    Actuator,
    GroundFilter,
    ModelEquations,
    Specimen,
    diagonal,
    require_non_negative,
    require_positive,
    stacked,
)
from shake_env.model.plant import (
    CoupledPlant,
    StateSpace,
    actuator_plant,
    ground_filter,
    specimen_plant,
    submatrix,
)
from shake_env.model.ranges import Range, check, check_ranges, is_number
from shake_env.model.resolution import check_resolution
from shake_env.model.specimens import specimen_from_matrices, specimen_from_modes

__all__ = [
    "Actuator",
    "CoupledPlant",
    "DiscretePlant",
    "DiscreteStateSpace",
    "Friction",
    "GroundFilter",
    "ModelEquations",
    "Nonlinearity",
    "Range",
    "ServoValve",
    "Specimen",
    "StateSpace",
    "StrokeStops",
    "Yielding",
    "actuator_plant",
    "check",
    "check_directions",
    "check_ranges",
    "check_resolution",
    "checked_action",
    "checked_options",
    "checked_seed",
    "checked_seeds",
    "diagonal",
    "electric_actuator",
    "first_order_hold",
    "ground_filter",
    "is_number",
    "noise_covariance",
    "require_non_negative",
    "require_positive",
    "specimen_from_matrices",
    "specimen_from_modes",
    "specimen_plant",
    "stacked",
    "submatrix",
    "zero_order_hold",
]
