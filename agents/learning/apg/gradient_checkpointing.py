"""Segments of a long computation that are run again instead of being kept.

Of each segment only its inputs are kept; when the gradient comes back to its end it is run once more,
with its graph, and differentiated (Griewank and Walther, Evaluating Derivatives, 2008, ch. 12; Chen et
al., Training Deep Nets with Sublinear Memory Cost, 2016). torch's own checkpoint either keeps the whole
graph's nodes or cannot be used with `torch.autograd.grad`, by which an actor is trained without its
critic.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch.autograd.function import once_differentiable

Part = torch.Tensor | None
Run = Callable[..., tuple[Part, ...]]


class _Segment(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, run: Run, count: int, *tensors: Part) -> Any:
        inputs, parameters = tensors[:count], tensors[count:]
        ctx.run, ctx.count = run, count
        ctx.save_for_backward(*inputs, *parameters)
        ctx.set_materialize_grads(False)
        outputs = run(*inputs)
        whole = [t for t in outputs if t is not None and not t.is_floating_point()]
        ctx.mark_non_differentiable(*whole)
        return outputs

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *slopes: Part) -> Any:
        saved, needed = ctx.saved_tensors, ctx.needs_input_grad[2:]
        inputs = [
            t if t is None else t.detach().requires_grad_(along)
            for t, along in zip(saved[: ctx.count], needed[: ctx.count], strict=True)
        ]
        with torch.enable_grad():
            outputs = ctx.run(*inputs)
        pairs = [
            (output, slope)
            for output, slope in zip(outputs, slopes, strict=True)
            if slope is not None and output is not None and output.requires_grad
        ]
        ends, slopes = zip(*pairs, strict=True)
        sources = [*inputs, *saved[ctx.count :]]
        wanted = [source for source, along in zip(sources, needed, strict=True) if along]
        found = iter(torch.autograd.grad(ends, wanted, slopes, allow_unused=True))
        return None, None, *(next(found) if along else None for along in needed)


def checkpointed(
    run: Run, inputs: Sequence[Part], parameters: Sequence[torch.Tensor]
) -> tuple[Part, ...]:
    """Return ``run(*inputs)``, of which a gradient keeps no more than the inputs.

    Parameters
    ----------
    run
        Called again when a gradient is taken, and must then do the same.
    inputs
        Tensors or None. What needs no gradient may be of any type.
    parameters
        Leaves that `run` uses besides, along which gradients are taken.
    """
    outputs: tuple[Part, ...] = _Segment.apply(run, len(inputs), *inputs, *parameters)  # type: ignore[no-untyped-call]
    return outputs
