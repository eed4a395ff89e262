"""What the current cannot reach: target, ground-filter state and reference specimen, period by period.

The readable form, in numpy; :mod:`shake_env.kernels.ground` is the compiled one. Each lane (table) of a
batch has a motion and a key of random numbers of its own. What a preview shows lies computed ahead.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.dynamics.ground import GroundMaps, GroundPeriod, GroundRowLayout
from shake_env.dynamics.nonlinear import apply
from shake_env.model.discretization import DiscretePlant
from shake_env.model.nonlinearity import Yielding
from shake_env.model.parameters import FloatArray
from shake_env.model.random_numbers import GROUND, normals
from shake_env.motion.targets import EpisodeMotion, FilteredNoise, RecordedMotion
from shake_env.simulation.motion_shapes import first_target, initial_filter_state, motion_shape

IntArray = NDArray[np.int64]
DRAWN = 32  # control periods whose normal numbers are made at once


def motion_array(motions: Sequence[EpisodeMotion]) -> NDArray[Any]:
    """Return motions as an array of objects, one a lane."""
    array = np.empty(len(motions), dtype=object)
    array[:] = motions
    return array


def periods_ahead(preview: tuple[int, int], substeps: int) -> int:
    """Return how many control periods beyond the present one a preview reaches.

    Parameters
    ----------
    preview
        Number of target samples shown ahead, and the physics steps between them.
    substeps
        Physics steps k a control period.
    """
    return math.ceil(preview[0] * preview[1] / substeps)


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
    finer
        Control periods of this excitation in one of that whose random numbers it follows.
    """

    def __init__(
        self,
        discrete: DiscretePlant,
        lanes: int,
        maps: GroundMaps | None = None,
        preview: tuple[int, int] = (0, 1),
        finer: int = 1,
    ) -> None:
        self._discrete, self._preview, self._finer = discrete, preview, finer
        self.ahead = periods_ahead(preview, discrete.substeps)
        self._rows = GroundRowLayout.from_plant(discrete)
        self.maps = GroundMaps.from_plant(discrete, Yielding()) if maps is None else maps
        self._exogenous = self._rows.ground + self._rows.reference
        self._draws = self.maps.noise.shape[-1] - self._exogenous
        self.motions: list[EpisodeMotion] = [FilteredNoise()] * lanes
        self._shapes: list[FloatArray | None] = [None] * lanes
        self.key = np.zeros((lanes, 2), dtype=np.int64)
        self.period = np.zeros(lanes, dtype=np.int64)  # control periods computed since each lane's start
        self._made = np.zeros((lanes, DRAWN, self._draws))  # normal numbers of coming periods
        self._made_from = np.full(lanes, -DRAWN, dtype=np.int64)  # the first of them
        self._slipping = np.zeros((lanes, 3 * discrete.layout.stories))  # of a yielding reference
        self._last_target = np.zeros(lanes)
        # The present period and those ahead of it.
        self._known = [np.zeros((lanes, self._rows.width)) for _ in range(self.ahead + 1)]

    def start(
        self,
        lanes: Sequence[int],
        motions: Sequence[EpisodeMotion],
        keys: Sequence[IntArray],
        references: Sequence[FloatArray | None] | None = None,
    ) -> GroundPeriod:
        """Begin a motion in each of `lanes`, whose first period is the next one taken.

        Parameters
        ----------
        lanes, motions
            Indices of the tables, and the motion of each.
        keys
            (2,) of the random numbers of each; see `random_numbers.episode_key`.
        references
            ``[x~_r, x~_r', s~]`` (3 stories,) of each yielding reference; None: as new.

        Returns
        -------
        The ground at time 0, one row a lane; its target and reference shear are the values at rest.
        """
        index = np.asarray(lanes, dtype=int)
        dt, ground = self._discrete.dt, self._discrete.plant.ground
        self.period[index] = self._slipping[index] = 0
        self._made_from[index] = -DRAWN
        for row in self._known:
            row[index] = 0.0
        for lane, motion, key in zip(lanes, motions, keys, strict=True):
            self.motions[lane], self.key[lane] = motion, key
            self._shapes[lane] = motion_shape(motion, self._discrete, self.ahead)
            self._last_target[lane] = first_target(motion, dt)
            self._known[0][lane, : self._rows.ground] = initial_filter_state(motion, ground, dt)
        for lane, reference in zip(lanes, references or (), strict=False):
            if reference is not None:
                self._slipping[lane] = reference
                self._known[0][lane, self._rows.ground : self._exogenous] = reference[
                    : self._rows.reference
                ]
        for i in range(self.ahead):
            self._known[i + 1][index] = self._computed(index, self._known[i][index])
        return self._taken(index)

    def advance(self) -> GroundPeriod:
        """Return the next control period of every lane, (N, ...)."""
        lanes = np.arange(len(self.period))
        self._known = [*self._known[1:], self._computed(lanes, self._known[-1])]
        return self._taken(slice(None))

    def present(self) -> GroundPeriod:
        """Return the present control period of every lane, (N, ...)."""
        return self._taken(slice(None))

    def _taken(self, lanes: Any) -> GroundPeriod:
        now, *coming = (row[lanes] for row in self._known)
        samples, spacing = self._preview
        if not samples:
            return self._rows.period(now)
        steps = np.concatenate([row[:, self._rows.target] for row in coming], axis=1)
        return self._rows.period(now, steps[:, spacing - 1 :: spacing][:, :samples])

    def _computed(self, lanes: NDArray[np.intp], before: FloatArray) -> FloatArray:
        """Return one more period (lanes, width) of some lanes, behind that `before`."""
        row = np.empty_like(before)
        kinds = np.array([isinstance(self.motions[lane], RecordedMotion) for lane in lanes], dtype=bool)
        for which, compute in ((kinds, self._recorded), (~kinds, self._noise)):
            if which.any():
                row[which] = compute(lanes[which], before[which, : self._exogenous])
        if self.maps.yielding is not None:
            self._put_yielding(lanes, row)
        self.period[lanes] += 1
        return row

    def _noise(self, lanes: NDArray[np.intp], exogenous: FloatArray) -> FloatArray:
        """Return a period of filtered noise."""
        drawn = self._drawn(lanes)
        for n, lane in enumerate(lanes):
            if (intensity := self._shapes[lane]) is not None:
                drawn[n] *= intensity[min(self.period[lane], len(intensity) - 1), :, None]
            drawn[n] *= self.motions[lane].amplitude
        joined = np.concatenate([exogenous, drawn.reshape(len(lanes), -1)], axis=1)
        row: FloatArray = apply(self.maps.pick(lanes).noise, joined)
        return row

    def _drawn(self, lanes: NDArray[np.intp]) -> FloatArray:
        """Return the normal numbers (lanes, k, directions) of the next period of some lanes.

        They are made for several periods at once, which takes hardly longer than for one.
        """
        period, k = self.period, self._discrete.substeps
        place = period[lanes] - self._made_from[lanes]
        anew = lanes[(place < 0) | (place >= DRAWN)]
        if len(anew):
            self._made_from[anew] = period[anew]
            coarse = (period[anew][:, None] + np.arange(DRAWN)) // self._finer
            count = self._draws * self._finer
            numbers = normals(self.key[anew][:, None], coarse, GROUND, count)
            parts = (period[anew][:, None] + np.arange(DRAWN)) % self._finer
            numbers = numbers.reshape(len(anew), DRAWN, self._finer, self._draws)
            self._made[anew] = np.take_along_axis(numbers, parts[:, :, None, None], axis=2)[:, :, 0]
        drawn: FloatArray = self._made[lanes, period[lanes] - self._made_from[lanes]]
        shaped: FloatArray = drawn.reshape(len(lanes), k, -1)
        return shaped

    def _recorded(self, lanes: NDArray[np.intp], exogenous: FloatArray) -> FloatArray:
        """Return a period of recorded motions."""
        rows, k = self._rows, self._discrete.substeps
        histories = []
        for lane in lanes:
            history = self._shapes[lane]
            assert history is not None  # a record has one
            histories.append(history[min(self.period[lane], len(history) - 1)])
        samples = np.stack(histories)
        target = samples[:, -(k + 1) :]
        moved = apply(
            self.maps.pick(lanes).record, np.concatenate([exogenous[:, rows.ground :], target], axis=1)
        )
        parts = [samples[:, : rows.ground], moved[:, : rows.reference], target[:, 1:]]
        return np.concatenate([*parts, moved[:, rows.reference :]], axis=1)

    def _put_yielding(self, lanes: NDArray[np.intp], row: FloatArray) -> None:
        """Put the yielding reference in the place of the linear one."""
        assert self.maps.yielding is not None  # the caller asked
        rows, k = self._rows, self._discrete.substeps
        reference = slice(rows.ground, self._exogenous)
        target = np.concatenate([self._last_target[None, lanes], row[:, rows.target].T])
        final, states, shear = self.maps.yielding.pick(lanes).run(self._slipping[lanes], target)
        self._slipping[lanes], self._last_target[lanes] = final, target[-1]
        row[:, reference] = states[-1, :, : rows.reference]
        row[:, rows.target.stop : rows.target.stop + k] = shear.T

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Return everything that `set_state` needs to go on exactly, arrays with a row a lane."""
        return {
            "motion": motion_array(self.motions),
            "key": self.key.copy(),
            "period": self.period.copy(),
            "slipping": self._slipping.copy(),
            "last_target": self._last_target.copy(),
            "known": np.stack(self._known, axis=1),
        }

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Go on from the state of an excitation of the same plant and number of lanes."""
        self.motions = state["motion"].tolist()
        self._shapes = [motion_shape(motion, self._discrete, self.ahead) for motion in self.motions]
        for name in ("key", "period", "slipping", "last_target"):
            getattr(self, name if name in ("key", "period") else f"_{name}")[...] = state[name]
        self._known = list(state["known"].swapaxes(0, 1).copy())
        self._made_from[:] = -DRAWN
