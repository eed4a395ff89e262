"""Linear laws that a learned policy may correct instead of starting from nothing."""

from __future__ import annotations

import numpy as np

from agents.algorithm_options import BaseLaw
from agents.estimated_law import EstimatedLaw
from agents.free_design import FREE, found_by_search
from baselines.lqr import action_row, sampled_lqr
from baselines.preview_lqr import PreviewFeedback
from baselines.registry import make_baseline
from shake_env.parameters import FloatArray
from shake_env.scenario import Scenario


def base_law(law: BaseLaw, scenario: Scenario) -> FloatArray | EstimatedLaw:
    """Return the law that a policy corrects: a row as `base_row`'s, or one behind an estimator."""
    seen = scenario.sensing.full_state and not scenario.delay
    if law in ("lqg", "lqg-accommodating") or (law == FREE and not seen):
        return EstimatedLaw.of(law, scenario)
    return base_row(law, scenario)


def base_row(law: BaseLaw, scenario: Scenario) -> FloatArray:
    """Return the law as a row (n,): fraction of the current limit per entry of the observation.

    ``flow`` is the current whose steady flow is what the table's own velocity uses,
    ``u = A_p v_a / (K_q K_v)``: it leaves the policy the flow that accelerates the table. ``lqr`` is the
    sampled-data LQR, so that the policy is a residual on top of it (Silver et al., Residual Policy
    Learning, 2018); ``preview-lqr`` is the one that sees the coming target, and ``free`` what a search
    over such laws found.
    """
    if law == "none":
        return np.zeros(scenario.observation.size)
    if law in ("preview-lqr", FREE):
        controller = found_by_search(scenario) if law == FREE else make_baseline(law, scenario)
        assert isinstance(controller, PreviewFeedback)
        return controller.row
    layout, actuator = scenario.plant.layout, scenario.actuator
    gain = np.zeros(layout.order)
    if law == "flow":
        gain[layout.table_velocity] = -1.0 / actuator.velocity_gain
    elif law == "lqr":
        gain = sampled_lqr(scenario.discrete, scenario.stage_cost).gain
    return action_row(scenario, gain)
