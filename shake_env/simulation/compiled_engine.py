"""The engine whose control period is one compiled call (:mod:`shake_env.kernels.period`).

Imported on first use, where numba is installed; the readable engine stays the reference, and a test
holds this equal to it. What tables carry from period to period lies in records, a block of tables each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.dynamics.ground import GroundPeriod
from shake_env.dynamics.linear import PeriodResponse
from shake_env.kernels.layout import GROUND, PLACES, START, STEP, table
from shake_env.kernels.period import period_of
from shake_env.model.parameters import FloatArray
from shake_env.motion.targets import RecordedMotion
from shake_env.scenario.objective import CostTerms
from shake_env.simulation.engine import (
    Episode,
    IntArray,
    LaneState,
    Observations,
    StepResult,
    Tables,
)
from shake_env.simulation.helper_thread import Helpers
from shake_env.simulation.motion_shapes import first_target, initial_filter_state
from shake_env.simulation.output_pool import OutputPool
from shake_env.simulation.table_records import LINE, TableRecords, aligned_zeros
from shake_env.simulation.transition import Outcome

PIECES = 4  # of the tables for each thread
A_THREAD = 512  # tables that a thread has at least: fewer take no longer than to wake it
FEW = 6  # tables of a block that begin sooner one by one than with the whole block
_AT_REPORT, _AT_SEEN, _AT_ENDS = (PLACES[f"at_{name}"] for name in ("report", "seen", "ends"))
_MODE = PLACES["mode"]


class CompiledEngine(TableRecords):
    """N tables in records, stepped by `period_of`; see `engine.Engine`."""

    def __init__(self, tables: Tables) -> None:
        super().__init__(tables)
        lanes, packed = tables.lanes, self._packed
        self._pool = OutputPool(lanes, self._padded, packed.sizes["shown"])
        self._period = period_of(self._block)
        self._entries = self._shapes.entries
        self._table = self._new_table(STEP)
        self._address = self._table.ctypes.data
        self._parts: list[IntArray] = []
        self._starter: CompiledEngine | None = None  # of one table, for the tables of blocks
        self._helpers = self._new_helpers(min(tables.threads, self._padded // A_THREAD))
        self._other = self._new_table(GROUND)
        # Of a table that is stepped alone, whose memory nobody is given.
        pool = OutputPool(1, 1, packed.sizes["shown"])
        alone, address = pool.take()
        self._alone = self._new_table(STEP)
        self._alone[_AT_REPORT], self._alone[_AT_SEEN], self._alone[_AT_ENDS] = pool.addresses(address)
        report, observations, _, _ = pool.views(alone)
        self._report_alone, self._observation_alone = report[:, 0], observations[0]
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

    # Episodes

    def start(self, lanes: Sequence[int], episodes: Sequence[Episode]) -> Observations:
        """Put tables to rest at the beginning of their episodes; return their observations."""
        self.number += 1
        if self._block == 1:
            shape = int(self._shapes.numbers([episodes[0].motion], self._used)[0])
            return self._start_alone(episodes[0], shape)[None].copy()
        shapes = self._shapes.numbers([each.motion for each in episodes], self._used)
        self._point_to_shapes()
        places: dict[int, list[int]] = {}  # of the lanes of each block
        for i, (lane, each) in enumerate(zip(lanes, episodes, strict=True)):
            self._counters[0, lane], self._counters[1, lane] = 0, each.steps
            self.motions[lane] = each.motion
            places.setdefault(int(lane) // self._block, []).append(i)
        shown = np.empty((len(episodes), self._packed.sizes["shown"]), dtype=np.float32)
        for number, which in places.items():
            columns = [int(lanes[i]) % self._block for i in which]
            if len(which) <= FEW:
                for i, column in zip(which, columns, strict=True):
                    shown[i] = self._start_in_block(number, column, episodes[i], int(shapes[i]))
            else:
                part = [episodes[i] for i in which]
                shown[which] = self._begin(number, np.array(columns), part, shapes[which])
        return shown

    def _start_alone(self, episode: Episode, shape: int) -> Observations:
        """Put the one table to rest at the beginning of its episode; return its observation (n,).

        The observation is overwritten by the next one.
        """
        self.motions[0] = motion = episode.motion
        rows, record, wholes = self._packed.rows, self._record_alone, self._wholes_alone
        self._counters[0, 0], self._counters[1, 0] = 0, episode.steps
        record[rows["state"].start :] = 0.0
        wholes[rows["key"]] = episode.key
        wholes[rows["period"].start] = 0
        wholes[rows["recorded"].start] = isinstance(motion, RecordedMotion)
        record[rows["amplitude"].start] = motion.amplitude
        record[rows["severity"].start] = episode.severity
        wholes[rows["shape"].start] = shape
        self._point_to_shapes()
        self._set_to_time_zero(record, wholes, episode)
        self._alone[_MODE] = START
        self._period(self._address_alone)
        self._alone[_MODE] = STEP
        shown: Observations = self._observation_alone
        return shown

    def _start_in_block(self, number: int, column: int, episode: Episode, shape: int) -> Observations:
        """Begin an episode of a table of a block by way of a table alone, to the same bits."""
        starter = self._starter
        if starter is None:
            starter = self._starter = CompiledEngine(replace(self._tables, lanes=1))
            starter._shapes = self._shapes
        if self._own:
            starter.take_plant(number * self._block + column)
        rows, alone = self._packed.rows, starter._packed.rows
        record, cursor = self._records[number], rows["cursor"].start
        starter._wholes_alone[cursor] = self._wholes[number, cursor, column]
        shown = starter._start_alone(episode, shape)
        # What a field holds is the same but for the noise's, behind which the rows differ.
        noise, behind = rows["noise"], alone["reading"].start
        end = behind + rows["ring"].stop - rows["reading"].start
        record[: noise.stop, column] = starter._record_alone[: noise.stop]
        record[rows["reading"].start : rows["ring"].stop, column] = starter._record_alone[behind:end]
        return shown

    def _set_to_time_zero(self, record: FloatArray, wholes: IntArray, episode: Episode) -> None:
        """Write ground and specimen at time 0 to a table's record (rows,), where they are not zero."""
        motion = episode.motion
        if episode.specimen is None and not isinstance(motion, RecordedMotion):
            return
        discrete, packed = self._tables.scenario.discrete, self._packed
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

    def set_state(self, state: LaneState) -> None:
        """Go on from the state of as many tables of the same scenario."""
        super().set_state(state)
        self._point_to_shapes()

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
        record = aligned_zeros(self._records[number].shape)
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
        observations = np.empty(block * shown + LINE // 4, dtype=np.float32)
        self._call(
            START,
            first=number,
            last=number + 1,
            at_records=record.ctypes.data - number * self._records[0].nbytes,
            at_seen=observations.ctypes.data - 4 * number * block * shown,
        )
        self._records[number][:, columns] = record[:, columns]
        return observations[: block * shown].reshape(block, shown)[columns]

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
        report, observations, terminated, truncated = self._pool.views(memory)
        return StepResult(self, observations, report, terminated, truncated, ended)

    def step_alone(self, action: float) -> tuple[Observations, list[float], int]:
        """Advance the one table; return its observation (n,), report and `StepResult.ended`."""
        self.number += 1
        self._given[0] = action
        ended = self._period(self._address_alone)
        return self._observation_alone.copy(), self._report_alone.tolist(), ended

    def advance_ground(self) -> tuple[GroundPeriod, FloatArray]:
        """Advance the ground alone; return it, and the noise (N, s) of the readings, SI."""
        self.number += 1
        self._call(GROUND)
        readings = self._packed.sizes["readings"]
        return self.ground(), self._of_tables("noise")[:, :readings] * self._tables.model.measurement.rms

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


def _made(tables: Tables, state: LaneState) -> CompiledEngine:
    engine = CompiledEngine(tables)
    engine.set_state(state)
    return engine
