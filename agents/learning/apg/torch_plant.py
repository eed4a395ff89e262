"""The plant of learning through it: the environment's own update on torch tensors, in as few operations.

On a few hundred tables the time of a step is the number of its operations, not their size. Where every
part is linear, a control period of any plant, delay included, is one matrix: made by running the update
on a basis, so that it is no second copy of an equation. Where a part is not, and numba is installed, a
period is one operation: forward the compiled update, backward its adjoint. Elsewhere (another device or
precision) it is the update itself, taken apart by torch, which is also what the others are tested by.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import torch
from torch.autograd.function import once_differentiable

from shake_env import numba_support
from shake_env.dynamics.linear import PeriodResponse
from shake_env.dynamics.nonlinear import NonlinearDynamics, apply
from shake_env.simulation.transition import TableModel

if TYPE_CHECKING:
    from shake_env.kernels.period_adjoint import PeriodAdjoint


@dataclass(frozen=True)
class PeriodMap:
    """One control period as a linear map ``[state, u] -> [state, y_A, f_s]``, one, or one a table."""

    matrix: torch.Tensor  # (..., states + 2 k, states + 1)
    states: int
    substeps: int  # k

    @classmethod
    def of(cls, dynamics: NonlinearDynamics) -> PeriodMap:
        """Run the update of a table without active nonlinear parts on a basis."""
        commands = dynamics.arrival.shape[-1] - 1
        order, batch = dynamics.advance.shape[-2] + commands, dynamics.advance.shape[:-2]
        basis = torch.eye(order + 1, dtype=dynamics.advance.dtype, device=dynamics.advance.device)
        basis = basis.reshape(order + 1, *(1 for _ in batch), order + 1).expand(-1, *batch, -1)
        response = dynamics.control_step(basis[..., :-1], basis[..., -1])
        columns = torch.cat([response.state, response.table_acceleration, response.base_shear], dim=-1)
        return cls(columns.movedim(0, -1).contiguous(), order, dynamics.substeps)

    def control_step(
        self, state: torch.Tensor, current: torch.Tensor, drive: torch.Tensor | None = None
    ) -> PeriodResponse:
        """Advance by one control period, as :meth:`NonlinearDynamics.control_step` does."""
        moved = apply(self.matrix, torch.cat([state, current[..., None]], dim=-1))
        n, k = self.states, self.substeps
        return PeriodResponse(moved[..., :n], moved[..., n : n + k], moved[..., n + k :])

    def like(self, array: torch.Tensor) -> PeriodMap:
        """Return this map in the precision and on the device of `array`."""
        return replace(self, matrix=self.matrix.to(array))


class _Period(torch.autograd.Function):
    """A control period of N tables as one differentiable operation on double precision."""

    @staticmethod
    def forward(ctx: Any, state: torch.Tensor, current: torch.Tensor, adjoint: PeriodAdjoint) -> Any:
        ctx.save_for_backward(state, current)
        ctx.adjoint = adjoint
        parts = adjoint.step(state.detach().numpy(), current.detach().numpy())
        return tuple(map(torch.from_numpy, parts))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *slopes: torch.Tensor) -> Any:
        state, current = (tensor.numpy() for tensor in ctx.saved_tensors)
        start, command = ctx.adjoint(state, current, *(slope.numpy() for slope in slopes))
        return torch.from_numpy(start), torch.from_numpy(command), None


@dataclass(frozen=True)
class CompiledPeriod:
    """A control period with nonlinear parts, compiled both ways."""

    adjoint: PeriodAdjoint

    @classmethod
    def of(cls, dynamics: NonlinearDynamics, like: torch.Tensor) -> CompiledPeriod | None:
        """Return the period of dynamics in numpy; None where it cannot stand in for them.

        It needs numba, and tensors of `like`'s kind in double precision on the processor.
        """
        if like.dtype != torch.float64 or like.device.type != "cpu" or not numba_support.COMPILED:
            return None
        step = dynamics._compiled
        if step is None:
            return None
        from shake_env.kernels.period_adjoint import (
            PeriodAdjoint,  # compiles, or loads what was, on first use
        )

        return cls(PeriodAdjoint(step))

    def control_step(
        self, state: torch.Tensor, current: torch.Tensor, drive: torch.Tensor | None = None
    ) -> PeriodResponse:
        """Advance by one control period, as :meth:`NonlinearDynamics.control_step` does."""
        return PeriodResponse(*_Period.apply(state, current, self.adjoint))  # type: ignore[no-untyped-call]


def torch_model(model: TableModel, like: torch.Tensor) -> TableModel:
    """Return a model as it is differentiated: in the precision and on the device of `like`."""
    moved = model.like(like)
    dynamics: Any = moved.dynamics
    if isinstance(model.dynamics, NonlinearDynamics):
        if not model.dynamics.parts.active:
            dynamics = PeriodMap.of(dynamics)
        else:
            dynamics = CompiledPeriod.of(model.dynamics, like) or dynamics
    return replace(moved, dynamics=dynamics)
