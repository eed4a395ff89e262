"""A whole record planned before the test: the optimal currents, and feedback along them during the test.

The plan is the optimum of the nominal table with the record known (:mod:`baselines.planning.bound`).
During the test the currents are corrected by ``K_t (x - x_t)``, x the estimate of the extended Kalman
filter and K_t the feedback of the plan's last iteration: what is optimal to first order after a small
disturbance (neighbouring extremals: Bryson and Ho, Applied Optimal Control, 1975, ch. 6). What the plan
knows is the record itself, which a laboratory has before the test; it knows nothing of the true table.
"""

from __future__ import annotations

import io
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.planning.bound import THREADS, OptimalEpisode, optimal_episodes
from baselines.planning.ekf import ExtendedKalmanFilter, TableEstimate, model_error
from shake_env.dynamics.low_pass import first_low_pass
from shake_env.dynamics.yielding_reference import YieldingReference
from shake_env.errors import FileError, ParameterError
from shake_env.files import write_bytes
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import TABLE_DISPLACEMENT
from shake_env.motion.targets import FilteredNoise
from shake_env.rollout import Earthquake
from shake_env.scenario.digest import scenario_digest
from shake_env.scenario.observation import Sensing
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uncertainty

TOLERANCE = 0.01  # [m] see `plan_records`
ARRAYS = ("current", "state", "response", "gain", "target", "shear")


@dataclass(frozen=True)
class RecordPlan:
    """The plan of one earthquake on the nominal table."""

    name: str  # of the earthquake
    digest: str  # see `table_digest`
    cost: float  # mean stage cost on the nominal table
    current: FloatArray  # (T) [A]
    state: FloatArray  # (T + 1, n) SI, the commands under way last
    response: FloatArray  # (T, 2 k) y_A [m/s^2] after each physics step, then f_s [N]
    gain: FloatArray  # (T, n) feedback on the scaled state [A]
    target: FloatArray  # (T, k) [m/s^2]
    shear: FloatArray  # (T, k) of the nominal reference specimen [N]

    def write(self, file: str | PathLike[str]) -> None:
        """Write the plan as numpy's .npz, whole or not at all.

        Raises
        ------
        FileError
            If the file cannot be written.
        """
        arrays = {name: getattr(self, name) for name in ARRAYS}
        held = io.BytesIO()
        np.savez_compressed(held, name=self.name, digest=self.digest, cost=self.cost, **arrays)
        write_bytes(Path(file), held.getvalue())

    @classmethod
    def read(cls, file: str | PathLike[str]) -> RecordPlan:
        """Read what `write` wrote.

        Raises
        ------
        FileError
            If there is no such file, it is none of these, or it is not whole.
        """
        try:
            content = io.BytesIO(Path(file).read_bytes())
            with np.load(content, allow_pickle=False) as held:
                if not isinstance(held, np.lib.npyio.NpzFile):
                    raise ValueError("one array")
                arrays = {name: np.asarray(held[name], dtype=float) for name in ARRAYS}
                name, digest = str(held["name"]), str(held["digest"])
                plan = cls(name, digest, float(held["cost"]), **arrays)
        # What numpy and zipfile raise for damaged files: of the archive, its members and their headers.
        except (
            *(OSError, KeyError, ValueError, TypeError, EOFError, RuntimeError, MemoryError),
            *(zipfile.BadZipFile, zlib.error, struct.error, SyntaxError, tokenize.TokenError),
        ) as error:
            what = f"the key {error} is missing" if isinstance(error, KeyError) else error
            remedy = f"is no file of shake plan ({what}): write it anew by shake plan"
            raise FileError("plan", str(file), remedy) from error
        if fault := plan._fault():
            raise FileError("plan", str(file), f"{fault}: write it anew by shake plan")
        return plan

    def _fault(self) -> str:
        """Return why the arrays are no plan; empty: they are one."""
        if any(getattr(self, name).ndim != (1 if name == "current" else 2) for name in ARRAYS):
            return "holds arrays of other dimensions than a plan"
        T, n, k = len(self.current), self.state.shape[1], self.target.shape[1]
        shapes = {"state": (T + 1, n), "response": (T, 2 * k), "gain": (T, n), "target": (T, k)}
        shapes["shear"] = (T, k)
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape or not T:
                return f"{name} has shape {getattr(self, name).shape}, not {shape}"
        if not all(np.isfinite(getattr(self, name)).all() for name in ARRAYS):
            return "holds values that are no finite numbers"
        return ""


