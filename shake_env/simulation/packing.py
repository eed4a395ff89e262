"""A scenario's numbers as the compiled step takes them; the places are named in `kernels.layout`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.dynamics.ground import GroundRowLayout
from shake_env.dynamics.linear import TableDynamics
from shake_env.kernels.layout import FIELDS, MATRICES, ROOM, SCALARS, VECTORS
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import TABLE_DISPLACEMENT
from shake_env.scenario.limits import OBSERVATION_BOUND, REASONS
from shake_env.simulation.engine import Tables
from shake_env.simulation.excitation import periods_ahead

IntArray = NDArray[np.int64]
BEHIND = 32  # numbers behind those of a table alone, which it reads and never uses
MOST_REPEATED = 16  # a whole exponent up to which a power is repeated multiplication


def rounded_up(count: int, multiple: int) -> int:
    """Return the next multiple of a whole number, or the number itself if it is one."""
    return -(-count // multiple) * multiple


@dataclass(frozen=True)
class Packed:
    """What the compiled step of a scenario reads and never writes, and where its fields lie."""

    sizes: dict[str, int]  # by name of layout.SIZES
    rows: dict[str, slice]  # of a record, by name of layout.FIELDS
    room: dict[str, slice]  # likewise, of the room to work in
    record_rows: int
    room_rows: int
    numbers: FloatArray
    vectors: dict[str, int]  # where each begins in the numbers
    matrices: dict[str, tuple[int, int]]  # where each begins, and its length
    matrices_size: int
    # (segments, 5) of an observation: first entry, entries, row, periods ahead, and rows of a slot or 0
    sources: IntArray
    signals: IntArray  # (s,) row of each reading's signal


def pack(tables: Tables, block: int) -> Packed:
    """Lay out a scenario's tables for the compiled engine, in blocks of 1 or more."""
    sizes = _sizes(tables)
    rows, record_rows = _slices(_field_rows(sizes, block), FIELDS)
    sources = _sources(tables, sizes, rows)
    sizes["segments"] = len(sources)
    room, room_rows = _slices(_room_rows(sizes, block), ROOM)
    numbers, vectors = _numbers(tables, sizes)
    places, start = {}, 0
    for name, matrix in packed_matrices(tables, columns_of(tables)).items():
        places[name] = (start, int(np.prod(matrix.shape[-2:])))
        start += places[name][1]
    return Packed(
        sizes=sizes,
        rows=rows,
        room=room,
        record_rows=record_rows + BEHIND // 4,
        room_rows=room_rows,
        numbers=numbers,
        vectors=vectors,
        matrices=places,
        matrices_size=start,
        sources=sources,
        signals=_signals(tables, sizes, rows),
    )


def columns_of(tables: Tables) -> tuple[Any, Any]:
    """Return which columns of a table's `advance` and `slope` are kept: none of parts that are off."""
    dynamics = tables.model.dynamics
    if isinstance(dynamics, TableDynamics):
        return slice(None), slice(None)
    switches = _switches(dynamics.parts, dynamics.stories, 0)
    names = ("flow", "force", "rate", *["slips"] * dynamics.stories)
    on = [i for i, name in enumerate(names[: dynamics.slope.shape[-1]]) if switches[name] >= 0]
    linear = dynamics.advance.shape[-1] - dynamics.slope.shape[-1]
    if on == list(range(len(on))):  # a slice is taken several times as fast
        return slice(linear + len(on)), slice(len(on))
    return [*range(linear), *(linear + i for i in on)], on


def packed_matrices(
    tables: Tables, columns: tuple[Any, Any], lanes: Any = None
) -> dict[str, FloatArray]:
    """Return each matrix, (rows, columns) or one a table, in the order of `layout.MATRICES`.

    Where each table has its own, of all, or of the tables `lanes` alone; `columns` as `columns_of`.
    """
    dynamics, reference = tables.model.dynamics, tables.maps.yielding
    own: Any = slice(None) if lanes is None else lanes
    none = np.zeros((*tables.maps.noise[own].shape[:-2], 0, 0))
    made = dict.fromkeys(MATRICES, none)
    made["noise_map"], made["record_map"] = tables.maps.noise[own], tables.maps.record[own]
    if reference is not None:
        parts = (reference.A, reference.ground, reference.ground_next, reference.level)
        made["yield_step"] = np.concatenate([part[own] for part in parts], axis=-1)
        made["yield_change"], made["yield_shear"] = reference.slope[own], reference.C[own]
    if tables.model.floor_rows is not None:
        made["floor_map"] = tables.model.floor_rows[own]
    if isinstance(dynamics, TableDynamics):
        return {**made, "advance": dynamics.matrix}
    used, on = columns
    C, D = dynamics.C[own], dynamics.D[own]
    unheld = np.zeros((*C.shape[:-1], 1))
    return {
        **made,
        "advance": dynamics.advance[own][..., used],
        "change": dynamics.slope[own][..., on],
        "outputs": np.concatenate([C, unheld, D[..., on]], axis=-1),
        "arrival": dynamics.arrival[own],
    }


