"""Histories and envelopes of motions in memory, by number, for the compiled step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from shake_env.kernels.layout import ONES
from shake_env.model.parameters import FloatArray
from shake_env.motion.targets import EpisodeMotion, FilteredNoise
from shake_env.simulation.engine import IntArray, Tables
from shake_env.simulation.motion_shapes import motion_shape


class ShapeAddresses:
    """Histories and envelopes by number, with the addresses that the compiled step takes."""

    def __init__(self, tables: Tables) -> None:
        sizes = tables.scenario.discrete
        self._discrete = sizes
        self._ahead = -(-tables.preview[0] * tables.preview[1] // sizes.substeps)
        width = sizes.layout.filter_states + 2 * sizes.layout.stories + sizes.substeps + 1
        self._arrays: list[FloatArray] = [np.zeros((1, width)), np.ones((1, sizes.substeps))]
        self._numbers: dict[EpisodeMotion, int] = {}
        self.entries = self._addresses()

    def numbers(self, motions: Sequence[EpisodeMotion], used: Any) -> IntArray:
        """Return the number of each motion's shape; numbers that are not `used` may be given again."""
        numbers = np.full(len(motions), ONES, dtype=np.int64)
        for i, motion in enumerate(motions):
            if isinstance(motion, FilteredNoise) and motion.envelope is None:
                continue
            if motion not in self._numbers:
                self._add(motion, used() | set(numbers[:i].tolist()))
            numbers[i] = self._numbers[motion]
        return numbers

    def _add(self, motion: EpisodeMotion, used: set[int]) -> None:
        array = motion_shape(motion, self._discrete, self._ahead)
        assert array is not None  # the caller asked
        for other, number in list(self._numbers.items()):
            if number not in used and len(self._numbers) > 2 * len(used):
                del self._numbers[other]
                self._arrays[number] = array
                self._numbers[motion] = number
                break
        else:
            self._numbers[motion] = len(self._arrays)
            self._arrays.append(array)
        self.entries = self._addresses()

    def _addresses(self) -> IntArray:
        return np.array([[each.ctypes.data, len(each)] for each in self._arrays], dtype=np.int64)
