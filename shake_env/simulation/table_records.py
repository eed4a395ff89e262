"""What N tables carry from period to period, in records that compiled code steps, a block each.

A record holds a field of each table of its block side by side (:mod:`shake_env.simulation.packing`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from shake_env.dynamics.drawn_plants import rows_of
from shake_env.dynamics.ground import GroundPeriod, GroundRowLayout
from shake_env.kernels.layout import ONES, ZEROS
from shake_env.kernels.vectors import BLOCK
from shake_env.model.parameters import FloatArray
from shake_env.motion.targets import EpisodeMotion, FilteredNoise, RecordedMotion
from shake_env.simulation.engine import BoolArray, IntArray, LaneState, Tables
from shake_env.simulation.excitation import motion_array
from shake_env.simulation.packing import BEHIND, columns_of, lane_rows, pack, packed_matrices
from shake_env.simulation.sensors import SensorMemory
from shake_env.simulation.shape_addresses import ShapeAddresses

FOREVER = 1 << 62  # control periods of a table that only fills up a block
LINE = 64  # [bytes] of a cache
# What a state holds of each table, by field.
_CARRIED = ("key", "period", "state", "slipping", "last_target")


class TableRecords:
    """The records of N tables, their matrices and counters, and what is read and written of them."""

    def __init__(self, tables: Tables) -> None:
        self._tables = tables
        lanes = tables.lanes
        self._block = block = 1 if lanes == 1 else BLOCK
        self._blocks = -(-lanes // block)
        self._padded = self._blocks * block
        self._packed = packed = pack(tables, block)
        self._own = bool(packed.sizes["own"])
        self._columns = columns_of(tables)
        depth = block if self._own else 1
        copies = self._blocks if self._own else 1
        self._records = aligned_zeros((self._blocks, packed.record_rows, block))
        self._wholes = self._records.view(np.int64)
        self._record_alone, self._wholes_alone = self._records[0, :, 0], self._wholes[0, :, 0]
        self._memory = aligned_zeros((copies * packed.matrices_size * depth + BEHIND,))
        self._matrices = self._memory[: copies * packed.matrices_size * depth].reshape(
            copies, packed.matrices_size, depth
        )
        self._room = aligned_zeros((packed.room_rows * block,))
        self._given = np.zeros(self._padded)
        self._counters = np.zeros((2, self._padded), dtype=np.int64)
        self._counters[1] = FOREVER
        self.number = 0
        self.step_count, self.episode_steps = self._counters[:, :lanes]
        self.motions: list[EpisodeMotion] = [FilteredNoise()] * lanes
        self._shapes = ShapeAddresses(tables)
        self._rows = GroundRowLayout.from_plant(tables.scenario.discrete)
        self._fields("shape")[:] = ONES
        self._wholes[:, packed.rows["shape"]] = ONES
        for name, values in lane_rows(tables).items():
            if not self._own:
                self._records[:, packed.rows[name]] = values[:, None]
        self._fields("severity")[:] = 1.0
        self.redrawn(range(lanes))

    def _fields(self, name: str) -> FloatArray:
        """Return a field of each block (blocks, rows, block), a view."""
        return self._records[:, self._packed.rows[name]]

    def _of_tables(self, name: str, whole: bool = False) -> Any:
        """Return a field of each table (N, rows), a copy."""
        rows = self._packed.rows[name]
        held = (self._wholes if whole else self._records)[:, rows]
        return held.swapaxes(1, 2).reshape(self._padded, -1)[: self._tables.lanes].copy()

    def _put(self, name: str, values: Any, whole: bool = False) -> None:
        """Write a field of each table (N, rows)."""
        rows = self._packed.rows[name]
        held = np.zeros((self._padded, rows.stop - rows.start), np.int64 if whole else np.float64)
        held[: self._tables.lanes] = values
        target = self._wholes if whole else self._records
        target[:, rows] = held.reshape(self._blocks, self._block, -1).swapaxes(1, 2)

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
        held = self._records[:, start : start + sizes["width"]].swapaxes(1, 2)
        present: FloatArray = held.reshape(self._padded, -1)[: self._tables.lanes].copy()
        return present

    def _known(self) -> FloatArray:
        """Return the present period and those ahead of it, (slots, N, rows of a slot)."""
        sizes = self._packed.sizes
        cursor = int(self._wholes[0, self._packed.rows["cursor"].start, 0])
        slots = self._of_tables("ring").reshape(-1, sizes["slots"], sizes["stride"])
        known: FloatArray = np.roll(slots, -cursor, axis=1).swapaxes(0, 1)
        return known

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
        if len(index) == 1:
            self._take_plants(index, *divmod(int(index[0]), self._block))
        else:
            self._take_plants(index, index // self._block, index % self._block)

    def take_plant(self, lane: int) -> None:
        """Take the plant of a lane from the model's stacks to the one table."""
        self._take_plants(np.array([lane]), 0, 0)

    def _take_plants(self, index: IntArray, block: Any, column: Any) -> None:
        """Take plants of the model's stacks to tables in columns of blocks."""
        chosen = rows_of(index) if self._own else None
        for name, matrix in packed_matrices(self._tables, self._columns, chosen).items():
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
        self.memory = SensorMemory.from_state(state)
        self._put("severity", state["severity"][:, None])
        self.step_count[:], self.episode_steps[:] = state["step_count"], state["episode_steps"]
        shapes = self._shapes.numbers(self.motions, set)
        self._put("shape", shapes[:, None], whole=True)
        self._wholes[:, rows["shape"]][self._wholes[:, rows["shape"]] == ZEROS] = ONES
        recorded = [isinstance(motion, RecordedMotion) for motion in self.motions]
        self._put("recorded", np.array(recorded, dtype=np.int64)[:, None], whole=True)
        self._put("amplitude", np.array([motion.amplitude for motion in self.motions])[:, None])


def aligned_zeros(shape: tuple[int, ...]) -> FloatArray:
    """Return zeros whose memory begins on a line of the cache."""
    count = int(np.prod(shape))
    memory = np.zeros(count + LINE // 8)
    start = (-memory.ctypes.data % LINE) // 8
    return memory[start : start + count].reshape(shape)
