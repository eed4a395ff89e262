"""A scenario's numbers in a few flat arrays, as the fused step takes them.

A compiled function is called in a microsecond if its arguments are few. So what a step needs lies in one
vector of numbers, one of whole numbers, and one of matrices; this module says where. What a step brings
lies in one block with a row for each quantity and a column for each table, so that it is one allocation,
and the parts of a `StepResult` are views of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shake_env.dynamics.linear import TableDynamics
from shake_env.model.parameters import FloatArray
from shake_env.scenario.limits import REASONS
from shake_env.scenario.observation import STATE_SIGNALS
from shake_env.simulation.transition import TableModel

IntArray = NDArray[np.int64]

# Rows of a block: first what `info` reports, in its order (see env.INFO_KEYS).
(
    TABLE_ACCELERATION, TARGET_ACCELERATION, BASE_SHEAR, REFERENCE_SHEAR, CURRENT, DISPLACEMENT,
    VELOCITY, PRESSURE, ACCELERATION_COST, FORCE_COST, CURRENT_COST, LIMIT_COST, SOFT_COST, REWARD,
    BROKEN, STATE,
) = range(16)  # fmt: skip

TERMINATED, TRUNCATED = 1, 2  # bits: which ends a period brought to any table

# Numbers, after those of the nonlinear parts (block_kernel.scalars).
PARTS = 13
(
    CURRENT_LIMIT, LIMIT_RATE, LIMIT_STEPS, STATE_LIMIT, SOFT_SHARE, SOFT_WEIGHT, PREVIEW_SCALE, ONE,
    LIMITS,
) = range(PARTS, PARTS + 9)  # fmt: skip
SCALES = LIMITS + len(REASONS)  # the limits in the order of REASONS, infinite where off; then the scales

# Whole numbers, after the switches of the nonlinear parts (block_kernel.switches).
SWITCHES = 9
(
    LIFTED, ORDER, COMMANDS, SUBSTEPS, CONTROLLED, FILTER, REFERENCE, DRIVE, FLOOR_COLUMNS, FLOORS,
    READINGS, FULL_STATE, SAMPLES, SPACING, LAST_ACTION, HISTORY, RESPONSE, FLOOR_ROW, FILTERED, ACTION,
    PAST, ROWS, DEPTH, STRIDE, ADVANCE, CHANGE, OUTPUTS, FLOOR_MAP, ARRIVAL, COULOMB, SPOOL_RATE, COST,
    FOLLOW, RESOLUTION, ROUNDED, READING_SCALE, GIVEN, OWN, COUNTERS, ROOM, SIGNALS,
) = range(SWITCHES, SWITCHES + 41)  # fmt: skip
MATRICES = (ADVANCE, CHANGE, OUTPUTS, FLOOR_MAP, ARRIVAL, COULOMB, SPOOL_RATE, COST)
# Where a reading comes from: a state by its place, or one of these; floors from FLOOR_SIGNAL on.
ACCELERATION_SIGNAL, SHEAR_SIGNAL, FLOOR_SIGNAL = 1000, 1001, 1002


@dataclass(frozen=True)
class Packed:
    """The arrays of a model and a number of tables, and parts of them that have names.

    The numbers hold in turn: those of the model, the matrices, the action, what tables have of their
    own, and room to work in. The whole numbers: places, sensors' signals, counters.
    """

    numbers: FloatArray  # (...)
    places: IntArray  # (...)
    matrices: FloatArray  # (blocks, ..., 1 or lanes of a block) each matrix (columns, rows), a view
    action: FloatArray  # (N,) a view
    own: FloatArray  # (1 + s, N) severity of each table's motion, then offsets of its sensors, a view
    counters: IntArray  # (2, N) periods since each table's start, and in its episode, a view
    block: int  # tables in a block of matrices


def pack(
    model: TableModel,
    lanes: int,
    *,
    limit_rate: float,
    limit_steps: int | None,
    preview: tuple[int, int],
    parts: FloatArray,
    switches: IntArray,
    block: int,
) -> Packed:
    """Lay out a model for `lanes` tables.

    Parameters
    ----------
    model
        In numpy; of a fleet, its matrices one a lane.
    lanes
        Number of tables.
    limit_rate, limit_steps
        What breaking a limit costs a control period that remains, and the most periods that count.
    preview
        Number of target samples shown ahead, and the physics steps between them.
    parts, switches
        Of the nonlinear parts; see `block_kernel`.
    block
        Tables that are stepped side by side.
    """
    dynamics, layout, sensing = (
        model.dynamics,
        model.measurement.layout,
        model.measurement.layout.sensing,
    )
    lifted = isinstance(dynamics, TableDynamics)
    order = model.controlled if isinstance(dynamics, TableDynamics) else dynamics.advance.shape[-2]
    commands, substeps = dynamics.states - order, dynamics.substeps
    stories = layout.plant.specimen.stories
    floors, readings = 0 if model.floor_rows is None else stories, layout.readings_count
    history = sensing.history * (readings + sensing.last_action)
    limits, measured = model.limits, model.measurement
    # Two steps: the switches are counted before the matrices, whose columns they decide.
    p = np.zeros(SIGNALS + readings + 2 * lanes, dtype=np.int64)
    p[COUNTERS] = SIGNALS + readings
    p[:SWITCHES] = switches
    p[LIFTED], p[ORDER], p[COMMANDS], p[SUBSTEPS] = lifted, order, commands, substeps
    p[CONTROLLED], p[FILTER], p[REFERENCE] = model.controlled, model.filter_states, 2 * stories
    felt = layout.plant.equations.specimen_feels_target
    p[DRIVE] = order + 2 * substeps if felt else 0
    p[FLOORS] = floors
    p[FLOOR_COLUMNS] = 0 if model.floor_rows is None else model.floor_rows.shape[-1]
    p[READINGS], p[FULL_STATE] = readings, sensing.full_state
    p[SAMPLES], p[SPACING] = preview
    p[LAST_ACTION], p[HISTORY] = sensing.last_action, history
    widths = (order + commands, 2 * substeps, floors, readings, 1, history)
    row = STATE
    for place, width in zip((RESPONSE, FLOOR_ROW, FILTERED, ACTION, PAST, ROWS), widths, strict=True):
        row += width
        p[place] = row
    if (len(parts), len(switches)) != (PARTS, SWITCHES):
        raise AssertionError(f"{len(parts)} scalars, {len(switches)} switches: see block_kernel")
    scales = (
        model.observation_scale, measured.follow, measured.resolution, measured.rounded, measured.scale,
    )  # fmt: skip
    at = SCALES + len(scales[0])
    for place, values in zip((FOLLOW, RESOLUTION, ROUNDED, READING_SCALE), scales[1:], strict=True):
        p[place], at = at, at + len(values)
    p[SIGNALS : p[COUNTERS]] = [_signal(name) for name in layout.reading_names]
    chosen = [math.inf if (limit := getattr(limits, name)) is None else limit for name in REASONS[1:]]
    numbers = np.concatenate(
        [
            parts,
            [model.current_limit, limit_rate, math.inf if limit_steps is None else limit_steps],
            [limits.state_limit, limits.soft_share, limits.soft_weight, measured.preview_scale, 1.0],
            [math.inf, *chosen],
            *scales,
        ]
    ).astype(np.float64)
    own = isinstance(model.stage_cost.acceleration, np.ndarray)
    depth = min(lanes, block) if own else 1
    # Strides off the powers of two, which share few cache lines.
    depth += 8 if depth > 8 else 0
    start = at = len(numbers)
    for place, matrix in zip(MATRICES, _matrices(model, p), strict=True):
        p[place], at = at, at + depth * math.prod(matrix.shape[-2:])
    size, blocks = at - start, -(-lanes // block) if own else 1
    p[DEPTH], p[STRIDE] = depth, size if own else 0
    at = start + blocks * size
    p[GIVEN], p[OWN], p[ROOM] = at, at + lanes, at + (2 + readings) * lanes
    # More rows than a step uses.
    room = 4 * order + 8 * substeps + 8 * stories + readings + layout.size + 64
    held = np.zeros(p[ROOM] + room * min(lanes, block))
    held[:start] = numbers
    packed = Packed(
        numbers=held,
        places=p,
        matrices=held[start:at].reshape(blocks, size // depth, depth),
        action=held[p[GIVEN] : p[OWN]],
        own=held[p[OWN] : p[ROOM]].reshape(1 + readings, lanes),
        counters=p[p[COUNTERS] :].reshape(2, lanes),
        block=block,
    )
    fill(packed, model, range(lanes) if own else [0])
    return packed


def fill(packed: Packed, model: TableModel, lanes: Sequence[int]) -> None:
    """Take the matrices of some lanes from the model, whose stacks have changed."""
    index = np.asarray(lanes, dtype=int)
    common = not packed.places[STRIDE]
    start = 0
    for matrix in _matrices(model, packed.places):
        rows, columns = matrix.shape[-2:]
        own = (
            (matrix[None] if common else matrix[index])
            .swapaxes(-1, -2)
            .reshape(len(index), rows * columns)
        )
        part = packed.matrices[:, start : start + rows * columns]
        part[index // packed.block, :, index % packed.block] = own.reshape(len(index), rows * columns)
        start += rows * columns


def _matrices(model: TableModel, p: IntArray) -> list[FloatArray]:
    """Return each matrix, (rows, columns) or one a lane, in the order of :data:`MATRICES`."""
    cost = model.stage_cost
    batch = np.shape(cost.acceleration)
    none = np.zeros((*batch, 0, 0))
    floors = none if model.floor_rows is None else model.floor_rows
    weights = np.stack(
        [np.asarray(c, dtype=float) for c in (cost.acceleration, cost.force, cost.current)], axis=-1
    )[..., None]
    dynamics = model.dynamics
    if isinstance(dynamics, TableDynamics):
        return [dynamics.matrix, none, none, floors, none, none, none, weights]
    # Columns of parts that are off are left out.
    on = np.asarray([p[min(j, 3)] >= 0 for j in range(dynamics.slope.shape[-1])])
    kept = np.concatenate([np.ones(dynamics.advance.shape[-1] - len(on), dtype=bool), on])
    unheld = np.zeros((*dynamics.C.shape[:-1], 1))
    return [
        dynamics.advance[..., kept],
        dynamics.slope[..., on],
        np.concatenate([dynamics.C, unheld, dynamics.D[..., on]], axis=-1),
        floors,
        dynamics.arrival,
        np.asarray(dynamics.coulomb)[..., None, None],
        dynamics.spool_rate[..., None],
        weights,
    ]


def _signal(name: str) -> int:
    if name in STATE_SIGNALS:
        return STATE_SIGNALS[name]
    if name.startswith("floor"):
        return FLOOR_SIGNAL + int(name.rsplit("_", 1)[1]) - 1
    return {"table_acceleration": ACCELERATION_SIGNAL, "base_shear": SHEAR_SIGNAL}[name]
