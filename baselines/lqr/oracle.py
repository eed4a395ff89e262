"""Oracle controller: true plant parameters, full state, 0.5 s target preview, no loop delay.

It is the reference for regret. On a linear plant without a displacement weight no causal law with the
same samples of the target has a lower cost. One that also knew the target between the control instants
could: on the linear scenario the oracle has 0.22 of LQR's cost, and 0.14 with the whole future known.
With friction or limits it is preview LQR with known parameters and friction and orifice feed-forward,
and a better law may exist; for yielding storeys it uses the elastic specimen. Where the stroke is
limited it has a displacement weight; a smaller one would reduce its cost by 2 to 4 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.batch_controllers import PerLane, Rescaled, _Rows, rescaling
from baselines.lqr.feedforward import FeedforwardLQR
from baselines.lqr.preview import PreviewFeedback, preview_lqr
from shake_env.controller import Controller
from shake_env.rollout import Earthquake, sampled_plants
from shake_env.scenario.observation import Sensing
from shake_env.scenario.scenario import Scenario

POSITION = 0.05  # [m] see `preview_lqr`; where the stroke is limited
FRICTION_POSITION = 0.01  # [m] where a part is nonlinear, too: holding the place holds friction's drift
PREVIEW = 0.5  # [s] of samples a control period apart; a longer one gains a percent


def oracle_view(scenario: Scenario) -> Scenario:
    """Return the scenario as the oracle observes it: full state, preview, no delay, same plants."""
    uncertainty = replace(scenario.uncertainty, delay=None)
    return replace(scenario, sensing=Sensing(preview=PREVIEW), delay=0.0, uncertainty=uncertainty)


def oracle_controller(
    scenario: Scenario, earthquakes: Sequence[Earthquake]
) -> tuple[Scenario, Controller]:
    """Return the scenario to run the oracle on, and the oracle for these earthquakes.

    Parameters
    ----------
    scenario
        What others are compared on.
    earthquakes
        One a lane of the roll-out, in order: their seeds fix the plants.
    """
    view = oracle_view(scenario)
    plants = sampled_plants(view, earthquakes)
    parts = scenario.parts
    if parts.friction.active or parts.valve.flow_active:
        # Without the ground's high-pass there is no place that a table could be held in.
        position = FRICTION_POSITION if view.ground.states == 4 else None
        if not view.uncertainty.active:
            return view, FeedforwardLQR(view, position=position)
        laws = [FeedforwardLQR(plant, position=position) for plant in plants]
        scales = np.stack([rescaling(view, plant) for plant in plants])
        return view, PerLane([Rescaled(law, row) for law, row in zip(laws, scales, strict=True)])
    rows: dict[Any, NDArray[np.float64]] = {}
    for plant in plants:
        key = (plant.actuator, plant.specimen)
        if key not in rows:
            position = None
            if plant.limits.table_displacement is not None and plant.ground.states == 4:
                position = FRICTION_POSITION if plant.nonlinearity.active else POSITION
            design = preview_lqr(plant.discrete, plant.stage_cost, PREVIEW, position=position)
            rows[key] = PreviewFeedback(plant, design).row * rescaling(view, plant)
    return view, _Rows(np.stack([rows[plant.actuator, plant.specimen] for plant in plants]))
