"""What the current cannot reach: target, ground-filter state and reference specimen, computed ahead.

Each lane (table) of a batch has a motion and a random stream of its own. Blocks of control periods are
filled for all lanes at once, whatever their place in their episodes; the lanes share one cursor, so
that a step reads one contiguous slice. Memory is the block's, and an envelope's where motions have one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from shake_env.dynamics.ground import GroundMaps, GroundPeriod, IntArray, Rows, filter_state
from shake_env.dynamics.nonlinear import apply
from shake_env.errors import ParameterError
from shake_env.model.discretization import DiscretePlant
from shake_env.model.nonlinearity import Yielding
from shake_env.model.parameters import FloatArray, GroundFilter
from shake_env.motion.targets import (
    Envelope,
    EpisodeMotion,
    FilteredNoise,
    RecordedMotion,
    target_history,
)
from shake_env.numba_support import compiled_module
from shake_env.simulation.random_streams import Normals

BLOCK_STEPS = 64  # control periods computed ahead
CHUNK = 64  # lanes whose draws, some 300 kB, are used before they leave the cache


def control_steps(motion: EpisodeMotion, period: float, physics_step: float) -> int:
    """Return the number of whole control periods in a motion.

    Raises
    ------
    ParameterError
        If the motion is shorter than one period.
    """
    if isinstance(motion, FilteredNoise):
        duration = motion.duration
    else:
        duration = (len(target_history(motion, physics_step).acceleration) - 1) * physics_step
    steps = math.floor(duration / period + 1e-9)
    if steps < 1:
        raise ParameterError("duration", duration, f"must hold at least one control period ({period} s)")
    return steps


def _stacked(matrix: FloatArray) -> FloatArray:
    """Return a matrix, or one a lane, as a stack (1 or N, rows, columns)."""
    return matrix if matrix.ndim == 3 else matrix[None]


@lru_cache(maxsize=64)
def _filter_history(ground: GroundFilter, motion: RecordedMotion, dt: float) -> FloatArray:
    return filter_state(ground, target_history(motion, dt), dt)


class Excitation:
    """The ground under a batch of tables.

    Parameters
    ----------
    discrete
        Plant, physics step and control period.
    lanes
        Number of tables N.
    maps
        How the ground of each lane is computed; None: as for `discrete` with a linear specimen.
    preview
        Number of target samples to show ahead, and the physics steps between them.
    """

    def __init__(
        self,
        discrete: DiscretePlant,
        lanes: int,
        maps: GroundMaps | None = None,
        preview: tuple[int, int] = (0, 1),
    ) -> None:
        self._discrete = discrete
        self._samples, self._spacing = preview
        # Periods beyond the present one that the preview reaches into.
        self._ahead = math.ceil(self._samples * self._spacing / discrete.substeps)
        self._length = BLOCK_STEPS + self._ahead
        self._rows = Rows.of(discrete)
        self.maps = GroundMaps.of(discrete, Yielding()) if maps is None else maps
        self._exogenous = self._rows.ground + self._rows.reference
        self._draws = self.maps.noise.shape[-1] - self._exogenous
        self._motions: list[EpisodeMotion] = [FilteredNoise()] * lanes
        self._normals = Normals(lanes)
        self._filled = np.zeros(lanes, dtype=int)  # control periods of its motion each lane has filled
        self._tail = np.zeros((lanes, self._exogenous))  # exogenous state at the filled end
        stories = discrete.layout.stories
        self._slipping = np.zeros((lanes, 3 * stories))  # yielding reference at the filled end
        self._last_target = np.zeros(lanes)  # target there
        # Two, in turn: the period handed out last stays what it is when the next block is computed.
        # Tables lie innermost, so that a step reads each quantity of neighbouring ones in a row.
        self._store, self._spare = np.zeros((2, self._length, self._rows.width, lanes))
        self._noise = np.empty((min(lanes, CHUNK), self._length, self._draws))
        self._cursor = 0
        # Kinds of envelope that the lanes' motions have, with the intensity in each physics step.
        self._envelopes: list[Envelope | None] = [None]
        self._intensity: list[FloatArray] = [np.ones(0)]
        self._kind, self._amplitude = np.zeros(lanes, dtype=np.int64), np.ones(lanes)

    @property
    def _buffer(self) -> FloatArray:
        """The ground ahead, (length, N, width), a view."""
        return self._store.swapaxes(1, 2)

    def start(
        self,
        lanes: Sequence[int],
        motions: Sequence[EpisodeMotion],
        streams: Sequence[np.random.Generator],
    ) -> GroundPeriod:
        """Begin a motion in each of `lanes`, whose first period is the next one taken.

        Returns
        -------
        The ground at time 0, one row a lane; its target and reference shear are the values at rest.
        """
        initial = np.zeros((len(lanes), self._rows.width))
        for row, (lane, motion, stream) in enumerate(zip(lanes, motions, streams, strict=True)):
            self._motions[lane], self._normals[lane] = motion, stream
            self._shape(lane, motion)
            self._filled[lane] = 0
            self._tail[lane] = self._slipping[lane] = self._last_target[lane] = 0.0
            if isinstance(motion, RecordedMotion):
                history = target_history(motion, self._discrete.dt)
                states = _filter_history(self._discrete.plant.ground, motion, self._discrete.dt)
                initial[row, : self._rows.ground] = states[0]
                self._last_target[lane] = history.acceleration[0]
        if self._cursor == BLOCK_STEPS:
            self._wrap(without=lanes)
        self._fill(list(lanes), self._cursor)
        preview = self._preview(self._store, self._cursor, np.asarray(lanes, dtype=int))
        return self._rows.period(initial, preview)

    def advance(self) -> GroundPeriod:
        """Return the next control period of every lane, (N, ...); valid until the next call."""
        return self.period(*self.take())

    def take(self) -> tuple[FloatArray, int]:
        """Return the ground ahead (length, width, N) and the row in it of the next control period."""
        if self._cursor == BLOCK_STEPS:
            self._wrap()
        self._cursor += 1
        return self._store, self._cursor - 1

    def period(self, store: FloatArray, row: int) -> GroundPeriod:
        """Return the control period that `take` gave, (N, ...); valid until its next call."""
        return self._rows.period(store[row].T, self._preview(store, row + 1))

    def _wrap(self, without: Sequence[int] = ()) -> None:
        """Move what is already known to the front of the buffer, and fill the rest."""
        self._cursor = 0
        self._store, self._spare = self._spare, self._store
        self._store[: self._ahead] = self._spare[BLOCK_STEPS:]
        others = set(self._normals.lanes).difference(without)
        self._fill(sorted(others), self._ahead)

    def _preview(
        self, store: FloatArray, row: int, lanes: IntArray | slice = slice(None)
    ) -> FloatArray | None:
        """Return the target samples (lanes, samples) that come from a row on [m/s^2]."""
        if not self._samples:
            return None
        coming = store[row : row + self._ahead, self._rows.target, lanes]
        steps = coming.reshape(-1, coming.shape[-1]).T
        return steps[:, self._spacing - 1 :: self._spacing][:, : self._samples]

    def _fill(self, lanes: list[int], first: int) -> None:
        """Fill the buffer from row `first` on for `lanes`."""
        if not lanes:
            return
        recorded = [lane for lane in lanes if isinstance(self._motions[lane], RecordedMotion)]
        noisy = sorted(lane for lane in lanes if not isinstance(self._motions[lane], RecordedMotion))
        if recorded:
            self._run_records(np.asarray(recorded), first)
        if noisy:
            self._run_filter(np.asarray(noisy), first)
        self._filled[lanes] += self._length - first
        if self.maps.yielding is not None:
            self._run_yielding(np.asarray(lanes), first)

    def _shape(self, lane: int, motion: EpisodeMotion) -> None:
        """Note what shapes the noise of a lane's motion."""
        envelope = motion.envelope if isinstance(motion, FilteredNoise) else None
        if envelope not in self._envelopes:
            # In the place of one that no lane has any more, so that their number stays the lanes'.
            used = {0, *np.delete(self._kind, lane).tolist()}
            kind = next(i for i in range(len(used) + 1) if i not in used)
            if kind == len(self._envelopes):
                self._envelopes.append(None)
                self._intensity.append(np.ones(0))
            self._envelopes[kind], self._intensity[kind] = envelope, np.ones(0)
        self._kind[lane], self._amplitude[lane] = self._envelopes.index(envelope), motion.amplitude

    def _shapes(self, lanes: IntArray, steps: int) -> tuple[FloatArray, IntArray]:
        """Return the intensity (kinds, steps, k) of the coming periods, and each lane's kind.

        Lanes at the same place of the same envelope share one.
        """
        k, dt = self._discrete.substeps, self._discrete.dt
        both = np.stack([self._kind[lanes], self._filled[lanes] * k])
        if (both == both[:, :1]).all():
            pairs, which = both[:, :1], np.zeros(len(lanes), dtype=np.int64)
        else:
            pairs, which = np.unique(both, axis=1, return_inverse=True)
        found = np.ones((pairs.shape[1], steps * k))
        for row, (kind, at) in enumerate(pairs.T.tolist()):
            envelope = self._envelopes[kind]
            if envelope is not None:
                if len(self._intensity[kind]) < at + steps * k:
                    time = (np.arange(2 * (at + steps * k)) + 0.5) * dt
                    self._intensity[kind] = envelope.at(time)
                found[row] = self._intensity[kind][at : at + steps * k]
        return found.reshape(-1, steps, k), which.reshape(-1).astype(np.int64)

    def _run_filter(self, lanes: IntArray, first: int) -> None:
        intensity, which = self._shapes(lanes, self._length - first)
        for start in range(0, len(lanes), CHUNK):
            part = slice(start, start + CHUNK)
            self._filter(lanes[part], first, intensity, which[part])

    def _filter(self, lanes: IntArray, first: int, intensity: FloatArray, which: IntArray) -> None:
        steps = self._length - first
        drawn = self._noise.reshape(len(self._noise), -1)[: len(lanes), : steps * self._draws]
        self._normals.fill(lanes.tolist(), drawn)
        amplitude = self._amplitude[lanes]
        kernel = compiled_module("shake_env.kernels.ground")
        if kernel is not None:
            maps = _stacked(self.maps.noise)
            kernel.run_filter(
                self._store, self._noise, self._tail, maps, lanes, intensity, which, amplitude, first
            )
            return
        noise = self._noise[: len(lanes), :steps]
        shaped = noise.reshape(len(lanes), steps, self._discrete.substeps, -1)
        shaped = shaped * intensity[which][..., None] * amplitude[:, None, None, None]
        noise = shaped.reshape(noise.shape)
        step_map = self.maps.pick(lanes).noise
        joined = np.empty((len(lanes), self._exogenous + self._draws))
        joined[:, : self._exogenous] = self._tail[lanes]
        for offset, row in enumerate(range(first, self._length)):
            joined[:, self._exogenous :] = noise[:, offset]
            moved = apply(step_map, joined)
            self._buffer[row, lanes] = moved
            joined[:, : self._exogenous] = moved[:, : self._exogenous]
        self._tail[lanes] = joined[:, : self._exogenous]

    def _run_records(self, lanes: IntArray, first: int) -> None:
        k, dt, rows = self._discrete.substeps, self._discrete.dt, self._rows
        steps = self._length - first
        samples = np.zeros((len(lanes), steps * k + 1))  # past the motion's end 0, which a preview shows
        states = np.zeros((len(lanes), steps, rows.ground))
        for row, lane in enumerate(lanes):
            motion = self._motions[lane]
            assert isinstance(motion, RecordedMotion)  # as _fill sorted them
            begin = self._filled[lane] * k
            part = target_history(motion, dt).acceleration[begin : begin + steps * k + 1]
            samples[row, : len(part)] = part
            ends = _filter_history(self._discrete.plant.ground, motion, dt)[begin + k :: k][:steps]
            states[row, : len(ends)] = ends
        kernel = compiled_module("shake_env.kernels.ground")
        if kernel is not None:
            maps = _stacked(self.maps.record)
            kernel.run_records(self._store, samples, states, self._tail, maps, lanes, first)
            return
        step_map = self.maps.pick(lanes).record
        x = self._tail[lanes, rows.ground :]
        reference = slice(rows.ground, self._exogenous)
        target = slice(self._exogenous, self._exogenous + k)
        for offset, row in enumerate(range(first, self._length)):
            now = samples[:, offset * k : offset * k + k + 1]
            moved = apply(step_map, np.concatenate([x, now], axis=1))
            x = moved[:, : rows.reference]
            self._buffer[row, lanes, : rows.ground] = states[:, offset]
            self._buffer[row, lanes, reference] = x
            self._buffer[row, lanes, target] = now[:, 1:]
            self._buffer[row, lanes, target.stop :] = moved[:, rows.reference :]
        self._tail[lanes, rows.ground :] = x

    def _run_yielding(self, lanes: IntArray, first: int) -> None:
        """Put the yielding reference in the place of the linear one."""
        assert self.maps.yielding is not None  # the caller asked
        k, n = self._discrete.substeps, self._discrete.layout.stories
        at, kernel = self._exogenous, compiled_module("shake_env.kernels.ground")
        if kernel is not None:
            whole = self.maps.yielding
            parts = (whole.A, whole.ground, whole.ground_next, whole.level)
            kernel.run_yielding(
                self._store,
                self._slipping,
                self._last_target,
                _stacked(np.concatenate(parts, axis=-1)),
                _stacked(whole.slope),
                _stacked(whole.C),
                kernel.law(whole.yielding),
                lanes,
                first,
                self._rows.ground,
                k,
            )
            return
        block = self._buffer[first:, lanes]
        target = block[:, :, at : at + k].transpose(0, 2, 1).reshape(-1, len(lanes))
        target = np.concatenate([self._last_target[None, lanes], target])
        reference = self.maps.yielding.pick(lanes)
        final, states, shear = reference.run(self._slipping[lanes], target)
        self._slipping[lanes], self._last_target[lanes] = final, target[-1]
        block[:, :, self._rows.ground : at] = states[k - 1 :: k, :, : 2 * n]
        block[:, :, at + k : at + 2 * k] = shear.reshape(-1, k, len(lanes)).transpose(0, 2, 1)
        self._buffer[first:, lanes] = block

    def snapshot(self) -> dict[str, Any]:
        """Return everything that `restore` needs to go on exactly, as plain picklable values."""
        return {
            "motions": list(self._motions),
            "streams": self._normals.snapshot(),
            "filled": self._filled.copy(),
            "tail": self._tail.copy(),
            "slipping": self._slipping.copy(),
            "last_target": self._last_target.copy(),
            "buffer": self._buffer.copy(),
            "cursor": self._cursor,
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a `snapshot` of an excitation of the same plant and number of lanes."""
        self._motions = list(snapshot["motions"])
        self._normals.restore(snapshot["streams"])
        for lane, motion in enumerate(self._motions):
            self._shape(lane, motion)
        self._filled[:] = snapshot["filled"]
        self._tail[:] = snapshot["tail"]
        self._slipping[:] = snapshot["slipping"]
        self._last_target[:] = snapshot["last_target"]
        self._buffer[:] = snapshot["buffer"]
        self._cursor = snapshot["cursor"]
