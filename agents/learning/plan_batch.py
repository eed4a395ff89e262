"""The plans of a batch of tables beside their environment: what each planner remembers and shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.policies.plan_law import PlanLaw
from shake_env.model.parameters import FloatArray
from shake_env.motion.targets import EpisodeMotion
from shake_env.scenario.limits import OBSERVATION_BOUND


class PlanBatch:
    """A `PlanLaw` beside N tables; the counterpart of `LawBatch`.

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
        self.law, self._motions = law, motions
        self._lanes = np.arange(lanes)
        self._memory = np.zeros((lanes, law.size))  # before the present observation
        self._known = np.zeros((lanes, law.size))  # with it
        self._action: FloatArray = np.zeros(lanes)  # given last

    @property
    def memory(self) -> FloatArray:
        """Memories (N, M) before the present observation, a copy, which can be set."""
        return self._memory.copy()

    @memory.setter
    def memory(self, memory: FloatArray) -> None:
        self._memory[:] = memory

    def act(
        self, actions: NDArray[np.floating[Any]], authority: float, shown: NDArray[np.float32]
    ) -> FloatArray:
        """Return the actions (N,) of the next period, and take them for what the tables are given.

        Parameters
        ----------
        actions
            (N, 1), added to the plans' currents where the law is corrected.
        authority
            What action 1 is, as a fraction of the current limit.
        shown
            (N, n + e) what :meth:`show` wrote.
        """
        self._action = authority * actions[:, 0].astype(float)
        if self.law.corrected:
            self._action += shown[:, -self.law.shown]
        return self._action

    def show(
        self,
        observation: NDArray[np.float32],
        age: NDArray[np.int64],
        shown: NDArray[np.float32],
        *,
        lanes: NDArray[np.intp] | None = None,
        stepped: bool = False,
    ) -> None:
        """Plan from an observation, and write what is shown.

        Parameters
        ----------
        observation
            (N, n)
        age
            (N,) periods since the start of the episode; at 0 nothing is remembered.
        shown
            (N, n + e), rows of float32: the observation, and behind it the plan, within the bounds of an
            observation.
        lanes
            Indices of the tables that are looked at; None: all N.
        stepped
            Whether a period under the actions given came before the observation.
        """
        which = self._lanes if lanes is None else lanes
        ages, size = age[which], observation.shape[1]
        if stepped:
            given = self._action[which].clip(-1.0, 1.0)
            self._memory[which] = self.law.keep(self._known[which], given)
        fresh = which[ages == 0]
        if len(fresh):
            motions = self._motions()
            self._memory[fresh] = self.law.begin([motions[lane] for lane in fresh])
        self._known[which], plan = self.law.look(self._memory[which], observation[which], ages)
        shown[which, :size] = observation[which]
        bound = OBSERVATION_BOUND
        shown[which, size:] = np.nan_to_num(plan, nan=0.0, posinf=bound, neginf=-bound).clip(
            -bound, bound
        )
