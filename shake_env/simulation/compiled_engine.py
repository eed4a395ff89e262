"""The engine whose control period is one compiled call (:mod:`shake_env.kernels.period`).

Imported on first use, where numba is installed; the readable engine stays the reference, and a test
holds this equal to it. What tables carry from period to period lies in records, a block of tables each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.dynamics.drawn_plants import rows_of
from shake_env.dynamics.ground import GroundPeriod, Rows
from shake_env.dynamics.linear import PeriodResponse
from shake_env.kernels.layout import GROUND, ONES, PLACES, START, STEP, ZEROS, table
from shake_env.kernels.period import period_of
from shake_env.kernels.vectors import BLOCK
from shake_env.model.parameters import FloatArray
from shake_env.motion.targets import EpisodeMotion, FilteredNoise, RecordedMotion
from shake_env.scenario.objective import CostTerms
from shake_env.simulation.engine import (
    BoolArray,
    Episode,
    IntArray,
    LaneState,
    Observations,
    StepResult,
    Tables,
)
from shake_env.simulation.excitation import motion_array
from shake_env.simulation.helper_thread import Helpers
from shake_env.simulation.motion_shapes import first_target, initial_filter_state, shape
from shake_env.simulation.output_pool import OutputPool
from shake_env.simulation.packing import BEHIND, lane_rows, matrices, pack
from shake_env.simulation.sensors import SensorMemory
from shake_env.simulation.transition import Outcome

FOREVER = 1 << 62  # control periods of a table that only fills up a block
LINE = 64  # [bytes] of a cache
PIECES = 4  # of the tables for each thread
A_THREAD = 512  # tables that a thread has at least: fewer take no longer than to wake it
_AT_REPORT, _AT_SEEN, _AT_ENDS = (PLACES[f"at_{name}"] for name in ("report", "seen", "ends"))
# What a state holds of each table, by field.
_CARRIED = ("key", "period", "state", "slipping", "last_target")


class CompiledEngine:
    """N tables in records, stepped by `period_of`; see `engine.Engine`."""

    def __init__(self, tables: Tables) -> None:
        self._tables = tables
        lanes = tables.lanes
        self._block = block = 1 if lanes == 1 else BLOCK
        self._blocks = -(-lanes // block)
        self._padded = self._blocks * block
        self._packed = packed = pack(tables, block)
        self._own = bool(packed.sizes["own"])
        depth = block if self._own else 1
        copies = self._blocks if self._own else 1
        self._records = _aligned((self._blocks, packed.record_rows, block))
        self._wholes = self._records.view(np.int64)
        self._record_alone, self._wholes_alone = self._records[0, :, 0], self._wholes[0, :, 0]
        self._memory = _aligned((copies * packed.matrices_size * depth + BEHIND,))
        self._matrices = self._memory[: copies * packed.matrices_size * depth].reshape(
            copies, packed.matrices_size, depth
        )
        self._room = _aligned((packed.room_rows * block,))
        self._given = np.zeros(self._padded)
        self._counters = np.zeros((2, self._padded), dtype=np.int64)
        self._counters[1] = FOREVER
        self.number = 0
        self.step_count, self.episode_steps = self._counters[:, :lanes]
        self.motions: list[EpisodeMotion] = [FilteredNoise()] * lanes
        self._shapes = _Shapes(tables)
        self._rows = Rows.of(tables.scenario.discrete)
        self._fields("shape")[:] = ONES
        self._wholes[:, packed.rows["shape"]] = ONES
        for name, values in lane_rows(tables).items():
            if not self._own:
                self._records[:, packed.rows[name]] = values[:, None]
        self._fields("severity")[:] = 1.0
        self.redrawn(range(lanes))
        self._pool = OutputPool(lanes, self._padded, packed.sizes["shown"])
        self._period = period_of(block)
        self._entries = self._shapes.entries
        self._table = self._new_table(STEP)
        self._address = self._table.ctypes.data
        self._parts: list[IntArray] = []
        self._helpers = self._new_helpers(min(tables.threads, self._blocks * block // A_THREAD))
        self._other = self._new_table(GROUND)
        # Of a table that is stepped alone, whose memory nobody is given.
        pool = OutputPool(1, 1, packed.sizes["shown"])
        alone, address = pool.take()
        self._alone = self._new_table(STEP)
        self._alone[_AT_REPORT], self._alone[_AT_SEEN], self._alone[_AT_ENDS] = pool.addresses(address)
        report, seen, _, _ = pool.views(alone)
        self._report_alone, self._seen_alone = report[:, 0], seen[0]
        self._address_alone = self._alone.ctypes.data

    def _new_table(self, mode: int) -> IntArray:
        """Return a table of places for calls in a mode, for all blocks."""
        packed = self._packed
        depth = self._block if self._own else 1
        return table(
            packed.sizes
            | {
                "first": 0,
                "last": self._blocks,
                "mode": mode,
                "tables": self._tables.lanes,
                "padded": self._padded,
                "record_size": packed.record_rows * self._block,
                "matrices_size": packed.matrices_size * depth if self._own else 0,
                "at_records": self._records.ctypes.data,
                "at_matrices": self._memory.ctypes.data,
                "at_numbers": packed.numbers.ctypes.data,
                "at_room": self._room.ctypes.data,
                "at_given": self._given.ctypes.data,
                "at_counters": self._counters.ctypes.data,
                "at_shapes": self._shapes.entries.ctypes.data,
                "at_sources": packed.sources.ctypes.data,
                "at_signals": packed.signals.ctypes.data,
            }
            | {f"row_{name}": rows.start for name, rows in packed.rows.items()}
            | {f"room_{name}": rows.start for name, rows in packed.room.items()}
            | {f"matrix_{name}": start * depth for name, (start, _) in packed.matrices.items()}
            | {f"vector_{name}": start for name, start in packed.vectors.items()}
        )

    def _new_helpers(self, threads: int) -> Helpers | None:
        """Return what steps the tables by several threads; None where the caller's does it alone."""
        if threads < 2:
            return None
        pieces = min(self._blocks, PIECES * threads)
        bounds = [round(self._blocks * i / pieces) for i in range(pieces + 1)]
        self._rooms = [np.zeros_like(self._room) for _ in range(threads - 1)]
        for room in self._rooms:
            part = self._new_table(STEP)
            part[PLACES["at_room"]] = room.ctypes.data
            self._parts.append(part)
        return Helpers(self._period, [self._table, *self._parts], bounds)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle by making the arrays anew, whose addresses are kept."""
        return _made, (self._tables, self.get_state())

    def _fields(self, name: str) -> FloatArray:
        """Return a field of each block (blocks, rows, block), a view."""
        return self._records[:, self._packed.rows[name]]

    def _of_tables(self, name: str, whole: bool = False) -> Any:
        """Return a field of each table (N, rows), a copy."""
        rows = self._packed.rows[name]
        held = (self._wholes if whole else self._records)[:, rows]
        return np.moveaxis(held, 1, 2).reshape(self._padded, -1)[: self._tables.lanes].copy()

    def _put(self, name: str, values: Any, whole: bool = False) -> None:
        """Write a field of each table (N, rows)."""
        rows = self._packed.rows[name]
        held = np.zeros((self._padded, rows.stop - rows.start), np.int64 if whole else np.float64)
        held[: self._tables.lanes] = values
        target = self._wholes if whole else self._records
        target[:, rows] = np.moveaxis(held.reshape(self._blocks, self._block, -1), 2, 1)

    # Episodes

    def start(self, lanes: Sequence[int], episodes: Sequence[Episode]) -> Observations:
        """Put tables to rest at the beginning of their episodes; return their observations."""
        self.number += 1
        if self._block == 1:
            return self._start_alone(episodes[0])
        index = np.asarray(lanes, dtype=int)
        self.step_count[index] = 0
        self.episode_steps[index] = [each.steps for each in episodes]
        for lane, each in zip(lanes, episodes, strict=True):
            self.motions[lane] = each.motion
        shapes = self._shapes.of([each.motion for each in episodes], self._used)
        self._point_to_shapes()
        shown = np.empty((len(lanes), self._packed.sizes["shown"]), dtype=np.float32)
        blocks = index // self._block
        for number in np.unique(blocks):
            which = np.flatnonzero(blocks == number)
            part = [episodes[int(i)] for i in which]
            shown[which] = self._begin(int(number), index[which] % self._block, part, shapes[which])
        return shown

    def _start_alone(self, episode: Episode) -> Observations:
        """Put the one table to rest at the beginning of its episode; return its observation (1, n)."""
        self.motions[0] = motion = episode.motion
        rows, record, wholes = self._packed.rows, self._record_alone, self._wholes_alone
        self._counters[0, 0], self._counters[1, 0] = 0, episode.steps
        record[rows["state"].start :] = 0.0
        wholes[rows["key"]] = episode.key
        wholes[rows["period"].start] = 0
        wholes[rows["recorded"].start] = isinstance(motion, RecordedMotion)
        record[rows["amplitude"].start] = motion.amplitude
        record[rows["severity"].start] = episode.severity
        wholes[rows["shape"].start] = self._shapes.of([motion], self._used)[0]
        self._point_to_shapes()
        self._set_to_time_zero(record, wholes, episode)
        self._call(START, at_seen=int(self._alone[_AT_SEEN]))
        shown: Observations = self._seen_alone[None].copy()
        return shown

    def _set_to_time_zero(self, record: FloatArray, wholes: IntArray, episode: Episode) -> None:
        """Write ground and specimen at time 0 to a table's record (rows,), where they are not zero."""
        motion, discrete, packed = episode.motion, self._tables.scenario.discrete, self._packed
        if episode.specimen is None and not isinstance(motion, RecordedMotion):
            return
        cursor = int(wholes[packed.rows["cursor"].start])
        slot = packed.rows["ring"].start + cursor * packed.sizes["stride"]
        if episode.specimen is not None:
            specimen, reference = episode.specimen
            floors = packed.rows["state"].start + 4
            record[floors : floors + len(specimen)] = specimen
            record[packed.rows["slipping"]] = reference
            behind = slot + self._rows.ground
            record[behind : behind + self._rows.reference] = reference[: self._rows.reference]
        if not isinstance(motion, RecordedMotion):
            return
        initial = initial_filter_state(motion, discrete.plant.ground, discrete.dt)
        record[slot : slot + len(initial)] = initial
        if packed.sizes["yielding"]:
            record[packed.rows["last_target"]] = first_target(motion, discrete.dt)

    def _point_to_shapes(self) -> None:
        if self._shapes.entries is not self._entries:
            self._entries = self._shapes.entries
            for each in (self._table, self._other, self._alone, *self._parts):
                each[PLACES["at_shapes"]] = self._entries.ctypes.data

    def _used(self) -> set[int]:
        """Return the numbers of the shapes that tables have."""
        return set(self._wholes[:, self._packed.rows["shape"]].ravel().tolist())

    def _begin(
        self, number: int, columns: NDArray[np.intp], episodes: list[Episode], shapes: IntArray
    ) -> Observations:
        """Begin episodes of some tables of one block; return their observations.

        The others of the block must not move: it is done on a copy, of which their columns are not
        taken.
        """
        rows, block = self._packed.rows, self._block
        record = _aligned(self._records[number].shape)
        record[:] = self._records[number]
        wholes = record.view(np.int64)
        record[rows["state"].start :, columns] = 0.0
        wholes[rows["key"], columns] = np.stack([each.key for each in episodes], axis=1)
        wholes[rows["period"], columns] = 0
        wholes[rows["shape"], columns] = shapes
        motions = [each.motion for each in episodes]
        wholes[rows["recorded"], columns] = [isinstance(motion, RecordedMotion) for motion in motions]
        record[rows["amplitude"], columns] = [motion.amplitude for motion in motions]
        record[rows["severity"], columns] = [each.severity for each in episodes]
        for column, each in zip(columns, episodes, strict=True):
            self._set_to_time_zero(record[:, column], wholes[:, column], each)
        shown = self._packed.sizes["shown"]
        seen = np.empty(block * shown + LINE // 4, dtype=np.float32)
        self._call(
            START,
            first=number,
            last=number + 1,
            at_records=record.ctypes.data - number * self._records[0].nbytes,
            at_seen=seen.ctypes.data - 4 * number * block * shown,
        )
        self._records[number][:, columns] = record[:, columns]
        return seen[: block * shown].reshape(block, shown)[columns]

    def _call(self, mode: int, **values: int) -> None:
        """Make a call that is no step, with some places of the table changed."""
        changed = self._other
        changed[PLACES["mode"]] = mode
        names = ("first", "last", "at_records")
        given = {"first": 0, "last": self._blocks, "at_records": self._records.ctypes.data} | values
        for name in (*names, *(set(values) - set(names))):
            changed[PLACES[name]] = given[name]
        self._period(changed.ctypes.data)

    # Steps

    def step(self, action: NDArray[np.floating[Any]]) -> StepResult:
        """Advance every table by one control period under `action` (N,)."""
        self.number += 1
        self._given[: len(action)] = action
        memory, address = self._pool.take()
        addresses = self._pool.addresses(address)
        for place in (self._table, *self._parts):
            place[_AT_REPORT], place[_AT_SEEN], place[_AT_ENDS] = addresses
        helpers = self._helpers
        ended = self._period(self._address) if helpers is None else helpers()
        report, seen, terminated, truncated = self._pool.views(memory)
        return StepResult(self, seen, report, terminated, truncated, ended)

    def step_alone(self, action: float) -> tuple[Observations, list[float], int]:
        """Advance the one table; return its observation (n,), report and `StepResult.ended`."""
        self.number += 1
        self._given[0] = action
        ended = self._period(self._address_alone)
        return self._seen_alone.copy(), self._report_alone.tolist(), ended

    def advance_ground(self) -> tuple[GroundPeriod, FloatArray]:
        """Advance the ground alone; return it, and the noise (N, s) of the readings, SI."""
        self.number += 1
        self._call(GROUND)
        readings = self._packed.sizes["readings"]
        return self.ground(), self._of_tables("noise")[:, :readings] * self._tables.model.measurement.rms

    def ground(self, *, preview: bool = True) -> GroundPeriod:
        """Return the ground of the present period."""
        samples, spacing = self._tables.preview
        if not samples or not preview:
            return self._rows.period(self._present())
        now, *coming = self._known()[:, :, : self._packed.sizes["width"]]
        steps = np.concatenate([row[:, self._rows.target] for row in coming], axis=1)
        return self._rows.period(now, steps[:, spacing - 1 :: spacing][:, :samples])

    def _present(self) -> FloatArray:
        """Return the row of the present period (N, width)."""
        sizes, ring = self._packed.sizes, self._packed.rows["ring"].start
        cursor = int(self._wholes[0, self._packed.rows["cursor"].start, 0])
        start = ring + cursor * sizes["stride"]
        held = np.moveaxis(self._records[:, start : start + sizes["width"]], 1, 2)
        present: FloatArray = held.reshape(self._padded, -1)[: self._tables.lanes].copy()
        return present

    def _known(self) -> FloatArray:
        """Return the present period and those ahead of it, (slots, N, rows of a slot)."""
        sizes = self._packed.sizes
        cursor = int(self._wholes[0, self._packed.rows["cursor"].start, 0])
        slots = self._of_tables("ring").reshape(-1, sizes["slots"], sizes["stride"])
        known: FloatArray = np.roll(slots, -cursor, axis=1).swapaxes(0, 1)
        return known

    def outcome(self, report: FloatArray) -> Outcome:
        """Return what the present period brought."""
        k = self._packed.sizes["substeps"]
        response = self._of_tables("response")
        floors = self._of_tables("floors") if self._packed.sizes["storeys_seen"] else None
        return Outcome(
            PeriodResponse(self.state, response[:, :k], response[:, k:]),
            report[4],
            CostTerms(*report[8:11]),
            report[12],
            report[14].astype(np.int64),
            floors,
        )

    # What tables are

    @property
    def state(self) -> FloatArray:
        """State of the tables (N, states), SI, [x_A, x_S] first."""
        state: FloatArray = self._of_tables("state")
        return state

    @state.setter
    def state(self, state: FloatArray) -> None:
        self.number += 1
        self._put("state", state)

    @property
    def memory(self) -> SensorMemory:
        """What the sensors remember."""
        past, entry = self._of_tables("past"), self._packed.sizes["entry"]
        depth = past.shape[1] // entry if entry else 0
        action = self._of_tables("action")[:, 0]
        parts = (self._of_tables("bias"), self._of_tables("gain"), action)
        return SensorMemory(*parts, past.reshape(self._tables.lanes, depth, entry))

    @memory.setter
    def memory(self, memory: SensorMemory) -> None:
        for field in fields(SensorMemory):
            values = np.asarray(getattr(memory, field.name))
            self._put(field.name, values.reshape(self._tables.lanes, -1))

    @property
    def severity(self) -> FloatArray:
        """Motionless cost of each table's motion over the unit target's (N,)."""
        severity: FloatArray = self._of_tables("severity")[:, 0]
        return severity

    def rest(self, lanes: BoolArray) -> None:
        """Put the state of some tables (N,) of bool to rest, in the middle of their episodes."""
        for lane in np.flatnonzero(lanes):
            self._records[lane // self._block, self._packed.rows["state"], lane % self._block] = 0.0

    def redrawn(self, lanes: Sequence[int]) -> None:
        """Take the plants of some lanes from the model's stacks, which have changed."""
        index = np.asarray(lanes, dtype=int)
        block: Any = index // self._block
        column: Any = index % self._block
        if len(index) == 1:
            block, column = int(block[0]), int(column[0])
        chosen = rows_of(index) if self._own else None
        for name, matrix in matrices(self._tables, chosen).items():
            start, length = self._packed.matrices[name]
            if not length:
                continue
            flat = matrix.swapaxes(-1, -2)
            if self._own:
                places = slice(start, start + length)
                self._matrices[block, places, column] = flat.reshape(len(index), length)
            else:
                self._matrices[0, start : start + length, 0] = flat.reshape(-1)
        if self._own:
            for name, values in lane_rows(self._tables, chosen).items():
                self._records[block, self._packed.rows[name], column] = values

    def get_state(self) -> LaneState:
        """Return everything that `set_state` needs to go on exactly; see `engine.Engine`."""
        whole = ("key", "period")
        held = {name: self._of_tables(name, name in whole) for name in _CARRIED}
        known = self._known()[:, :, : self._packed.sizes["width"]]
        return {
            "motion": motion_array(self.motions),
            **held,
            "period": held["period"][:, 0],
            "last_target": held["last_target"].reshape(self._tables.lanes, -1)[:, :1].sum(axis=1),
            "slipping": self._slipping(held["slipping"]),
            "known": known.swapaxes(0, 1).copy(),
            **self.memory.arrays(),
            "step_count": self.step_count.copy(),
            "episode_steps": self.episode_steps.copy(),
            "severity": self.severity,
        }

    def _slipping(self, held: FloatArray) -> FloatArray:
        """Return the reference's slipping states, zeros where storeys do not yield."""
        whole = np.zeros((self._tables.lanes, 3 * self._packed.sizes["stories"]))
        whole[:, : held.shape[1]] = held
        return whole

    def set_state(self, state: LaneState) -> None:
        """Go on from the state of as many tables of the same scenario."""
        self.number += 1
        sizes, rows = self._packed.sizes, self._packed.rows
        self.motions = state["motion"].tolist()
        for name, whole in (("key", True), ("state", False)):
            self._put(name, state[name], whole)
        self._put("period", state["period"][:, None], whole=True)
        if sizes["yielding"]:
            self._put("slipping", state["slipping"])
            self._put("last_target", state["last_target"][:, None])
        self._wholes[:, rows["cursor"]] = 0
        known = np.zeros((self._tables.lanes, sizes["slots"], sizes["stride"]))
        known[:, :, : sizes["width"]] = state["known"]
        self._put("ring", known.reshape(self._tables.lanes, -1))
        self.memory = SensorMemory.of(state)
        self._put("severity", state["severity"][:, None])
        self.step_count[:], self.episode_steps[:] = state["step_count"], state["episode_steps"]
        shapes = self._shapes.of(self.motions, set)
        self._put("shape", shapes[:, None], whole=True)
        self._wholes[:, rows["shape"]][self._wholes[:, rows["shape"]] == ZEROS] = ONES
        recorded = [isinstance(motion, RecordedMotion) for motion in self.motions]
        self._put("recorded", np.array(recorded, dtype=np.int64)[:, None], whole=True)
        self._put("amplitude", np.array([motion.amplitude for motion in self.motions])[:, None])
        self._point_to_shapes()


class _Shapes:
    """Histories and envelopes by number, with the addresses that the compiled step takes."""

    def __init__(self, tables: Tables) -> None:
        sizes = tables.scenario.discrete
        self._discrete = sizes
        self._ahead = -(-tables.preview[0] * tables.preview[1] // sizes.substeps)
        width = sizes.layout.filter_states + 2 * sizes.layout.stories + sizes.substeps + 1
        self._arrays: list[FloatArray] = [np.zeros((1, width)), np.ones((1, sizes.substeps))]
        self._numbers: dict[EpisodeMotion, int] = {}
        self.entries = self._addresses()

    def of(self, motions: Sequence[EpisodeMotion], used: Any) -> IntArray:
        """Return the number of each motion's shape; numbers that are not `used` may be given again."""
        found = np.full(len(motions), ONES, dtype=np.int64)
        for i, motion in enumerate(motions):
            if isinstance(motion, FilteredNoise) and motion.envelope is None:
                continue
            if motion not in self._numbers:
                self._add(motion, used() | set(found[:i].tolist()))
            found[i] = self._numbers[motion]
        return found

    def _add(self, motion: EpisodeMotion, used: set[int]) -> None:
        array = shape(motion, self._discrete, self._ahead)
        assert array is not None  # the caller asked
        for other, number in list(self._numbers.items()):
            if number not in used and len(self._numbers) > 2 * len(used):
                del self._numbers[other]
                self._arrays[number] = array
                self._numbers[motion] = number
                break
        else:
            self._numbers[motion] = len(self._arrays)
            self._arrays.append(array)
        self.entries = self._addresses()

    def _addresses(self) -> IntArray:
        return np.array([[each.ctypes.data, len(each)] for each in self._arrays], dtype=np.int64)


def _aligned(shape: tuple[int, ...]) -> FloatArray:
    """Return zeros whose memory begins on a line of the cache."""
    count = int(np.prod(shape))
    memory = np.zeros(count + LINE // 8)
    start = (-memory.ctypes.data % LINE) // 8
    return memory[start : start + count].reshape(shape)


def _made(tables: Tables, state: LaneState) -> CompiledEngine:
    engine = CompiledEngine(tables)
    engine.set_state(state)
    return engine
