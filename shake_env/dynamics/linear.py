"""THE update of the table: one control period, for numpy arrays and torch tensors alike.

Leading axes are the batch; a single table is batch ``()``. What the current cannot reach (the target
and the reference specimen) is computed ahead by :mod:`shake_env.simulation.excitation`, so that this
loop carries ``4 + 2 stories`` states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import array_api_compat
import numpy as np

from shake_env.model.discretization import DiscretePlant

Array = Any  # a numpy array or a torch tensor


def as_like(values: Array, like: Array) -> Array:
    """Return `values` in the library, precision and device of `like`."""
    xp = array_api_compat.array_namespace(like)
    if xp.isdtype(like.dtype, "real floating"):
        return xp.asarray(values, dtype=like.dtype, device=array_api_compat.device(like))
    return xp.asarray(values, device=array_api_compat.device(like))


@dataclass(frozen=True)
class PeriodResponse:
    """What the table did over one control period of k physics steps."""

    state: Array  # (..., states) SI at the period's end, [x_A, x_S] first
    table_acceleration: Array  # (..., k) [m/s^2] after each physics step
    base_shear: Array  # (..., k) [N] after each physics step


@dataclass(frozen=True)
class TableDynamics:
    """Linear update ``[state, y_A, f_s] = M [state, u] (+ drive)`` of one control period."""

    matrix: Array  # (4 + 2 stories + 2 k, 4 + 2 stories + 1)
    states: int  # 4 + 2 stories
    substeps: int  # k

    @classmethod
    def from_plant(cls, discrete: DiscretePlant) -> TableDynamics:
        """Cut the controlled part out of the lifted plant."""
        layout, lifted = discrete.layout, discrete.lifted
        columns = np.r_[layout.controlled, layout.order]
        matrix = np.vstack(
            [
                lifted.state[np.ix_(np.r_[layout.controlled], columns)],
                lifted.outputs[:, 0, columns],
                lifted.outputs[:, 1, columns],
            ]
        )
        states = layout.controlled.stop - layout.controlled.start
        return cls(matrix, states, discrete.substeps)

    @cached_property
    def _transposed(self) -> Array:
        return self.matrix.T

    def to(self, array: Array) -> TableDynamics:
        """Return this update in the library, precision and device of `array`."""
        return replace(self, matrix=as_like(self.matrix, array))

    def control_step(self, state: Array, current: Array, drive: Array | None = None) -> PeriodResponse:
        """Advance by one control period.

        Parameters
        ----------
        state
            (..., 4 + 2 stories) in SI.
        current
            (...) valve current [A], held over the period.
        drive
            (..., 4 + 2 stories + 2 k) what the target adds directly, in the order of the result;
            None in the corrected equations, where the table feels the current only.
        """
        xp = array_api_compat.array_namespace(state, current)
        moved = xp.concat([state, current[..., None]], axis=-1) @ self._transposed
        if drive is not None:
            moved = moved + drive
        n, k = self.states, self.substeps
        return PeriodResponse(moved[..., :n], moved[..., n : n + k], moved[..., n + k :])