def table_digest(scenario: Scenario) -> str:
    """Return the digest of the nominal table that a plan is made for.

    Table, specimen, limits, objective, delay and rates are in it. What the scenario shows, its preview
    and its motions are not: a plan is of currents and states, and the filter that estimates these is
    made of the sensors of the scenario that the plan is played in.
    """
    own = nominal_scenario(scenario)
    return scenario_digest(replace(own, sensing=Sensing(), motion=FilteredNoise()))


def nominal_scenario(scenario: Scenario) -> Scenario:
    """Return the scenario with its own values for the plant, nothing drawn."""
    return replace(scenario, uncertainty=Uncertainty())


def plan_records(
    scenario: Scenario,
    earthquakes: Sequence[Earthquake],
    on_step: Any = lambda share: None,
    displacement_tolerance: float | None = TOLERANCE,
) -> list[RecordPlan]:
    """Plan each earthquake on the nominal table.

    The target is the earthquake's; what a specimen that differs from the nominal one would have done
    is not known: the reference shear is that of the nominal specimen.

    The objective has no displacement weight, so that its feedback would let the table drift away from
    the plan. The feedback has one: a deviation of `displacement_tolerance` [m] costs as much as an
    uncontrolled table; None: no weight. The plan itself does not depend on it.
    """
    own = nominal_scenario(scenario)
    plans = []
    optima: list[OptimalEpisode] = optimal_episodes(
        scenario, earthquakes, plant=own, signals=nominal_reference, threads=THREADS, on_step=on_step
    )
    for quake, optimum in zip(earthquakes, optima, strict=True):
        if not math.isfinite(optimum.cost):
            raise ParameterError("earthquake", quake.name, "no plan keeps the limits: scale it down")
        episode = optimum.episode
        plans.append(
            RecordPlan(
                quake.name,
                table_digest(scenario),
                optimum.cost,
                optimum.current,
                optimum.state,
                optimum.response,
                _feedback(optimum, displacement_tolerance),
                episode.target,
                episode.shear,
            )
        )
    return plans


def _feedback(optimum: OptimalEpisode, tolerance: float | None) -> FloatArray:
    """Return the feedback (T, n) along a plan that also holds its displacement."""
    if tolerance is None:
        return optimum.gain
    episode = optimum.episode
    plan = episode.model.improve(
        optimum.current[None],
        optimum.state[None, 0],
        episode.target[None],
        episode.shear[None],
        place=optimum.state[None, 1:, TABLE_DISPLACEMENT],
        place_weight=1.0 / tolerance**2,
        iterations=1,
    )
    gain: FloatArray = plan.gain[0]
    return gain


def nominal_reference(scenario: Scenario, target: FloatArray) -> FloatArray:
    """Return f~_s (T, k) [N] of the nominal specimen under a target (T, k) that begins at rest."""
    reference = YieldingReference.from_plant(
        scenario.plant, scenario.nonlinearity.yielding, scenario.physics_step
    )
    start = np.zeros((1, 3 * scenario.specimen.stories))
    samples = np.concatenate([[0.0], target.ravel()])[:, None]
    shear: FloatArray = reference.run(start, samples)[2][:, 0].reshape(target.shape)
    return shear


@dataclass(frozen=True)
class PlanPlace:
    """Where N tables are in their plans, and what is known of them."""

    period: NDArray[np.intp]  # (N,) of the coming command
    current: FloatArray  # (N,) last command [A]
    estimate: TableEstimate
    row: NDArray[np.intp]  # (N,) which of the plans each table plays


