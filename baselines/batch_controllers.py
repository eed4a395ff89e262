"""One controller for each environment of a batch, and controllers with rescaled observations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.controller import Controller, decide
from shake_env.errors import ParameterError
from shake_env.scenario.scenario import Scenario


class PerLane:
    """One controller for each table of a batch.

    Parameters
    ----------
    controllers
        One a lane.

    Raises
    ------
    ParameterError
        In `predict`, if the batch has another number of lanes.
    """

    def __init__(self, controllers: Sequence[Controller]) -> None:
        self.controllers = list(controllers)

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the actions (N, 1) for observations (N, n), each by its lane's controller."""
        if observation.ndim != 2 or len(observation) != len(self.controllers):
            raise ParameterError(
                "observation shape", observation.shape, f"needs {len(self.controllers)} lanes"
            )
        memories = (None,) * len(observation) if state is None else state
        actions, next_memories = [], []
        for lane, controller in enumerate(self.controllers):
            begins = None if episode_start is None else episode_start[lane : lane + 1]
            action, memory = decide(controller, observation[lane], memories[lane], begins, deterministic)
            actions.append(action)
            next_memories.append(memory)
        return np.stack(actions), tuple(next_memories)


class _Rows:
    """Linear laws of one row a lane."""

    def __init__(self, rows: NDArray[np.float64]) -> None:
        self._rows = rows

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        action = np.clip(np.sum(observation * self._rows, axis=-1), -1.0, 1.0)
        return action[..., None].astype(np.float32), None


class Rescaled:
    """A controller that reads observations over another plant's scale, by a `rescaling` (n,)."""

    def __init__(self, controller: Controller, factor: NDArray[np.float64]) -> None:
        self._controller, self._factor = controller, factor

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the inner controller's action (..., 1) for an observation (..., n), and its memory."""
        scaled = (observation * self._factor).astype(np.float32)
        return decide(self._controller, scaled, state, episode_start, deterministic)


def rescaling(observed: Scenario, plant: Scenario) -> NDArray[np.float64]:
    """Return the factors (n,) from a full-state observation of `observed` to one of `plant`."""
    factor = np.ones(observed.observation.size)
    scale = observed.plant.state_scale
    factor[: len(scale)] = scale / plant.plant.state_scale
    return factor
