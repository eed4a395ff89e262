"""Training that begins with the actor of a policy file, whoever trained it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from agents.learning.vec_env import ShakeTableVecEnv
from agents.policies.estimated_law import EstimatedLaw
from agents.policies.policy_file import LAW, PolicyFile
from agents.policies.recurrent_cells import MemoryUnit
from agents.policies.registry import policy_path
from agents.training.algorithm_options import MEMORY_OPTIONS
from agents.training.config import TrainConfig
from agents.training.model_factory import Model
from agents.training.policy_export import actor_of, export_policy, memory_of
from shake_env.errors import PolicyFileError


def first_file(config: TrainConfig, first: Path | None = None) -> Path | None:
    """Return the file of the policy that a run begins with, or None where it begins from nothing.

    It is `first`, a file or a run directory, and otherwise what the configuration names.
    """
    name = config.init_policy if first is None else str(first)
    return None if name is None else policy_path(name, config.scenario.scenario)


def load_actor_weights(model: Model, env: ShakeTableVecEnv, policy: PolicyFile) -> None:
    """Give a new model's actor the weights of a policy file; its critic begins anew.

    Both must read the same features, correct the same law with the same authority and have the same
    layers. An actor with a direct path takes one without, whose path is then zero. A policy averaged
    with its mirror image is taken as it is, in layers of twice the width.

    Raises
    ------
    PolicyFileError
        If the model could not act as the file does; it is then as it was.
    """
    actor, own = actor_of(model), export_policy(model, env, {})
    _require_like(own, policy)
    weights = list(policy.weights)
    if own.direct and not policy.direct:
        weights[-1] = np.pad(weights[-1], ((0, 0), (0, actor.direct)))
    frozen = [not layer.bias.requires_grad for layer in actor.linear]
    if any(still and bias.any() for still, bias in zip(frozen, policy.biases, strict=True)):
        remedy = "the actor here has no biases: give the option --config.ALGORITHM.actor-bias"
        raise PolicyFileError("biases", "not zero", remedy)
    with torch.no_grad():
        for layer, weight, bias, scale in zip(
            actor.linear, weights, policy.biases, actor.input_scale(), strict=True
        ):
            layer.weight.copy_(torch.from_numpy(weight / scale))
            layer.bias.copy_(torch.from_numpy(bias))
        if policy.memory is not None and (own_memory := memory_of(model)) is not None:
            kind, tensors = own_memory
            for name, part in policy.memory.parts.items():
                given = torch.from_numpy(part)
                tensors[name].copy_(given / actor.features.sizes.cpu() if name == kind.entry else given)


def _require_like(own: PolicyFile, given: PolicyFile) -> None:
    def require(holds: bool, field: str, value: object, remedy: str) -> None:
        if not holds:
            raise PolicyFileError(f"{field} of the policy to begin with", value, remedy)

    alike = own.matrix.shape == given.matrix.shape and np.allclose(own.matrix, given.matrix, rtol=1e-5)
    count = own.matrix.shape[0]
    remedy = f"here {count}: give scenario and --config.ALGORITHM.base-controller as its card has them"
    require(alike, "features", f"{given.matrix.shape[0]} features", remedy)
    remedy = "here another: give --config.ALGORITHM.base-controller as its card has it"
    same = np.allclose(own.base, given.base) and _same_law(own.law, given.law)
    require(same, "law", "its own", remedy)
    remedy = f"here {own.authority:g}: give --config.ALGORITHM.residual-scale {given.authority:g}"
    require(own.authority == given.authority, "authority", f"{given.authority:g}", remedy)
    remedy = f"here {own.output}: SAC, TQC and TD3 end in a tanh, PPO and the gradient in a clip"
    require(own.output == given.output, "output", given.output, remedy)
    require(own.activation == given.activation, "activation", given.activation, f"here {own.activation}")
    require(own.direct or not given.direct, "direct path", True, "this actor has none")
    kinds = ["none" if p.memory is None else p.memory.summary for p in (own, given)]
    if kinds[0] != kinds[1]:
        remedy = f"here {kinds[0]}: {_memory_remedy(own.memory, given.memory)}"
        require(False, "memory", kinds[1], remedy)
    widths = [[len(bias) for bias in policy.biases[:-1]] for policy in (own, given)]
    asked = " ".join(map(str, widths[1]))
    require(widths[0] == widths[1], "layers", asked, f"here others: give --config.net-arch {asked}")


def _memory_remedy(own: MemoryUnit | None, given: MemoryUnit | None) -> str:
    """Return what makes a policy with the memory of another."""
    if own is not None and given is not None and (own.kind, own.units) == (given.kind, given.units):
        return "no option changes the dilations"
    widths = {} if own is None else {own.kind: 0}
    widths |= {} if given is None else {given.kind: given.units}
    if "lstm" in widths:
        return "only recurrent-ppo has an lstm"
    return "give " + " ".join(
        f"--config.ALGORITHM.{MEMORY_OPTIONS[kind].replace('_', '-')} {width}"
        for kind, width in widths.items()
    )


def _same_law(own: EstimatedLaw | None, given: EstimatedLaw | None) -> bool:
    if own is None or given is None:
        return own is given
    pairs = [(getattr(own, name), getattr(given, name)) for name in LAW]
    return all(a.shape == b.shape and np.allclose(a, b, rtol=1e-3, atol=1e-6) for a, b in pairs)
