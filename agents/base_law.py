"""Linear laws that a learned policy may correct instead of starting from nothing."""

from __future__ import annotations

from typing import Literal

import numpy as np

from baselines.lqr import action_row, sampled_lqr
from shake_env.parameters import FloatArray
from shake_env.scenario import Scenario

BaseLaw = Literal["none", "flow", "lqr"]


def base_row(law: BaseLaw, scenario: Scenario) -> FloatArray:
    """Return the law as a row (n,): fraction of the current limit per entry of the observation.

    ``flow`` is the current whose steady flow is what the table's own velocity uses,
    ``u = A_p v_a / (K_q K_v)``: it leaves the policy the flow that accelerates the table. ``lqr`` is the
    sampled-data LQR, so that the policy is a residual on top of it (Silver et al., Residual Policy
    Learning, 2018).
    """
    if law == "none":
        return np.zeros(scenario.observation.size)
    layout, actuator = scenario.plant.layout, scenario.actuator
    gain = np.zeros(layout.order)
    if law == "flow":
        gain[layout.table_velocity] = -1.0 / actuator.velocity_gain
    elif law == "lqr":
        gain = sampled_lqr(scenario.discrete, scenario.stage_cost).gain
    return action_row(scenario, gain)