def lane_rows(tables: Tables, lanes: Any = None) -> dict[str, FloatArray]:
    """Return what stands in a record of each table's plant, (rows,) or one column a table (N, rows).

    Of a table each, of all, or of the tables `lanes` alone.
    """
    cost, dynamics = tables.model.stage_cost, tables.model.dynamics
    own: Any = ... if lanes is None else lanes
    terms = (cost.acceleration, cost.force, cost.current)
    weights = np.stack([np.asarray(term, float)[own] for term in terms], axis=-1)
    if isinstance(dynamics, TableDynamics):
        return {"weights": weights}
    coulomb = np.asarray(dynamics.coulomb)[own][..., None]
    return {"weights": weights, "coulomb": coulomb, "valve": dynamics.valve[own]}


def _switches(parts: Nonlinearity, stories: int, order: int) -> dict[str, int]:
    """Return which parts are on, and where their columns lie; -1: off, its columns left out."""
    widths = {
        "flow": int(parts.valve.flow_active),
        "force": int(parts.friction.active or parts.stops.active),
        "rate": int(math.isfinite(parts.valve.spool_rate_limit)),
        "slips": stories * parts.yielding.active,
    }
    places, start = {}, 0
    for name, width in widths.items():
        places[name] = start if width else -1
        start += width
    first_order = parts.valve.natural_frequency is None
    exponent = parts.yielding.exponent
    repeated = float(exponent).is_integer() and exponent <= MOST_REPEATED
    return {
        **places,
        "columns": start,
        "friction": int(parts.friction.active),
        "static": int(parts.friction.static is not None),
        "spool_velocity": -1 if first_order else order - 1,
        "whole_exponent": int(exponent) if repeated else 0,
    }


def _sizes(tables: Tables) -> dict[str, int]:
    """Return the sizes of a scenario."""
    model, discrete, layout = tables.model, tables.scenario.discrete, tables.scenario.observation
    dynamics, ground, sensing = model.dynamics, GroundRowLayout.from_plant(discrete), layout.sensing
    lifted = isinstance(dynamics, TableDynamics)
    order = model.controlled if isinstance(dynamics, TableDynamics) else dynamics.advance.shape[-2]
    parts = Nonlinearity() if isinstance(dynamics, TableDynamics) else dynamics.parts
    k, ahead = discrete.substeps, periods_ahead(tables.preview, discrete.substeps)
    draws = tables.maps.noise.shape[-1] - ground.ground - ground.reference
    entry = layout.readings_count + sensing.last_action
    floors = model.floor_rows
    return {
        **_switches(parts, discrete.layout.stories, order),
        "own": int(tables.maps.noise.ndim > 2),
        "order": order,
        "commands": dynamics.states - order,
        "controlled": model.controlled,
        "substeps": k,
        "stories": discrete.layout.stories,
        "filter": ground.ground,
        "reference": ground.reference,
        "drive": ground.drive,
        "width": ground.width,
        "stride": rounded_up(ground.width, 8),
        "slots": ahead + 1,
        "ahead": ahead,
        "rank": draws // k,
        "draws": draws,
        "lifted": int(lifted),
        "yielding": int(tables.maps.yielding is not None),
        "readings": layout.readings_count,
        "entry": entry,
        "history": sensing.history * entry,
        "shown": layout.size,
        "storeys_seen": 0 if floors is None else floors.shape[-2],
        "floor_columns": 0 if floors is None else floors.shape[-1],
    }


def _field_rows(sizes: Mapping[str, int], block: int) -> dict[str, int]:
    """Return how many rows of a record each field has."""
    rows = dict.fromkeys(FIELDS, 1)
    s, k = sizes["readings"], sizes["substeps"]
    yields = sizes["yielding"]
    return rows | {
        "key": 2,
        "weights": 3,
        "valve": 3,
        "state": sizes["order"] + sizes["commands"],
        "response": 2 * k,
        "floors": sizes["storeys_seen"],
        "bias": s,
        "gain": s,
        "noise": rounded_up(s, 16 if block == 1 else 4),
        "reading": s,
        "past": sizes["history"],
        "slipping": 3 * sizes["stories"] * yields,
        "last_target": yields,
        "ring": sizes["slots"] * sizes["stride"],
    }


def _room_rows(sizes: Mapping[str, int], block: int) -> dict[str, int]:
    """Return how many rows of room each product and function needs."""
    order, k, n, columns = sizes["order"], sizes["substeps"], sizes["stories"], sizes["columns"]
    exogenous = sizes["filter"] + sizes["reference"]
    drawn = exogenous + rounded_up(sizes["draws"], 16 if block == 1 else 4)
    sums = (order + 2 * k, sizes["reference"] + k + sizes["drive"], 3 * n, sizes["storeys_seen"], k)
    return {
        "x": max(drawn, order + 1 + columns, 4 * n + 2),
        "y": rounded_up(max(sums), 8),
        "later": rounded_up(max(columns, n, 1), 8),
        "outputs": 8,
        "arriving": rounded_up(k, 8),
        "samples": exogenous + k + 1,
        "look": rounded_up(sizes["shown"], 16) // 2,
    }


