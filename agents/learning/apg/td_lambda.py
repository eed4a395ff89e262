"""TD(lambda) targets of a critic, over windows in which episodes may end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shake_env.model.parameters import FloatArray


def td_lambda_targets(
    rewards: FloatArray,
    values: FloatArray,
    ends: NDArray[np.int_],
    ended: NDArray[np.bool_],
    gamma: float,
    lam: float,
) -> FloatArray:
    """Return TD(lambda) targets (H, N) for the starts of H control periods of N tables.

    The recursive form of the lambda-return (Sutton and Barto, 2018, section 12.1). Targets from a lane's
    end on are of no use.

    Parameters
    ----------
    rewards
        (H, N) of each control period.
    values
        (H + 1, N) by the critic, at the periods' H + 1 ends.
    ends
        (N,) control periods that each lane ran within the window, 1 to H.
    ended
        (N,) whether a limit ended the lane's episode there, after which nothing follows.
    gamma, lam
        Discount per control period, and lambda [-].
    """
    targets = np.zeros_like(rewards)
    following = np.zeros(len(ends))
    for t in reversed(range(len(rewards))):
        at_end = ends == t + 1
        following = np.where(at_end, np.where(ended, 0.0, values[t + 1]), following)
        mixed = np.where(at_end, following, (1.0 - lam) * values[t + 1] + lam * following)
        following = targets[t] = rewards[t] + gamma * mixed
    return targets
