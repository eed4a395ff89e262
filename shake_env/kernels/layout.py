"""Where the compiled step finds what it needs: one table of names, from which every place follows.

A compiled function is called in a tenth of a microsecond if it takes one number. It takes the address of
a table of whole numbers: sizes, addresses, and where each field lies. What tables carry from period to
period lies in records, one a block of tables, of rows with a number each table (:data:`FIELDS`).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

# What a step reports, in SI, in the order of `env.INFO_KEYS`; then the reward, and the broken limit's
# code.
REPORT = (
    "table_acceleration", "target_acceleration", "base_shear", "reference_base_shear", "current",
    "table_displacement", "table_velocity", "load_pressure", "acceleration_cost", "force_cost",
    "current_cost", "limit_cost", "soft_limit_cost", "reward", "broken",
)  # fmt: skip
INFO = REPORT[:13]
LIMIT_COST, REWARD, BROKEN = (REPORT.index(name) for name in ("limit_cost", "reward", "broken"))

# Rows of a record. Whole numbers: key, period, cursor, shape and recorded.
FIELDS = (
    "key",  # (2) of the episode's random numbers
    "period",  # control periods of ground computed since the start
    "cursor",  # slot of the ring that holds the present period, the same for all tables of a block
    "shape",  # number of the motion's history or envelope
    "recorded",  # 1 where the motion is a record
    "amplitude",
    "severity",  # motionless cost of the motion over the unit target's
    "weights",  # (3) of the stage cost
    "coulomb",  # [N]
    "valve",  # (3) see NonlinearDynamics
    "state",  # of the plant, the sensors' low-passes in it, then commands under way
    "current",  # [A] of this period; behind the state, as products take both
    "response",  # (2 k) accelerations of the table, then base shears
    "floors",  # accelerations [m/s^2]
    "bias",  # offsets of this episode
    "gain",  # gain errors of this episode [-]
    "noise",  # standard normal numbers of the readings
    "reading",  # over its scale
    "action",
    "past",  # earlier readings and actions, newest first
    "slipping",  # yielding reference where the ground is computed
    "last_target",  # there
    "ring",  # slots of a period's ground each: filter, reference, targets, shears, drive
)
# Matrices, each (columns, rows), common or one a table.
MATRICES = (
    "noise_map", "record_map", "yield_step", "yield_change", "yield_shear", "advance", "change",
    "outputs", "arrival", "floor_map",
)  # fmt: skip
# Vectors of numbers: scalars of the nonlinear parts and of the step, then what each reading or row has.
SCALARS = (
    "excess", "stribeck_velocity", "smoothing_velocity", "viscous", "rated_pressure", "supply_sag",
    "spool_limit", "dead_band", "rate_limit", "gap", "stiffness", "damping", "yield_drift", "exponent",
    "current_limit", "limit_rate", "limit_steps", "soft_share", "soft_weight", "displacement_limit",
    "velocity_limit", "pressure_limit", "acceleration_limit", "command_limit", "floor_limit",
    "observation_bound",
)  # fmt: skip
VECTORS = (
    "bounds", "inverse_scales", "resolution", "rounded", "reading_scale", "rms", "offset", "gain_error",
)  # fmt: skip
# Room to work in, rows of a block each.
ROOM = ("x", "y", "later", "outputs", "arriving", "samples", "look")
SIZES = (
    "first", "last", "mode", "tables", "padded", "record_size", "matrices_size", "own", "order",
    "commands", "controlled", "substeps", "stories", "filter", "reference", "drive", "width", "stride",
    "slots", "ahead", "rank", "draws", "lifted", "yielding", "readings", "entry", "history", "shown",
    "segments", "columns", "flow", "force", "rate", "slips", "friction", "static", "spool_velocity",
    "whole_exponent", "storeys_seen", "floor_columns",
)  # fmt: skip
ADDRESSES = (
    "records", "matrices", "numbers", "room", "given", "counters", "shapes", "sources", "signals",
    "report", "seen", "ends",
)  # fmt: skip

PLACES = {
    name: place
    for place, name in enumerate(
        (
            *SIZES,
            *(f"at_{name}" for name in ADDRESSES),
            *(f"row_{name}" for name in FIELDS),
            *(f"matrix_{name}" for name in MATRICES),
            *(f"vector_{name}" for name in VECTORS),
            *(f"room_{name}" for name in ROOM),
        )
    )
}
SCALAR = {name: place for place, name in enumerate(SCALARS)}
STEP, GROUND, START = range(
    3
)  # what a call does: a control period, its ground alone, or a table at rest
TERMINATED, TRUNCATED = 1, 2  # bits that a call returns
ZEROS, ONES = 0, 1  # shapes that stand for no history and no envelope

IntArray = NDArray[np.int64]


def table(values: Mapping[str, int]) -> IntArray:
    """Return a table with the given values, and zeros elsewhere."""
    made = np.zeros(len(PLACES), dtype=np.int64)
    for name, value in values.items():
        made[PLACES[name]] = value
    return made
