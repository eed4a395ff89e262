"""Standard normal numbers for a batch of tables, each from a stream of its own."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.model.parameters import FloatArray
from shake_env.numba_support import compiled_module

FEW = 4  # streams whose own method is as fast
CHUNK = 64  # streams side by side: their raw numbers stay in the second-level cache
KEPT = 64  # raw numbers of a stream that may be left for the next time
# Of a hundred numbers one or two need a second raw one, so that this many more nearly always reach.
SPARE_SHARE, SPARE = 32, 24
MOST = 1024  # numbers of a stream at a time, for which what may be left suffices


class Normals:
    """The streams of N tables, and the standard normal numbers that come next in each.

    They are those of the streams' own ``standard_normal``, to the last bit. Where numba is installed raw
    numbers are drawn ahead and converted by `normal_kernel`: a stream given here belongs here.

    Parameters
    ----------
    lanes
        Number of tables N.
    """

    def __init__(self, lanes: int) -> None:
        # Generators or None; their bits have methods that the interface of all bits does not declare.
        self._streams: list[Any] = [None] * lanes
        # Raw numbers that were drawn and not used stand at the end of a row.
        self._left, self._held = np.zeros((lanes, KEPT), np.uint64), np.zeros(lanes, np.int64)
        self._raw = np.zeros((0, 0), dtype=np.uint64)

    def __setitem__(self, lane: int, stream: np.random.Generator) -> None:
        self._streams[lane], self._held[lane] = stream, 0

    @property
    def lanes(self) -> list[int]:
        """Those that have a stream."""
        return [lane for lane, stream in enumerate(self._streams) if stream is not None]

    def fill(self, lanes: Sequence[int], out: FloatArray) -> None:
        """Write the next numbers of some lanes' streams, which they have, to `out` (n, count)."""
        kernel = compiled_module("shake_env.kernels.normals") if len(lanes) >= FEW else None
        suits = kernel is not None and kernel.numpys() is not None
        if not (suits and all(_suits(self._streams[lane]) for lane in lanes)):
            for lane, row in zip(lanes, out, strict=True):
                self._own(lane).standard_normal(out=row)
            return
        index = np.asarray(lanes)
        for start in range(0, len(lanes), CHUNK):
            part = slice(start, start + CHUNK)
            for first in range(0, out.shape[1], MOST):
                self._convert(kernel, index[part], out[part, first : first + MOST])

    def _own(self, lane: int) -> np.random.Generator:
        """Return a lane's stream at the number that comes next."""
        if held := int(self._held[lane]):
            self._streams[lane].bit_generator.advance(-held)
            self._held[lane] = 0
        stream: np.random.Generator = self._streams[lane]
        return stream

    def _convert(self, kernel: Any, lanes: NDArray[np.intp], out: FloatArray) -> None:
        count = out.shape[1]
        wanted = count + min(count // SPARE_SHARE + SPARE, KEPT)
        if len(self._raw) < len(lanes) or self._raw.shape[1] < KEPT + wanted:
            self._raw = np.zeros((min(len(self._held), CHUNK), KEPT + wanted), dtype=np.uint64)
        raw, held = self._raw, self._held[lanes]
        raw[: len(lanes), :KEPT] = self._left[lanes]
        made = np.maximum(wanted - held, 0)
        for row, lane, fresh in zip(raw, lanes.tolist(), made.tolist(), strict=False):
            row[KEPT : KEPT + fresh] = self._streams[lane].bit_generator.random_raw(fresh)
        short = kernel.convert(raw, held, out, made, KEPT, *kernel.numpys())
        self._left[lanes], self._held[lanes] = raw[: len(lanes), :KEPT], held
        if short:
            for n in np.flatnonzero(made < count):
                self._convert(kernel, lanes[n : n + 1], out[n : n + 1, made[n] :])

    def snapshot(self) -> list[np.random.Generator | None]:
        """Return copies of the streams, each at the number that comes next."""
        whole = copy.copy(self)
        whole._streams, whole._held = copy.deepcopy(self._streams), self._held.copy()
        for lane in whole.lanes:
            whole._own(lane)
        return whole._streams

    def restore(self, snapshot: Sequence[np.random.Generator | None]) -> None:
        """Go on from a `snapshot` of the same number of lanes."""
        self._streams = copy.deepcopy(list(snapshot))
        self._held[:] = 0


def _suits(stream: np.random.Generator | None) -> bool:
    # 64 raw bits a number, and a way back.
    return stream is not None and type(stream.bit_generator) in (np.random.PCG64, np.random.PCG64DXSM)
