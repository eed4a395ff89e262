"""A control period of the plant and its adjoint in numpy: one matrix, or compiled both ways."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from shake_env import numba_support
from shake_env.dynamics.linear import TableDynamics
from shake_env.dynamics.nonlinear import NonlinearDynamics, apply
from shake_env.model.parameters import FloatArray


class Period(Protocol):
    """A control period of the plant and its adjoint, for a batch (N,)."""

    def __call__(
        self, state: FloatArray, current: FloatArray, drive: FloatArray | None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the state (N, S), y_A (N, k) and f_s (N, k) at the end."""
        ...

    def adjoint(
        self, state: FloatArray, current: FloatArray, slopes: tuple[FloatArray, FloatArray, FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """Return a cost's slopes along state (N, S) and current (N,) from those along the results."""
        ...


@dataclass(frozen=True)
class LinearPeriod:
    """A period as one matrix ``[state, u] -> [state, y_A, f_s]``, or one a table."""

    matrix: FloatArray  # (..., S + 2 k, S + 1)
    states: int  # S
    substeps: int  # k

    @classmethod
    def from_dynamics(cls, dynamics: TableDynamics | NonlinearDynamics) -> LinearPeriod:
        """Return the matrix of dynamics without active nonlinear parts, by running them on a basis."""
        if isinstance(dynamics, TableDynamics):
            return cls(dynamics.matrix, dynamics.states, dynamics.substeps)
        states, batch = dynamics.states, dynamics.advance.shape[:-2]
        basis = np.eye(states + 1).reshape(states + 1, *(1 for _ in batch), states + 1)
        basis = np.broadcast_to(basis, (states + 1, *batch, states + 1))
        moved = dynamics.control_step(basis[..., :-1], basis[..., -1])
        columns = np.concatenate([moved.state, moved.table_acceleration, moved.base_shear], axis=-1)
        return cls(np.ascontiguousarray(np.moveaxis(columns, 0, -1)), states, dynamics.substeps)

    def __call__(
        self, state: FloatArray, current: FloatArray, drive: FloatArray | None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Advance by one control period; see `Period`."""
        moved = apply(self.matrix, np.concatenate([state, current[:, None]], axis=-1))
        if drive is not None:
            moved = moved + drive
        n, k = self.states, self.substeps
        return moved[:, :n], moved[:, n : n + k], moved[:, n + k :]

    def adjoint(
        self, state: FloatArray, current: FloatArray, slopes: tuple[FloatArray, FloatArray, FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """Return slopes along state and current; see `Period`."""
        back = apply(np.swapaxes(self.matrix, -1, -2), np.concatenate(slopes, axis=-1))
        return back[:, :-1], back[:, -1]


@dataclass(frozen=True)
class CompiledPeriod:
    """A period with nonlinear parts, compiled both ways."""

    adjoint_step: Any  # kernels.period_adjoint.PeriodAdjoint

    @classmethod
    def from_dynamics(cls, dynamics: NonlinearDynamics) -> CompiledPeriod | None:
        """Return the period of dynamics, None where numba is not installed or does not take them."""
        step = dynamics._compiled if numba_support.COMPILED else None
        kernel = (
            None if step is None else numba_support.compiled_module("shake_env.kernels.period_adjoint")
        )
        return None if kernel is None else cls(kernel.PeriodAdjoint(step))

    def __call__(
        self, state: FloatArray, current: FloatArray, drive: FloatArray | None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Advance by one control period; see `Period`."""
        moved: tuple[FloatArray, FloatArray, FloatArray] = self.adjoint_step.step(state, current)
        return moved

    def adjoint(
        self, state: FloatArray, current: FloatArray, slopes: tuple[FloatArray, FloatArray, FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """Return slopes along state and current; see `Period`."""
        back: tuple[FloatArray, FloatArray] = self.adjoint_step(state, current, *slopes)
        return back


def period_of(dynamics: TableDynamics | NonlinearDynamics) -> Period | None:
    """Return a differentiable period of dynamics in numpy; None where only torch differentiates them."""
    if isinstance(dynamics, NonlinearDynamics) and dynamics.parts.active:
        return CompiledPeriod.from_dynamics(dynamics)
    return LinearPeriod.from_dynamics(dynamics)