def _slices(rows: Mapping[str, int], names: Sequence[str]) -> tuple[dict[str, slice], int]:
    places, start = {}, 0
    for name in names:
        places[name] = slice(start, start + rows[name])
        start += rows[name]
    return places, start


def _numbers(tables: Tables, sizes: Mapping[str, int]) -> tuple[FloatArray, dict[str, int]]:
    """Return the scalars and vectors in one array, and where the vectors begin."""
    model = tables.model
    limits, measured, layout = model.limits, model.measurement, model.measurement.layout
    dynamics = model.dynamics
    parts = Nonlinearity() if isinstance(dynamics, TableDynamics) else dynamics.parts
    friction, valve, stops, yielding = parts.friction, parts.valve, parts.stops, parts.yielding
    hard = [math.inf if (limit := getattr(limits, name)) is None else limit for name in REASONS[1:]]
    scalars = dict(
        zip(
            SCALARS,
            (
                0.0 if friction.static is None else friction.static - friction.coulomb,
                friction.stribeck_velocity, friction.smoothing_velocity, friction.viscous,
                valve.rated, valve.supply_sag, valve.spool_limit, valve.dead_band,
                valve.spool_rate_limit, stops.gap, stops.stiffness, stops.damping,
                yielding.yield_drift, yielding.exponent,
                model.current_limit, tables.limit_rate, tables.limit_steps, limits.soft_share,
                limits.soft_weight, *hard, OBSERVATION_BOUND,
            ),
            strict=True,
        )
    )  # fmt: skip
    scale, filter_states = model.observation_scale, sizes["filter"]
    bounds = limits.state_limit * scale[filter_states : filter_states + sizes["controlled"]]
    bounds[TABLE_DISPLACEMENT] = math.inf  # it may drift
    head = scale[: layout.head]
    inverse = np.ones(layout.size)
    inverse[: len(head)] = 1.0 / head
    inverse[layout.preview] = 1.0 / measured.preview_scale
    vectors = (
        bounds, inverse, measured.resolution, measured.rounded, measured.scale,
        measured.rms, measured.offset, measured.gain_error,
    )  # fmt: skip
    starts, start = {}, len(scalars)
    for name, values in zip(VECTORS, vectors, strict=True):
        starts[name] = start
        start += len(values)
    # Numbers behind, which a table alone reads and never uses.
    values = [np.array(list(scalars.values()), dtype=float), *vectors, np.zeros(BEHIND)]
    return np.concatenate(values), starts


def _sources(tables: Tables, sizes: Mapping[str, int], rows: Mapping[str, slice]) -> IntArray:
    """Return where each entry of an observation lies."""
    layout = tables.scenario.observation
    ring, stride, k = rows["ring"].start, sizes["stride"], sizes["substeps"]
    filter_states, reference = sizes["filter"], sizes["reference"]
    sources = [(ring + i, 0, stride) for i in range(filter_states)]
    if layout.sensing.full_state:
        sources += [(rows["state"].start + i, 0, 0) for i in range(sizes["controlled"])]
        sources += [(ring + filter_states + i, 0, stride) for i in range(reference)]
    sources += [(rows["reading"].start + i, 0, 0) for i in range(sizes["readings"])]
    samples, spacing = tables.preview
    for i in range(samples):
        ahead = (i + 1) * spacing - 1
        sources.append((ring + filter_states + reference + ahead % k, 1 + ahead // k, stride))
    sources += [(rows["action"].start, 0, 0)] * layout.sensing.last_action
    sources += [(rows["past"].start + i, 0, 0) for i in range(sizes["history"])]
    segments: list[list[int]] = []
    for i, (row, ahead, rows_of_slot) in enumerate(sources):
        _, count, *place = segments[-1] if segments else (0, 0)
        if count and place == [row - count, ahead, rows_of_slot]:
            segments[-1][1] += 1
        else:
            segments.append([i, 1, row, ahead, rows_of_slot])
    return np.array(segments, dtype=np.int64)


def _signals(tables: Tables, sizes: Mapping[str, int], rows: Mapping[str, slice]) -> IntArray:
    """Return the row of a record that each reading is taken from."""
    k, signal_rows = sizes["substeps"], []
    layout, places = tables.scenario.observation, tables.model.measurement.places
    for name, place in zip(layout.reading_names, places.tolist(), strict=True):
        if place >= 0:
            signal_rows.append(rows["state"].start + place)
        elif name.startswith("floor"):
            signal_rows.append(rows["floors"].start + int(name.rsplit("_", 1)[1]) - 1)
        else:
            last = {"table_acceleration": k - 1, "base_shear": 2 * k - 1}[name]
            signal_rows.append(rows["response"].start + last)
    return np.array(signal_rows, dtype=np.int64)
