"""Random streams: of the earthquake that a seed is, of a lane's next episode; and copies of them."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray


def earthquake_stream(seed: int) -> np.random.Generator:
    """Return the stream of the episode that is a seed's earthquake: motion, plant and every noise.

    The one map from seeds to earthquakes. The protocol's earthquake S and the first episode after
    ``reset(seed=S)`` of an environment are both this.
    """
    return np.random.default_rng(seed)


def stream_array(streams: Iterable[np.random.Generator | None]) -> NDArray[Any]:
    """Return copies of generators, where they stand, as an array of objects (N,)."""
    copies = copy.deepcopy(list(streams))
    array = np.empty(len(copies), dtype=object)
    array[:] = copies
    return array


def episode_stream(generator: np.random.Generator) -> np.random.Generator:
    """Return the stream of a lane's next episode.

    Spawned, so that what an episode draws never shows in what comes after.
    """
    return generator.spawn(1)[0]