class PlannedControl:
    """Plays plans with feedback along them: a `Controller`, one plan a lane.

    Parameters
    ----------
    scenario
        What is shown; its nominal plant is the filter's model.
    plans
        One a lane, or one for all; a `PlanPlace` with other rows lets lanes play any of them.
    model_error_scale
        [-] factor on the disturbances that the filter expects, see `model_error`.
    """

    def __init__(
        self, scenario: Scenario, plans: Sequence[RecordPlan], model_error_scale: float = 0.1
    ) -> None:
        digest = table_digest(scenario)
        for plan in plans:
            if plan.digest != digest:
                remedy = (
                    "was made for another table, specimen, objective or other limits or rates: "
                    "plan it anew with shake plan, in this scenario"
                )
                raise ParameterError("plan", plan.name, remedy)
        self._scenario, self._shown = scenario, scenario.observation
        self.filter = ExtendedKalmanFilter.from_scenario(
            nominal_scenario(scenario), model_error(scenario, model_error_scale)
        )
        model = self.filter.model
        # Where a plan's states, which hold no disturbances and low-passes, lie in the filter's.
        low_passes = first_low_pass(scenario.plant, scenario.parts) + np.arange(
            len(scenario.observation.low_passes)
        )
        disturbances = np.arange(model.order - model.disturbances, model.order)
        self._places = np.setdiff1d(np.arange(model.states), np.r_[low_passes, disturbances])
        self._length = np.array([len(plan.current) for plan in plans])
        longest = int(self._length.max())
        n = len(self._places)
        self._current = np.zeros((len(plans), longest))
        self._state, self._gain = np.zeros((2, len(plans), longest, n))
        self._signals = np.zeros((len(plans), longest, 2))  # y_A, f_s at each period's end
        for row, plan in enumerate(plans):
            T = len(plan.current)
            self._current[row, :T] = plan.current
            self._state[row, :T] = plan.state[:T] / model.scale[self._places]
            self._gain[row, :T] = plan.gain
            k = plan.target.shape[1]
            self._signals[row, :T] = plan.response[:, [k - 1, 2 * k - 1]]

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the action (..., 1) for an observation (..., n), and ``(PlanPlace,)``."""
        lead = observation.shape[:-1]
        shown = np.asarray(observation, dtype=float).reshape(-1, observation.shape[-1])
        lanes, limit = len(shown), self._scenario.current_limit
        fresh = np.ones(lanes, dtype=bool)
        if state is None:
            rows, begin = self.rows(lanes), np.zeros(lanes, dtype=int)
            last = PlanPlace(begin, np.zeros(lanes), self.filter.rest(lanes), rows)
        else:
            last = state[0]
            rows = last.row
            none = np.zeros(lanes, dtype=bool)
            fresh = none if episode_start is None else np.reshape(episode_start, lanes).astype(bool)
        sensing, layout = self._scenario.sensing, self._scenario.plant.layout
        given = last.current
        if sensing.last_action:
            given = shown[:, self._shown.last_action.start] * limit
        readings = shown[:, layout.controlled if sensing.full_state else self._shown.readings]
        estimate = self.filter.advance(last.estimate, np.where(fresh, 0.0, given), readings, fresh)
        period = np.where(fresh, 0, last.period)
        at = np.minimum(period, self._length[rows] - 1)
        z = estimate.state[:, self._places] / self.filter.model.scale[self._places]
        away = z - self._state[rows, at]
        current = self._current[rows, at] + np.einsum("ni,ni->n", self._gain[rows, at], away)
        current = np.where(period < self._length[rows], np.clip(current, -limit, limit), 0.0)
        action = (current / limit).astype(np.float32).reshape(*lead, 1)
        return action, (PlanPlace(period + 1, current, estimate, rows),)

    def rows(self, lanes: int) -> NDArray[np.intp]:
        """Return which plan each of N tables plays: its own, or the only one.

        Raises
        ------
        ParameterError
            If there is another number of plans.
        """
        if len(self._current) not in (1, lanes):
            raise ParameterError("lanes", lanes, f"there are plans for {len(self._current)}")
        return np.zeros(lanes, dtype=int) if len(self._current) == 1 else np.arange(lanes)

    def expected(
        self, place: PlanPlace, ahead: Sequence[int]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what the plans say of some periods; see `NonlinearPredictiveControl.expected`.

        The current of period 0 is the command that `predict` returned, feedback included; the rest is
        the plan itself, and zeros behind its end.
        """
        at = place.period[:, None] - 1 + np.asarray(ahead, dtype=int)
        rows, length = place.row[:, None], self._length[place.row][:, None]
        inside, at = at < length, np.minimum(at, length - 1)
        current = np.where(inside, self._current[rows, at], 0.0)
        signals = np.where(inside[..., None], self._signals[rows, at], 0.0)
        current[:, np.asarray(ahead) == 0] = place.current[:, None]
        return current, signals[..., 0], signals[..., 1]
