"""Laws with a memory beside a batch of tables: what each remembers and shows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.policies.estimated_law import EstimatedLaw
from agents.policies.plan_law import PlanLaw
from shake_env.model.parameters import FloatArray
from shake_env.numba_support import compiled_module
from shake_env.scenario.limits import OBSERVATION_BOUND


class MemoryBatch(ABC):
    """Laws with a memory beside N tables: what each remembers and shows.

    Parameters
    ----------
    law
        With a ``size`` M, and ``look`` and ``keep`` as `EstimatedLaw` and `PlanLaw` have them.
    lanes
        Number of tables N.
    """

    def __init__(self, law: EstimatedLaw | PlanLaw, lanes: int) -> None:
        self._law = law
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

    @abstractmethod
    def act(
        self, actions: NDArray[np.floating[Any]], authority: float, shown: NDArray[np.float32]
    ) -> FloatArray:
        """Return the actions (N,) of the next period, and take them for what the tables are given.

        Parameters
        ----------
        actions
            (N, 1), added to the laws' own where those act.
        authority
            What action 1 is, as a fraction of the current limit.
        shown
            (N, n + e) what :meth:`show` wrote.
        """

    @abstractmethod
    def _begin(self, lanes: NDArray[np.intp]) -> None:
        """Put lanes to rest, at the start of their episodes."""

    def show(
        self,
        observation: NDArray[np.float32],
        age: NDArray[np.int64],
        shown: NDArray[np.float32],
        *,
        lanes: NDArray[np.intp] | None = None,
        stepped: bool = False,
    ) -> None:
        """Take an observation in, and write what is shown.

        Parameters
        ----------
        observation
            (N, n)
        age
            (N,) periods since the start of the episode; at 0 nothing is remembered.
        shown
            (N, n + e), rows of float32: the observation, and behind it what the laws show, within the
            bounds of an observation.
        lanes
            Indices of the tables that are looked at; None: all N.
        stepped
            Whether a period under the actions given came before the observation.
        """
        which = self._lanes if lanes is None else lanes
        ages, size, bound = age[which], observation.shape[1], OBSERVATION_BOUND
        if stepped:
            given = self._action[which].clip(-1.0, 1.0)
            self._memory[which] = self._law.keep(self._known[which], given)
        self._begin(which[ages == 0])
        self._known[which], told = self._law.look(self._memory[which], observation[which], ages)
        shown[which, :size] = observation[which]
        shown[which, size:] = np.nan_to_num(told, nan=0.0, posinf=bound, neginf=-bound).clip(
            -bound, bound
        )


class LawBatch(MemoryBatch):
    """An `EstimatedLaw` for each of N tables, whose periods are compiled where there is numba.

    Parameters
    ----------
    law
        In numpy.
    lanes
        Number of tables N.
    """

    def __init__(self, law: EstimatedLaw, lanes: int) -> None:
        super().__init__(law, lanes)
        self.law = law
        self._compiled: Any = compiled_module("shake_env.kernels.estimator")
        # Columns of the observation that anything is read from, those that the estimate is first.
        size = law.size
        advanced, seen = (matrix[:, size:].any(axis=0) for matrix in (law.advance, law.show))
        used = np.flatnonzero(advanced)
        self._places = np.concatenate([used, np.flatnonzero(seen & ~advanced)])
        memory = np.arange(size)
        self._matrices = (
            np.ascontiguousarray(law.advance[:, np.concatenate([memory, size + used])].T),
            np.ascontiguousarray(law.gains),
            np.ascontiguousarray(law.begins),
            np.ascontiguousarray(law.show[:, np.concatenate([memory, size + self._places])].T),
        )

    def act(
        self, actions: NDArray[np.floating[Any]], authority: float, shown: NDArray[np.float32]
    ) -> FloatArray:
        """Return the actions (N,), corrections of the laws' own, which come last of what is shown."""
        self._action = np.empty(len(self._lanes))
        if self._compiled is not None and actions.dtype == np.float32 and actions.flags.c_contiguous:
            self._compiled.act(actions, authority, shown, self._action)
        else:
            self._action[:] = authority * actions[:, 0].astype(float) + shown[:, -1]
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
        """Weigh the readings of an observation, and write what is shown; see `MemoryBatch.show`."""
        if self._compiled is None:
            super().show(observation, age, shown, lanes=lanes, stepped=stepped)
            return
        self._compiled.look(
            self._lanes if lanes is None else lanes, stepped, self.law.actions, self._action, age,
            observation, self._places, *self._matrices, OBSERVATION_BOUND, self._memory, self._known,
            shown,
        )  # fmt: skip

    def _begin(self, lanes: NDArray[np.intp]) -> None:
        self._memory[lanes] = 0.0
