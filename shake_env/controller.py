"""The one interface of everything that drives a table."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray


@runtime_checkable
class Controller(Protocol):
    """SB3's own signature, so that LQR, PID and a trained policy are interchangeable.

    A controller's memory (integrators, estimates) is the state that it returns and gets back.
    """

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the action for an observation.

        Parameters
        ----------
        observation
            (n,) or (N, n), as the environment gives it.
        state
            What the last call returned; None at the start.
        episode_start
            (N,) True where an episode has just begun, so that memory starts afresh there.
        deterministic
            False lets a stochastic policy sample.

        Returns
        -------
        action, state
            Action (1,) or (N, 1), as the environment takes it, and the controller's memory.
        """
        ...


def decide(
    controller: Controller,
    observation: NDArray[np.float32],
    state: tuple[Any, ...] | None = None,
    episode_start: NDArray[np.bool_] | None = None,
    deterministic: bool = True,
) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
    """Return `controller.predict` of copies: the arrays of the caller cannot be changed by it.

    Every roll-out and every wrapper asks its controller through this function. The copy of the
    observation is read-only, so that a controller which writes into it is stopped with numpy's
    ValueError rather than misled.
    """
    shown = np.array(observation)
    shown.flags.writeable = False
    begins = None if episode_start is None else np.array(episode_start, dtype=bool)
    return controller.predict(shown, state, begins, deterministic)


class NoControl:
    """Zero valve current: the uncontrolled table."""

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return zeros, (..., 1)."""
        return np.zeros((*observation.shape[:-1], 1), dtype=np.float32), None
