"""The laws of a batch of tables behind their estimators: what each remembers and shows."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.policies.estimated_law import EstimatedLaw
from shake_env.model.parameters import FloatArray
from shake_env.numba_support import compiled_module
from shake_env.scenario.limits import OBSERVATION_BOUND


class LawBatch:
    """An `EstimatedLaw` for each of N tables, whose periods are compiled where there is numba.

    Parameters
    ----------
    law
        In numpy.
    lanes
        Number of tables N.
    """

    def __init__(self, law: EstimatedLaw, lanes: int) -> None:
        self.law = law
        self._lanes = np.arange(lanes)
        self._memory = np.zeros((lanes, law.size))  # before the present observation
        self._known = np.zeros((lanes, law.size))  # with it
        self._action: FloatArray = np.zeros(lanes)  # given last
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

    @property
    def memory(self) -> FloatArray:
        """Memories (N, M) before the present observation, a copy, which can be set."""
        return self._memory.copy()

    @memory.setter
    def memory(self, memory: FloatArray) -> None:
        self._memory[:] = memory

    def act(
        self, correction: NDArray[np.floating[Any]], authority: float, shown: NDArray[np.float32]
    ) -> FloatArray:
        """Return the actions (N,) of the next period, and take them for what the tables are given.

        Parameters
        ----------
        correction
            (N, 1) of the laws' own actions, which come last of what is shown.
        authority
            What correction 1 adds.
        shown
            (N, n + e) what :meth:`show` wrote.
        """
        self._action = np.empty(len(self._lanes))
        if (
            self._compiled is not None
            and correction.dtype == np.float32
            and correction.flags.c_contiguous
        ):
            self._compiled.act(correction, authority, shown, self._action)
        else:
            self._action[:] = authority * correction[:, 0].astype(float) + shown[:, -1]
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
        """Weigh the readings of an observation, and write what is shown.

        Parameters
        ----------
        observation
            (N, n)
        age
            (N,) periods since the start of the episode; at 0 nothing is remembered.
        shown
            (N, n + e), rows of float32: the observation, and behind it what the laws believe, within the
            bounds of an observation.
        lanes
            Indices of the tables that are looked at; None: all N.
        stepped
            Whether a period under the actions given came before the observation.
        """
        which = self._lanes if lanes is None else lanes
        law, size = self.law, observation.shape[1]
        if self._compiled is not None:
            self._compiled.look(
                which, stepped, law.actions, self._action, age, observation, self._places,
                *self._matrices, OBSERVATION_BOUND, self._memory, self._known, shown,
            )  # fmt: skip
            return
        ages = age[which]
        if stepped:
            given = self._action[which].clip(-1.0, 1.0)
            self._memory[which] = law.keep(self._known[which], given)
        self._memory[which[ages == 0]] = 0.0
        known, believed = law.look(self._memory[which], observation[which].astype(float), ages)
        self._known[which] = known
        if not math.isfinite(believed.sum()):
            believed = np.nan_to_num(believed)
        shown[which, :size] = observation[which]
        shown[which, size:] = believed.clip(-OBSERVATION_BOUND, OBSERVATION_BOUND)
