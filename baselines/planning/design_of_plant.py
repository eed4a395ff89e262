"""The design of a plan for another plant than the nominal one, in the nominal plant's units."""

from __future__ import annotations

import numpy as np

from baselines.estimation.ground_estimate import ReferenceRecursion
from baselines.planning.forecast import HorizonForecast
from baselines.planning.model import PlanningModel
from baselines.planning.nmpc import Design
from shake_env.scenario.scenario import Scenario


def design_of_plant(
    plant: Scenario,
    own: PlanningModel,
    nominal: PlanningModel,
    shown: Scenario,
    horizon: int,
    displacement_tolerance: float | None,
) -> Design:
    """Return the design of a plan on `plant`: maps of `shown`'s observation to `nominal`'s scaled state.

    Parameters
    ----------
    plant, own
        The plant that is planned on, and its model.
    nominal, shown
        The model whose scale the plan's state has, and the scenario whose scales observations have.
    horizon
        Of the plan [control periods].
    displacement_tolerance
        [m] as for `preview_lqr`.
    """
    ahead = HorizonForecast.from_scenario(plant, own, horizon, displacement_tolerance)
    recursion, cost = ReferenceRecursion.from_scenario(plant), plant.stage_cost
    layout = plant.plant.layout
    sizes = shown.plant.state_scale / plant.plant.state_scale
    e = np.r_[layout.ground, layout.reference]
    columns = np.concatenate([sizes[e], np.ones(ahead.signals.shape[1] - len(e))])
    S = nominal.scale / own.scale
    r, g = sizes[layout.reference], sizes[layout.ground]
    return Design(
        signals=ahead.signals * columns,
        place=ahead.place * columns,
        linear_cost=S[:, None] * (ahead.on_end @ ahead.end + ahead.beyond) * columns,
        curvature=S[:, None] * ahead.curvature * S,
        follow=recursion.S * r / r[:, None],
        before=recursion.W_before * g / r[:, None],
        now=recursion.W_now * g / r[:, None],
        weights=np.array([cost.acceleration, cost.force, cost.current]),
    )
