"""A controller on a plant other than that of its design: observations in the units of its design."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.controller import Controller, decide
from shake_env.errors import ScenarioError
from shake_env.scenario.scenario import Scenario


class OnOtherPlant:
    """Hands a controller of one scenario the observations of another plant with the same sensors.

    An observation is divided by scales that follow from its plant's parameters. A laboratory's readings
    are in SI, and the controller divides them by the scales of the model that it was designed on.

    Parameters
    ----------
    controller
        Designed on `design`.
    design, plant
        The scenario of the design, and the one that is driven.

    Raises
    ------
    ScenarioError
        If they show other signals.
    """

    def __init__(self, controller: Controller, design: Scenario, plant: Scenario) -> None:
        ours, theirs = design.observation, plant.observation
        if ours.names != theirs.names or design.current_limit != plant.current_limit:
            raise ScenarioError("sensing", theirs.names, "must be that of the controller's design")
        self.controller = controller
        factor = np.ones(ours.size)
        if design.sensing.full_state:
            factor[: ours.head] = plant.plant.state_scale / design.plant.state_scale
        else:
            ratio = theirs.reading_scale / ours.reading_scale
            factor[ours.readings] = ratio
            entry = np.ones(len(ratio) + design.sensing.last_action)
            entry[: len(ratio)] = ratio
            factor[ours.history] = np.tile(entry, design.sensing.history)
        self._factor = factor.astype(np.float32)

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the controller's action for an observation of the other plant."""
        return decide(self.controller, observation * self._factor, state, episode_start, deterministic)
