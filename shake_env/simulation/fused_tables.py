"""The tables of a batch as the fused step holds them: packed arrays, and views that have names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.dynamics.linear import PeriodResponse, TableDynamics
from shake_env.kernels.lanes import BLOCK, scalars, switches
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.model.parameters import FloatArray
from shake_env.scenario.objective import CostTerms
from shake_env.simulation import fused_layout as at
from shake_env.simulation.fused_layout import fill, pack
from shake_env.simulation.fused_step import period_of
from shake_env.simulation.sensors import SensorMemory
from shake_env.simulation.transition import Outcome, TableModel

BoolArray = NDArray[np.bool_]


class FusedTables:
    """State, sensors' memory and counters of N tables, stepped by `fused_step.period_of`.

    Parameters
    ----------
    model
        Of the scenario; of a fleet, its stacks.
    lanes
        Number of tables N.
    limit_rate, limit_steps, preview
        See `packing.pack`.
    """

    def __init__(
        self,
        model: TableModel,
        lanes: int,
        *,
        limit_rate: float,
        limit_steps: int | None,
        preview: tuple[int, int],
    ) -> None:
        self._made_from = (model, lanes, limit_rate, limit_steps, preview)
        dynamics, layout = model.dynamics, model.measurement.layout
        stories = layout.plant.specimen.stories
        parts, order = Nonlinearity(), model.controlled
        if not isinstance(dynamics, TableDynamics):
            parts, order = dynamics.parts, dynamics.advance.shape[-2]
        self._model = model
        self._packed = packed = pack(
            model,
            lanes,
            limit_rate=limit_rate,
            limit_steps=limit_steps,
            preview=preview,
            parts=scalars(parts),
            switches=switches(parts, stories, order),
            block=BLOCK,
        )
        self._p, self._v = self._packed.places, self._packed.numbers
        self.action, self.own, self.counters = packed.action, packed.own, packed.counters
        self.own[0] = 1.0
        self.lanes, self._size, self._rows = lanes, layout.size, int(self._p[at.ROWS])
        self.block = np.zeros((self._rows, lanes))
        self._period = period_of(1 if lanes == 1 else 2)
        # Of a table that is stepped alone, and whose block nobody is given: two in turn, with what is
        # reported of each.
        pair = np.zeros((2, self._rows, lanes))
        self._pair = [(block, block[: at.STATE, 0]) for block in pair]
        self._turn = 0
        self._ends = np.zeros((2, lanes), dtype=np.bool_)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle by making the arrays anew, of which many are views of one."""
        return _made, (self._made_from, self.block, self.own, self.counters)

    def step(
        self, ground: FloatArray, noise: FloatArray, row: int, sample: int
    ) -> tuple[NDArray[np.float32], FloatArray, BoolArray]:
        """Advance every table under `action`; return observations, the new block and the ends."""
        block = np.empty((self._rows, self.lanes))
        seen = np.empty(self.lanes * self._size, np.float32)
        ends = np.empty((2, self.lanes), np.bool_)
        self._period(self.block, block, seen, ends, ground, noise, self._v, self._p, row, sample)
        self.block = block
        return seen.reshape(self.lanes, self._size), block, ends

    def step_alone(
        self, ground: FloatArray, noise: FloatArray, row: int, sample: int
    ) -> tuple[NDArray[np.float32], list[float], int]:
        """Advance the one table; return its observation (n,), the report's rows and which ends."""
        self._turn = turn = 1 - self._turn
        block, report = self._pair[turn]
        seen = np.empty(self._size, np.float32)
        happened = self._period(
            self.block, block, seen, self._ends, ground, noise, self._v, self._p, row, sample
        )
        self.block = block
        return seen, report.tolist(), happened

    def redrawn(self, lanes: Sequence[int]) -> None:
        """Take the plants of some lanes from the model's stacks, which have changed."""
        fill(self._packed, self._model, lanes)

    @property
    def _states(self) -> slice:
        return slice(at.STATE, int(self._p[at.RESPONSE]))

    @property
    def state(self) -> FloatArray:
        """The tables' state (N, states), a view."""
        return self.block[self._states].T

    @state.setter
    def state(self, state: FloatArray) -> None:
        # A new block: the old one is in the last step's result, which a caller may hold.
        self.block = self.block.copy()
        self.block[self._states] = state.T

    @property
    def memory(self) -> SensorMemory:
        """The sensors' memory, a copy."""
        p, block = self._p, self.block
        past = block[p[at.PAST] : p[at.ROWS]].T
        entry = int(p[at.READINGS] + p[at.LAST_ACTION])
        history = past.shape[1] // entry if entry else 0
        return SensorMemory(
            block[p[at.FILTERED] : p[at.ACTION]].T.copy(),
            self.own[1:].T.copy(),
            block[p[at.ACTION]].copy(),
            past.reshape(self.lanes, history, entry).copy(),
        )

    @memory.setter
    def memory(self, memory: SensorMemory) -> None:
        p = self._p
        self.block = block = self.block.copy()
        block[p[at.FILTERED] : p[at.ACTION]] = memory.filtered.T
        self.own[1:] = memory.bias.T
        block[p[at.ACTION]] = memory.action
        block[p[at.PAST] : p[at.ROWS]] = memory.past.reshape(self.lanes, -1).T

    def outcome(self, block: FloatArray) -> Outcome:
        """Return what a period brought, as views of its block."""
        p = self._p
        first, floors, k = int(p[at.RESPONSE]), int(p[at.FLOOR_ROW]), int(p[at.SUBSTEPS])
        response = PeriodResponse(
            block[self._states].T, block[first : first + k].T, block[first + k : floors].T
        )
        cost = CostTerms(*(block[at.ACCELERATION_COST + i] for i in range(len(fields(CostTerms)))))
        seen = block[floors : int(p[at.FILTERED])].T if p[at.FLOORS] else None
        return Outcome(
            response,
            block[at.CURRENT],
            cost,
            block[at.SOFT_COST],
            block[at.BROKEN].astype(np.int64),
            seen,
        )


def _made(
    made_from: tuple[TableModel, int, float, int | None, tuple[int, int]],
    block: FloatArray,
    own: FloatArray,
    counters: NDArray[np.int64],
) -> FusedTables:
    model, lanes, rate, steps, preview = made_from
    fused = FusedTables(model, lanes, limit_rate=rate, limit_steps=steps, preview=preview)
    fused.block = block.copy()
    fused.own[:], fused.counters[:] = own, counters
    return fused
