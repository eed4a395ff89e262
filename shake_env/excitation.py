"""What the current cannot reach: target, ground-filter state and reference specimen, computed ahead.

Each lane (table) of a batch has a motion and a random stream of its own. Blocks of control periods are
filled for all lanes at once, whatever their place in their episodes; the lanes share one cursor, so
that a step reads one contiguous slice. Memory is the block's, never the episode's.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from shake_env.discretization import DiscretePlant
from shake_env.dynamics import as_like
from shake_env.errors import ParameterError
from shake_env.motion import FilteredNoise, Motion, RecordedMotion, TargetHistory, target_history
from shake_env.parameters import FloatArray

Array = Any  # a numpy array or a torch tensor
BLOCK_STEPS = 64  # control periods computed ahead


@dataclass(frozen=True)
class GroundPeriod:
    """The ground over one control period of k physics steps."""

    ground: Array  # (..., 2 or 4) filter state x_W at the period's end, SI
    reference: Array  # (..., 2 stories) reference specimen x~_S at the period's end, SI
    target: Array  # (..., k) target acceleration y~ after each physics step [m/s^2]
    reference_shear: Array  # (..., k) reference base shear f~_s after each physics step [N]
    drive: Array | None  # (..., 4 + 2 stories + 2 k) or None, see TableDynamics.control_step

    def like(self, array: Array) -> GroundPeriod:
        """Return this period in the library, precision and device of `array`."""
        drive = None if self.drive is None else as_like(self.drive, array)
        return GroundPeriod(
            as_like(self.ground, array),
            as_like(self.reference, array),
            as_like(self.target, array),
            as_like(self.reference_shear, array),
            drive,
        )


def control_steps(motion: Motion, period: float, physics_step: float) -> int:
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


@dataclass(frozen=True)
class _Rows:
    """Width of each part of a buffer row, in order."""

    ground: int
    reference: int
    substeps: int
    drive: int

    @property
    def width(self) -> int:
        return self.ground + self.reference + 2 * self.substeps + self.drive

    def period(self, row: FloatArray) -> GroundPeriod:
        cuts = np.cumsum([self.ground, self.reference, self.substeps, self.substeps])
        ground, reference, target, shear, drive = np.split(row, cuts, axis=-1)
        return GroundPeriod(ground, reference, target, shear, drive if self.drive else None)

    @classmethod
    def of(cls, discrete: DiscretePlant) -> _Rows:
        layout, k = discrete.layout, discrete.substeps
        # In the corrected equations the target reaches the table through the current only.
        felt = discrete.plant.equations.specimen_feels_target
        drive = 4 + 2 * layout.stories + 2 * k if felt else 0
        return cls(layout.filter_states, 2 * layout.stories, k, drive)


def _noise_map(discrete: DiscretePlant) -> FloatArray:
    """Return the map ``[x_W, x~_S, draws] -> row`` of one control period."""
    layout, lifted = discrete.layout, discrete.lifted
    exogenous = np.r_[layout.ground, layout.reference]
    columns = np.r_[exogenous, layout.order + 1 : lifted.state.shape[1]]
    blocks = [
        lifted.state[np.ix_(exogenous, columns)],
        lifted.outputs[:, 2, columns],
        lifted.outputs[:, 3, columns],
    ]
    if discrete.plant.equations.specimen_feels_target:
        blocks += [
            lifted.state[np.ix_(np.r_[layout.controlled], columns)],
            lifted.outputs[:, 0, columns],
            lifted.outputs[:, 1, columns],
        ]
    return np.vstack(blocks)


def filter_state(discrete: DiscretePlant, history: TargetHistory) -> FloatArray:
    """Return the filter state (samples, 2 or 4) that a recorded target would have come from.

    ``x_w' = y~ / (2 zeta_g omega_g)`` and x_w its integral; with the high-pass, y~ first becomes the
    high-pass's input, whose states are the ground's displacement and velocity.
    """
    ground = discrete.plant.ground
    gain = 2.0 * ground.damping_ratio * ground.omega
    if ground.highpass_frequency is None:
        return np.stack([history.velocity, history.acceleration], axis=-1) / gain
    omega_h = 2.0 * math.pi * ground.highpass_frequency
    friction = 2.0 * ground.highpass_damping_ratio * omega_h
    x, v, a = history.displacement, history.velocity, history.acceleration
    source = a + friction * v + omega_h**2 * x
    # The integral of the source is known from v and x but for the integral of x, whose own drift is
    # what the high-pass removes.
    integral = v + friction * x + omega_h**2 * _running_integral(x, discrete.dt)
    return np.stack([integral / gain, source / gain, x, v], axis=-1)


def _running_integral(values: FloatArray, step: float) -> FloatArray:
    summed = np.cumsum(values) * step
    line = np.linspace(0.0, 1.0, len(values))
    return summed - np.polyval(np.polyfit(line, summed, 1), line)


@lru_cache(maxsize=64)
def _recorded_rows(discrete: DiscretePlant, motion: RecordedMotion) -> tuple[FloatArray, FloatArray]:
    """Return the initial exogenous state and the rows (steps, width) of a recorded motion."""
    rows, layout, k = _Rows.of(discrete), discrete.layout, discrete.substeps
    steps = control_steps(motion, k * discrete.dt, discrete.dt)
    history = target_history(motion, discrete.dt)
    samples = np.lib.stride_tricks.sliding_window_view(history.acceleration, k + 1)[::k][:steps]
    states = filter_state(discrete, history)[::k][: steps + 1]

    lifted, w = discrete.lifted_record, layout.filter_states
    n = layout.order - w
    reference = np.r_[layout.reference] - w
    columns = np.r_[reference, n + 1 : n + 2 + k]
    blocks = [lifted.state[np.ix_(reference, columns)], lifted.outputs[:, 2, columns]]
    if rows.drive:
        controlled = np.r_[layout.controlled] - w
        blocks += [
            lifted.state[np.ix_(controlled, columns)],
            lifted.outputs[:, 0, columns],
            lifted.outputs[:, 1, columns],
        ]
    step_map = np.vstack(blocks).T
    x = np.zeros(2 * layout.stories)
    result = np.empty((steps, rows.width))
    for t in range(steps):
        moved = np.concatenate([x, samples[t]]) @ step_map
        x = moved[: len(x)]
        shear, drive = moved[len(x) : len(x) + k], moved[len(x) + k :]
        result[t] = np.concatenate([states[t + 1], x, samples[t, 1:], shear, drive])
    result.flags.writeable = False
    return np.concatenate([states[0], np.zeros(2 * layout.stories)]), result


class Excitation:
    """The ground under a batch of tables.

    Parameters
    ----------
    discrete
        Plant, physics step and control period.
    lanes
        Number of tables N.
    """

    def __init__(self, discrete: DiscretePlant, lanes: int) -> None:
        self._discrete = discrete
        self._rows = _Rows.of(discrete)
        self._map = np.ascontiguousarray(_noise_map(discrete).T)
        self._exogenous = self._rows.ground + self._rows.reference
        self._draws = self._map.shape[0] - self._exogenous
        self._motions: list[Motion] = [FilteredNoise()] * lanes
        self._streams: list[np.random.Generator | None] = [None] * lanes
        self._filled = np.zeros(lanes, dtype=int)  # control periods of its motion each lane has filled
        self._tail = np.zeros((lanes, self._exogenous))  # exogenous state at the filled end
        self._buffer = np.zeros((BLOCK_STEPS, lanes, self._rows.width))
        self._noise = np.empty((lanes, BLOCK_STEPS, self._draws))
        self._cursor = 0

    def start(
        self, lanes: Sequence[int], motions: Sequence[Motion], streams: Sequence[np.random.Generator]
    ) -> GroundPeriod:
        """Begin a motion in each of `lanes`, whose first period is the next one taken.

        Returns
        -------
        The ground at time 0, one row a lane; its target and reference shear are the values at rest.
        """
        initial = np.zeros((len(lanes), self._rows.width))
        for row, (lane, motion, stream) in enumerate(zip(lanes, motions, streams, strict=True)):
            self._motions[lane], self._streams[lane] = motion, stream
            self._filled[lane] = 0
            self._tail[lane] = 0.0
            if isinstance(motion, RecordedMotion):
                initial[row, : self._exogenous] = _recorded_rows(self._discrete, motion)[0]
        if self._cursor < BLOCK_STEPS:
            self._fill(list(lanes), self._cursor)
        return self._rows.period(initial)

    def advance(self) -> GroundPeriod:
        """Return the next control period of every lane, (N, ...); valid until the next call."""
        if self._cursor == BLOCK_STEPS:
            self._cursor = 0
            self._fill([lane for lane, stream in enumerate(self._streams) if stream is not None], 0)
        row = self._buffer[self._cursor]
        self._cursor += 1
        return self._rows.period(row)

    def _fill(self, lanes: list[int], first: int) -> None:
        """Fill the block from row `first` on for `lanes`."""
        noisy = []
        steps = BLOCK_STEPS - first
        for lane in lanes:
            motion = self._motions[lane]
            if isinstance(motion, RecordedMotion):
                recorded = _recorded_rows(self._discrete, motion)[1]
                part = recorded[self._filled[lane] : self._filled[lane] + steps]
                self._buffer[first : first + len(part), lane] = part
                self._buffer[first + len(part) :, lane] = 0.0  # past the end: never read
                self._filled[lane] += steps
            else:
                noisy.append(lane)
                self._draw(lane, motion, steps)
        if noisy:
            self._run_filter(np.asarray(noisy), first)

    def _draw(self, lane: int, motion: FilteredNoise, steps: int) -> None:
        stream, noise = self._streams[lane], self._noise[lane, :steps]
        assert stream is not None  # only started lanes are filled
        stream.standard_normal(out=noise)
        if motion.envelope is not None:
            k = self._discrete.substeps
            begun = (self._filled[lane] + np.arange(steps))[:, None] * k + np.arange(k)
            intensity = motion.envelope.at((begun + 0.5) * self._discrete.dt)
            noise.reshape(steps, k, -1)[...] *= intensity[..., None]
        noise *= motion.amplitude
        self._filled[lane] += steps

    def _run_filter(self, lanes: FloatArray, first: int) -> None:
        every = len(lanes) == len(self._motions)
        pick = slice(None) if every else lanes
        joined = np.empty((len(lanes), self._exogenous + self._draws))
        joined[:, : self._exogenous] = self._tail[pick]
        for offset, row in enumerate(range(first, BLOCK_STEPS)):
            joined[:, self._exogenous :] = self._noise[pick, offset]
            moved = joined @ self._map
            self._buffer[row, pick] = moved
            joined[:, : self._exogenous] = moved[:, : self._exogenous]
        self._tail[pick] = joined[:, : self._exogenous]

    def snapshot(self) -> dict[str, Any]:
        """Return everything that `restore` needs to go on exactly, as plain picklable values."""
        return {
            "motions": list(self._motions),
            "streams": copy.deepcopy(self._streams),
            "filled": self._filled.copy(),
            "tail": self._tail.copy(),
            "buffer": self._buffer.copy(),
            "cursor": self._cursor,
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a `snapshot` of an excitation of the same plant and number of lanes."""
        self._motions = list(snapshot["motions"])
        self._streams = copy.deepcopy(snapshot["streams"])
        self._filled[:] = snapshot["filled"]
        self._tail[:] = snapshot["tail"]
        self._buffer[:] = snapshot["buffer"]
        self._cursor = snapshot["cursor"]
