"""The plans of a batch of tables beside their environment: what each planner remembers and shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.learning.law_batch import MemoryBatch
from agents.policies.plan_law import PlanLaw
from shake_env.model.parameters import FloatArray
from shake_env.motion.targets import EpisodeMotion


class PlanBatch(MemoryBatch):
    """A `PlanLaw` beside N tables.

    Parameters
    ----------
    law
        Of the scenario of the tables.
    lanes
        Number of tables N.
    motions
        Returns the motions that the N tables have now.
    """

    def __init__(self, law: PlanLaw, lanes: int, motions: Callable[[], Sequence[EpisodeMotion]]) -> None:
        super().__init__(law, lanes)
        self.law, self._motions = law, motions

    def act(
        self, actions: NDArray[np.floating[Any]], authority: float, shown: NDArray[np.float32]
    ) -> FloatArray:
        """Return the actions (N,), added to the plans' currents where the law is corrected."""
        self._action = authority * actions[:, 0].astype(float)
        if self.law.corrected:
            self._action += shown[:, -self.law.shown]
        return self._action

    def _begin(self, lanes: NDArray[np.intp]) -> None:
        if len(lanes):
            motions = self._motions()
            self._memory[lanes] = self.law.begin([motions[lane] for lane in lanes])
