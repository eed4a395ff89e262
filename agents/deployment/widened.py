"""Controllers in double precision: the same numbers and the same code, float32 arrays made float64.

A policy file computes in float32, and so does part of the supervisor. What a float64 program is compared
with to 1e-9 is the same Python code on the same numbers without that rounding.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.policies.policy_file import PolicyFile
from shake_env.controller import Controller
from shake_env.safety.supervisor import Supervised


def to_float64(controller: Controller) -> Controller:
    """Return the controller in float64; a supervisor is changed in place."""
    if isinstance(controller, Supervised):
        prediction = controller.prediction
        controller.prediction = replace(
            prediction, rows=_wide(prediction.rows), bound=_wide(prediction.bound)
        )
        controller.sensitivity = _wide(controller.sensitivity)
        controller.controller = to_float64(controller.controller)
    if isinstance(controller, PolicyFile):
        memory = controller.memory
        return replace(
            controller,
            matrix=_wide(controller.matrix),
            weights=tuple(map(_wide, controller.weights)),
            biases=tuple(map(_wide, controller.biases)),
            base=_wide(controller.base),
            memory=None
            if memory is None
            else memory.with_parts({name: _wide(part) for name, part in memory.parts.items()}),
        )
    return controller


def _wide(array: NDArray[Any]) -> Any:
    return array.astype(np.float64)
