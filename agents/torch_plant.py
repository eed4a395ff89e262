"""The plant of learning through it: the environment's own update on torch tensors, in as few operations.

On a few hundred tables the time of a step is the number of its operations, not their size. Where every
part is linear, a control period of any plant, delay included, is one matrix: made by running the update
on a basis, so that it is no second copy of an equation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from shake_env.dynamics import PeriodResponse
from shake_env.nonlinear_dynamics import NonlinearDynamics, apply
from shake_env.transition import TableModel


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


def torch_model(model: TableModel, like: torch.Tensor) -> TableModel:
    """Return a model as it is differentiated: in the precision and on the device of `like`."""
    moved = model.like(like)
    if isinstance(moved.dynamics, NonlinearDynamics) and not moved.dynamics.parts.active:
        return replace(moved, dynamics=PeriodMap.of(moved.dynamics))  # type: ignore[arg-type]
    return moved
