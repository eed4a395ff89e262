"""The closed loop in numpy as one differentiable operation of torch, along the policy's parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.autograd.function import once_differentiable

from agents.learning.apg.closed_loop import ClosedLoop, LoopTrajectory
from shake_env.model.parameters import FloatArray

Kept = torch.Tensor | None
# Observation (N, n) and the policy's memory (N, units) to action (N,), memory, and what to put aside.
Act = Callable[[torch.Tensor, Kept], tuple[torch.Tensor, Kept, Kept]]
SLOPES = ("state", "acceleration", "shear", "action", "shown")  # of a passage, differentiable


class _Sweep(torch.autograd.Function):
    """A passage of the closed loop, differentiable along the parameters of the policy that made it."""

    @staticmethod
    def forward(
        ctx: Any,
        loop: ClosedLoop,
        passage: LoopTrajectory,
        age: NDArray[np.int_],
        act: Act,
        *parameters: torch.Tensor,
    ) -> Any:
        ctx.loop, ctx.passage, ctx.age, ctx.act = loop, passage, age, act
        ctx.save_for_backward(*parameters)
        return tuple(map(torch.from_numpy, (getattr(passage, name) for name in SLOPES)))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *slopes: torch.Tensor) -> Any:
        passage = ctx.passage
        shown = torch.from_numpy(passage.shown[:-1].reshape(-1, passage.shown.shape[-1]))
        with torch.enable_grad():
            correction = ctx.act(shown.requires_grad_(), None)[0]
            summed = correction.sum()  # rows do not mix
        (along,) = torch.autograd.grad(summed, shown, retain_graph=True)
        toward = ctx.loop.sweep(
            passage,
            ctx.age,
            {name: slope.numpy() for name, slope in zip(SLOPES, slopes, strict=True)},
            along.numpy().reshape(passage.shown[:-1].shape),
        )
        parameters = ctx.saved_tensors
        wanted = [tensor for tensor in parameters if tensor.requires_grad]
        weights = torch.from_numpy(toward.reshape(-1)).to(correction.dtype)
        gradients = iter(torch.autograd.grad(correction, wanted, weights, allow_unused=True))
        along_each = (next(gradients) if tensor.requires_grad else None for tensor in parameters)
        return None, None, None, None, *along_each


def differentiable(
    loop: ClosedLoop,
    passage: LoopTrajectory,
    age: NDArray[np.int_],
    act: Act,
    parameters: Sequence[torch.Tensor],
) -> tuple[torch.Tensor, ...]:
    """Return the parts of a closed loop's passage in the order of :data:`SLOPES`, with their gradient.

    Parameters
    ----------
    loop, passage, age
        What was run, what it returned, and the ages (N,) that it began with.
    act
        The policy that made it: a function of the observation alone.
    parameters
        Those of the policy.
    """
    parts: tuple[torch.Tensor, ...] = _Sweep.apply(loop, passage, age, act, *parameters)  # type: ignore[no-untyped-call]
    return parts


@torch.no_grad()
def policy_correction(act: Act, shown: FloatArray) -> FloatArray:
    """Return a policy's corrections (N,) for what is shown (N, n), without a gradient."""
    action: FloatArray = act(torch.from_numpy(shown), None)[0].to(torch.float64).numpy()
    return action
