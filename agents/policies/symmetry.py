"""A policy averaged with its mirror image: the part of it that is odd."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agents.policies.policy_file import PolicyFile
from agents.policies.recurrent_cells import Weights
from shake_env.errors import PolicyFileError


def mirror_averaged(policy: PolicyFile) -> PolicyFile:
    """Return the policy whose network says ``(f(x) - f(-x)) / 2``, where the given one's says ``f(x)``.

    A table has no preferred direction: mirrored, it is the same table under the mirrored earthquake, so
    that the best policy is odd (the symmetry of van der Pol et al., "MDP homomorphic networks", NeurIPS
    2020). The even part of a trained policy is an error, which the mean of a policy and its mirror
    image does not have. In layers of twice the width the two networks stand side by side, the second
    with its input negated; the features, a clipped linear map, are odd as they are.

    Raises
    ------
    PolicyFileError
        If the policy has a memory, which would have to be kept twice.
    """
    if policy.memory is not None:
        raise PolicyFileError("memory", policy.memory.kind, "only a policy without one is averaged")
    *biases, end = policy.biases
    if not biases:
        return replace(policy, biases=(0.0 * end,))  # one layer: linear but for its bias
    first, *middle, last = policy.weights
    hidden = last.shape[1] - (first.shape[1] if policy.direct else 0)
    read, direct = 0.5 * last[:, :hidden], last[:, hidden:]
    weights = (
        np.vstack([first, -first]),
        *(np.kron(np.eye(2, dtype=np.float32), layer) for layer in middle),
        np.hstack([read, -read, direct]),
    )
    doubled: tuple[Weights, ...] = (*(np.tile(bias, 2) for bias in biases), 0.0 * end)
    return replace(policy, weights=weights, biases=doubled)
