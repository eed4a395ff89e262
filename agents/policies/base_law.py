"""Linear laws that a learned policy may correct instead of starting from nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agents.policies.base_names import BaseLaw
from agents.policies.estimated_law import EstimatedLaw
from baselines.lqr.preview import PreviewFeedback
from baselines.lqr.sampled import action_row, sampled_lqr
from baselines.registry import make_baseline, parameter_values
from baselines.searched_lqg import LQG_SEARCHED
from shake_env.model.parameters import FloatArray
from shake_env.scenario.overrides import make_scenario
from shake_env.scenario.scenario import Scenario


def base_law(
    law: BaseLaw, scenario: Scenario, tuned_on: Scenario | None = None
) -> FloatArray | EstimatedLaw:
    """Return the law that a policy corrects: a row as `base_row`'s, or one behind an estimator.

    Its parameters are what was tuned for exactly `tuned_on` (None: the scenario itself).
    """
    full_state = scenario.sensing.full_state and not scenario.delay
    if law in ("lqg", "lqg-dac") or (law == LQG_SEARCHED and not full_state):
        parameters = parameter_values(law, tuned_on or scenario).parameters
        return EstimatedLaw.from_name(law, scenario, parameters)
    return base_row(law, scenario, tuned_on)


def at_own_cost(scenario: Scenario, name: str) -> Scenario:
    """Return a scenario with the objective and the soft limits of the named one.

    An experiment may change what its learner is charged; the law that it corrects stays the one that was
    tuned at the named scenario's own cost.
    """
    named = make_scenario(name)
    own = named.limits
    limits = replace(scenario.limits, soft_share=own.soft_share, soft_weight=own.soft_weight)
    return replace(scenario, objective=named.objective, limits=limits)


def base_row(law: BaseLaw, scenario: Scenario, tuned_on: Scenario | None = None) -> FloatArray:
    """Return a base law as a row (n,): fraction of the current limit per entry of the observation.

    ``flow`` is the current whose steady flow is what the table's own velocity uses,
    ``u = A_p v_a / (K_q K_v)``: it leaves the policy the flow that accelerates the table. ``lqr`` is the
    sampled-data LQR, so that the policy is a residual on top of it (Silver et al., Residual Policy
    Learning, 2018); ``preview-lqr`` adds target preview, and ``lqg-searched`` is the design that an
    independent search found.
    """
    if law == "none":
        return np.zeros(scenario.observation.size)
    if law in ("preview-lqr", LQG_SEARCHED):
        parameters = parameter_values(law, tuned_on or scenario).parameters
        controller = make_baseline(law, scenario, parameters)
        assert isinstance(controller, PreviewFeedback)
        return controller.row
    layout, actuator = scenario.plant.layout, scenario.actuator
    gain = np.zeros(layout.order)
    if law == "flow":
        gain[layout.table_velocity] = -1.0 / actuator.velocity_gain
    elif law == "lqr":
        gain = sampled_lqr(scenario.discrete, scenario.stage_cost).gain
    return action_row(scenario, gain)
