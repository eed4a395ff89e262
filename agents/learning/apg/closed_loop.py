"""The closed loop of N tables over a window in numpy, with its derivative by a reverse sweep.

Between two periods of the plant everything that the loop does is linear, apart from the clip of the
action and the rounding of readings: observation, estimator and the law on the estimate.
These are one matrix, made by running the scenario's own sensors and estimator on a basis, so that it
repeats no equation. A period is then a few products and one compiled period of the plant. The reverse
sweep is their transposes and the plant's adjoint (Griewank and Walther, Evaluating Derivatives, 2008,
ch. 3).

The policy needs no memory here. Its action is one number, so its derivative along the observation is one
row a sample, which is computed for a whole window at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agents.learning.apg.loop_signals import Signals, measures_floors
from agents.learning.apg.plant_period import Period
from agents.policies.estimated_law import EstimatedLaw
from shake_env.dynamics.ground import GroundPeriod
from shake_env.dynamics.nonlinear import apply
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import TABLE_DISPLACEMENT
from shake_env.scenario.limits import OBSERVATION_BOUND
from shake_env.simulation.sensors import SensorMemory
from shake_env.simulation.transition import TableModel

Act = Callable[[FloatArray], FloatArray]  # observations (N, n) to corrections (N,)


@dataclass(frozen=True)
class Start:
    """What N tables stand at before a window."""

    state: FloatArray  # (N, S) SI
    sensors: SensorMemory
    shown: FloatArray  # (N, n) observation, and the law's belief behind it
    law: FloatArray  # (N, M) the law's memory with the readings weighed in, or (N, 0)
    age: NDArray[np.int_]  # (N,) control periods since the start of the episodes


@dataclass(frozen=True)
class LoopTrajectory:
    """What N tables did over H control periods."""

    begun: FloatArray  # (H + 1, N, S) state that each period begins with; last, that after the window
    state: FloatArray  # (H, N, S) at each end, also of a table that has diverged
    acceleration: FloatArray  # (H, N, k)
    shear: FloatArray  # (H, N, k)
    correction: FloatArray  # (H, N) of the policy
    total: FloatArray  # (H, N) action before its clip
    shown: FloatArray  # (H + 1, N, n)
    finite: NDArray[np.bool_]  # (H, N) whether the table has not diverged
    sensors: SensorMemory  # at the end
    law: FloatArray  # (N, M) the law's memory at the end, before it weighs the last observation

    @property
    def action(self) -> FloatArray:
        """Action (H, N) within [-1, 1]."""
        return np.clip(self.total, -1.0, 1.0)


class ClosedLoop:
    """The tables of a model under a base law and a policy without memory.

    Parameters
    ----------
    model
        The plants, in numpy.
    period
        See `period_of`.
    law
        The base law behind an estimator, in numpy; None for another.
    base
        (n,) the base law as a row over what is shown; None for none.
    authority
        What correction 1 adds to the action.
    """

    def __init__(
        self,
        model: TableModel,
        period: Period,
        law: EstimatedLaw | None,
        base: FloatArray | None,
        authority: float,
    ) -> None:
        self.model, self.period, self.law = model, period, law
        self.base, self.authority = base, authority
        self.signals = Signals.from_model(model, law)
        first = model.filter_states
        scale = model.observation_scale[first : first + model.controlled]
        self._bound = OBSERVATION_BOUND * scale
        self._bound[TABLE_DISPLACEMENT] = np.inf  # it may drift
        self._floors = measures_floors(model)

    def run(self, start: Start, ground: GroundPeriod, noise: FloatArray, act: Act) -> LoopTrajectory:
        """Follow the tables.

        Parameters
        ----------
        start
            Where they stand.
        ground
            (H, N, ...) of the window.
        noise
            (H, N, s) of the sensors.
        act
            Called once a control period, in order.
        """
        model, signals = self.model, self.signals
        steps, lanes, k = ground.target.shape
        state, finite = start.state, np.ones(lanes, dtype=bool)
        columns, rows = signals.columns, signals.rows
        inputs = self._exogenous(ground)
        inputs[:, :, columns["added"]] = start.sensors.bias + noise
        shown = np.empty((steps + 1, lanes, start.shown.shape[1]))
        shown[0] = start.shown
        begun = np.empty((steps + 1, *state.shape))
        ends, alive = np.empty((steps, *state.shape)), np.empty((steps, lanes), dtype=bool)
        acceleration, shear = np.empty((steps, lanes, k)), np.empty((steps, lanes, k))
        correction, total = np.empty((steps, lanes)), np.empty((steps, lanes))
        known = law_memory = start.law
        past = start.sensors.past.reshape(lanes, -1)
        for t in range(steps):
            begun[t] = state
            correction[t] = act(shown[t])
            total[t] = self.authority * correction[t].clip(-1.0, 1.0)
            if self.base is not None:
                total[t] += shown[t] @ self.base
            action = total[t].clip(-1.0, 1.0)
            drive = None if ground.drive is None else ground.drive[t]
            ends[t], acceleration[t], shear[t] = self.period(state, model.current_limit * action, drive)
            finite = finite & (np.abs(ends[t, :, : model.controlled]) <= self._bound).all(axis=-1)
            alive[t] = finite
            state = np.where(finite[:, None], ends[t], 0.0)
            row = inputs[t]
            row[:, columns["state"]] = state[:, columns["state"]]
            row[:, columns["acceleration"]] = acceleration[t, :, -1:]
            row[:, columns["shear"]] = shear[t, :, -1:]
            if self._floors:
                row[:, columns["floors"]] = model.floors(state)
            row[:, columns["past"]] = past
            row[:, columns["action"]] = action[:, None]
            if self.law is not None:
                law_memory = self.law.keep(known, action)
                row[:, columns["law"]] = law_memory
            made = row @ signals.matrix.T
            misread = start.sensors.gain * made[:, rows["signals"]]
            misread += self._rounding(made[:, rows["signals"]] + misread + row[:, columns["added"]])
            made += misread @ signals.matrix[:, columns["added"]].T
            if self.law is not None:
                gains = self._gains(start.age + t + 1)
                made += apply(gains, made[:, rows["innovation"]]) @ signals.gained.T
                known = made[:, rows["law"]]
                shown[t + 1, :, rows["observation"].stop - rows["observation"].start :] = made[
                    :, rows["belief"]
                ]
            past = made[:, rows["past"]]
            observation = made[:, rows["observation"]]
            shown[t + 1, :, : observation.shape[1]] = observation
        begun[steps] = state
        history = past.reshape(start.sensors.past.shape)
        sensors = SensorMemory(
            start.sensors.bias, start.sensors.gain, total[-1].clip(-1.0, 1.0), history
        )
        return LoopTrajectory(
            begun, ends, acceleration, shear, correction, total, shown, alive, sensors, law_memory
        )

    def sweep(
        self,
        passage: LoopTrajectory,
        age: NDArray[np.int_],
        slopes: dict[str, FloatArray],
        along: FloatArray,
    ) -> FloatArray:
        """Return a cost's slopes (H, N) along the policy's corrections.

        Parameters
        ----------
        passage, age
            What `run` returned, and the ages that it began with.
        slopes
            Of the cost along ``state``, ``acceleration``, ``shear``, ``action`` and ``shown``, in the
            shapes of the passage.
        along
            (H, N, n) derivative of each correction along what was shown.
        """
        model, signals, law = self.model, self.signals, self.law
        columns, rows = signals.columns, signals.rows
        steps, lanes = passage.total.shape
        limit = model.current_limit
        inside = np.abs(passage.total) <= 1.0 if self.base is not None else np.ones((steps, lanes), bool)
        heard = np.abs(passage.correction) <= 1.0
        shown = slopes["shown"].copy()
        along_actions = np.empty((steps, lanes))
        state = np.zeros(passage.state.shape[1:])
        out = np.zeros((lanes, len(signals.matrix)))
        width = rows["observation"].stop - rows["observation"].start
        for t in range(steps - 1, -1, -1):
            out[:, rows["observation"]] = shown[t + 1, :, :width]
            if law is not None:
                out[:, rows["belief"]] = shown[t + 1, :, width:]
                out[:, rows["innovation"]] = 0.0
                change = out @ signals.gained
                out[:, rows["innovation"]] = apply(_transposed(self._gains(age + t + 1)), change)
            added = out @ signals.matrix[:, columns["added"]]
            out[:, rows["signals"]] = passage.sensors.gain * added
            back = out @ signals.matrix
            action = slopes["action"][t] + back[:, columns["action"]][:, 0]
            if law is not None:
                known, action_slope = _forget(law, back[:, columns["law"]])
                out[:, rows["law"]] = known
                action += action_slope
            out[:, rows["past"]] = back[:, columns["past"]]
            state[:, columns["state"]] += back[:, columns["state"]]
            if self._floors:
                assert model.floor_rows is not None
                width_floors = model.floor_rows.shape[-1]
                state[:, 4 : 4 + width_floors] += apply(
                    _transposed(model.floor_rows), back[:, columns["floors"]]
                )
            state = np.where(passage.finite[t][:, None], state, 0.0) + slopes["state"][t]
            acceleration, shear = slopes["acceleration"][t].copy(), slopes["shear"][t].copy()
            acceleration[:, -1] += back[:, columns["acceleration"]][:, 0]
            shear[:, -1] += back[:, columns["shear"]][:, 0]
            current = limit * passage.total[t].clip(-1.0, 1.0)
            state, toward = self.period.adjoint(
                passage.begun[t], current, (np.ascontiguousarray(state), acceleration, shear)
            )
            action = (action + limit * toward) * inside[t]
            along_actions[t] = self.authority * action * heard[t]
            shown[t] += along_actions[t][:, None] * along[t]
            if self.base is not None:
                shown[t] += action[:, None] * self.base
        return along_actions

    def _exogenous(self, ground: GroundPeriod) -> FloatArray:
        """Return rows (H, N, columns) of which what the ground decides is filled in."""
        columns = self.signals.columns
        steps, lanes, _ = ground.target.shape
        inputs = np.zeros((steps, lanes, self.signals.matrix.shape[1]))
        inputs[:, :, columns["ground"]] = ground.ground
        inputs[:, :, columns["reference"]] = ground.reference
        if ground.preview is not None:
            inputs[:, :, columns["preview"]] = ground.preview
        return inputs

    def _rounding(self, reading: FloatArray) -> FloatArray:
        """Return what rounding adds to readings (N, s) [SI]; it has no derivative."""
        measurement = self.model.measurement
        rounded = np.round(reading / measurement.resolution) * measurement.resolution
        error: FloatArray = measurement.rounded * (rounded - reading)
        return error

    def _gains(self, age: NDArray[np.int_]) -> FloatArray:
        """Return the estimator's gain (estimates, s), or one a table where one is young."""
        assert self.law is not None
        last = len(self.law.gains) - 1
        gains: FloatArray = self.law.gains[last if (age >= last).all() else np.minimum(age, last)]
        return gains


def _transposed(matrix: FloatArray) -> FloatArray:
    return np.swapaxes(matrix, -1, -2)


def _forget(law: EstimatedLaw, slopes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return slopes along what `EstimatedLaw.keep` took: (N, M) of the known, (N,) of the action."""
    first = law.gains.shape[1]
    last = first + law.actions
    none = np.zeros((len(slopes), 1))
    known = np.concatenate(
        [slopes[:, :first], none, slopes[:, first : last - 1], slopes[:, last:]], axis=-1
    )
    return known, slopes[:, last - 1]
