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

from agents.learning.apg.plant_period import CompiledPeriod as NumpyPeriod
from agents.learning.apg.plant_period import LinearPeriod
from shake_env.dynamics.linear import PeriodResponse, as_like
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
    def from_dynamics(cls, dynamics: NonlinearDynamics, like: torch.Tensor) -> PeriodMap:
        """Return the map of dynamics in numpy without active nonlinear parts."""
        linear = LinearPeriod.from_dynamics(dynamics)
        return cls(as_like(linear.matrix, like), linear.states, linear.substeps)

    def control_step(
        self, state: torch.Tensor, current: torch.Tensor, drive: torch.Tensor | None = None
    ) -> PeriodResponse:
        """Advance by one control period, as :meth:`NonlinearDynamics.control_step` does."""
        moved = apply(self.matrix, torch.cat([state, current[..., None]], dim=-1))
        n, k = self.states, self.substeps
        return PeriodResponse(moved[..., :n], moved[..., n : n + k], moved[..., n + k :])


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
    def from_dynamics(cls, dynamics: NonlinearDynamics, like: torch.Tensor) -> CompiledPeriod | None:
        """Return the period of dynamics in numpy; None where it cannot stand in for them.

        It needs numba, and tensors of `like`'s kind in double precision on the processor.
        """
        if like.dtype != torch.float64 or like.device.type != "cpu":
            return None
        period = NumpyPeriod.from_dynamics(dynamics)
        return None if period is None else cls(period.adjoint_step)

    def control_step(
        self, state: torch.Tensor, current: torch.Tensor, drive: torch.Tensor | None = None
    ) -> PeriodResponse:
        """Advance by one control period, as :meth:`NonlinearDynamics.control_step` does."""
        return PeriodResponse(*_Period.apply(state, current, self.adjoint))  # type: ignore[no-untyped-call]


def torch_model(model: TableModel, like: torch.Tensor) -> TableModel:
    """Return a model as it is differentiated: in the precision and on the device of `like`."""
    moved = model.to(like)
    dynamics: Any = moved.dynamics
    if isinstance(model.dynamics, NonlinearDynamics):
        if not model.dynamics.parts.active:
            dynamics = PeriodMap.from_dynamics(model.dynamics, like)
        else:
            dynamics = CompiledPeriod.from_dynamics(model.dynamics, like) or dynamics
    return replace(moved, dynamics=dynamics)
