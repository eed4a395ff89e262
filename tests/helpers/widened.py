"""Controllers in double precision: the same numbers and the same code, float32 arrays made float64.

A policy file computes in float32, and so does part of the supervisor. What a float64 program is compared
with to 1e-9 is the same Python code on the same numbers without that rounding.
"""

from dataclasses import replace

import numpy as np

from agents.policies.policy_file import PolicyFile
from agents.policies.recurrent_cells import PARTS
from shake_env import Supervised


def wide(array):
    return array.astype(np.float64)


def widened(controller):
    """The controller in float64; a supervisor is changed in place."""
    if isinstance(controller, Supervised):
        prediction = controller.prediction
        controller.prediction = replace(
            prediction, rows=wide(prediction.rows), bound=wide(prediction.bound)
        )
        controller.sensitivity = wide(controller.sensitivity)
        controller.controller = widened(controller.controller)
    if isinstance(controller, PolicyFile):
        memory = controller.memory
        return replace(
            controller,
            matrix=wide(controller.matrix),
            weights=tuple(map(wide, controller.weights)),
            biases=tuple(map(wide, controller.biases)),
            base=wide(controller.base),
            memory=None if memory is None else type(memory)(*(wide(getattr(memory, p)) for p in PARTS)),
        )
    return controller
