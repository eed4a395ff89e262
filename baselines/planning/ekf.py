"""Extended Kalman filter: state of a nonlinear table, disturbances and offsets from its signals.

The model is the exact nonlinear period with the loop delay. Beside the state, which the sensors'
low-passes are part of, it estimates a force on the table and a flow through the valve that the model
leaves out, and the sensors' offsets. Sizes of noise and disturbances are those of
`baselines.estimation.estimator_model`: on a linear table the two filters are one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from baselines.estimation.estimator_model import DISTURBANCES, ROUNDING, EstimatorModel, ModelError
from baselines.planning.model import PlanningModel, compiled
from shake_env.dynamics.low_pass import first_low_pass
from shake_env.dynamics.nonlinear import floor_rows
from shake_env.model.parameters import FloatArray
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.sensors import Measurement

FRICTION_SHARE = 0.05  # [-] of the friction that a filter with friction in its model takes for unknown


def model_error(scenario: Scenario, model_error_scale: float = 1.0) -> ModelError:
    """Return what the filter's nonlinear model leaves out: `ModelError` without what is in the model.

    `model_error_scale` multiplies both disturbances. Of the friction, `FRICTION_SHARE` stays unknown.
    """
    whole = ModelError.from_scenario(scenario)
    friction = scenario.nonlinearity.friction
    force = max(friction.coulomb, friction.static or 0.0)
    other = np.sqrt(max(whole.force**2 - force**2, 0.0))
    size = float(np.hypot(other, FRICTION_SHARE * force))
    return ModelError(
        force=model_error_scale * size,
        flow=model_error_scale * whole.flow,
        force_time=whole.force_time,
        flow_time=whole.flow_time,
        bias_time=whole.bias_time,
    )


@dataclass(frozen=True)
class TableEstimate:
    """What the filter knows of N tables."""

    state: FloatArray  # (N, n) SI, the commands under way last
    rest: FloatArray  # (N, a - m) offsets, over the readings' scale
    covariance: FloatArray  # (N, a, a) of the m scaled states and `rest`
    innovation: FloatArray  # (N, s) of the last readings over their standard deviations

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """The estimate as plain arrays."""
        return self.state, self.rest, self.covariance, self.innovation


@dataclass(frozen=True)
class ExtendedKalmanFilter:
    """The filter of a scenario's sensors."""

    model: PlanningModel
    sensors: tuple[Any, ...]  # see filter_kernel.SensorArrays
    Q: FloatArray  # (a, a) what a period adds to the covariance
    start: FloatArray  # (a, a) covariance at an episode's start
    keep: FloatArray  # (a - m) share of an offset that stays over a period
    parameters: tuple[FloatArray, FloatArray, FloatArray]  # see filter_kernel.ParameterArrays

    @classmethod
    def from_scenario(cls, scenario: Scenario, error: ModelError | None = None) -> ExtendedKalmanFilter:
        """Return the filter of a scenario; one that shows the full state reads every state of it.

        Parameters
        ----------
        scenario
            Its nominal plant, nonlinear parts, delay and sensors.
        error
            What the model leaves out; None: `model_error`.
        """
        error = model_error(scenario) if error is None else error
        model, linear = PlanningModel.of(scenario, error), EstimatorModel.from_scenario(scenario, error)
        shown, f = 4 + 2 * scenario.specimen.stories, len(scenario.observation.low_passes)
        sensors = _sensors(scenario, model)
        m, first = model.order, first_low_pass(scenario.plant, scenario.parts)
        # Where the linear model's states lie in this one, which has slips and the spool's velocity too.
        behind = m + np.arange(linear.order - shown - DISTURBANCES - f)
        places = np.r_[:shown, m - DISTURBANCES : m, first : first + f, behind]
        Q, start = np.zeros((2, m + len(behind), m + len(behind)))
        Q[np.ix_(places, places)], start[np.ix_(places, places)] = linear.Q, linear.start
        keep = np.diag(linear.A)[linear.order - len(behind) :].copy()
        return cls(model, sensors, Q, start, keep, (np.zeros(0), np.zeros(0), np.zeros(0)))

    def with_parameters(
        self, step: FloatArray, low: FloatArray, high: FloatArray, spread: FloatArray, walk: FloatArray
    ) -> ExtendedKalmanFilter:
        """Return the filter that estimates p parameters as well, the last entries of `rest`.

        Parameters
        ----------
        step
            (p,) between the models that slopes along the parameters are taken from.
        low, high
            (p,) ends between which an estimate is kept.
        spread, walk
            (p,) standard deviation at the start, and of what a period adds.
        """
        p = len(step)
        return replace(
            self,
            Q=block_diag(self.Q, np.diag(walk**2)),
            start=block_diag(self.start, np.diag(spread**2)),
            keep=np.append(self.keep, np.ones(p)),
            parameters=(step, low, high),
        )

    def rest(self, lanes: int) -> TableEstimate:
        """Return the estimate of N tables at rest, before any reading."""
        size, m = len(self.Q), self.model.order
        return TableEstimate(
            np.zeros((lanes, self.model.states)),
            np.zeros((lanes, size - m)),
            np.repeat(self.start[None], lanes, axis=0),
            np.zeros((lanes, len(self.sensors[0]))),
        )

    def advance(
        self,
        last: TableEstimate,
        current: FloatArray,
        readings: FloatArray,
        fresh: NDArray[np.bool_],
        models: tuple[Any, ...] | None = None,
        anchor: FloatArray | None = None,
    ) -> TableEstimate:
        """Return the estimate a period after `last`, the new readings included.

        Parameters
        ----------
        current
            (N,) command of the period between [A].
        readings
            (N, s) over their scale, as an observation holds them.
        fresh
            (N,) True where the readings are those of an episode's start: the table is at rest.
        models, anchor
            With p parameters as states: matrices of N (2 p + 1) tables, the model of each and those a
            step up and down in each parameter, and the (N, p) parameters of the first; else None.
        """
        x, rest, P, innovation = (np.array(part) for part in last.arrays)
        compiled("filter_kernel").filter_tables(
            x, rest, P, np.ascontiguousarray(fresh, dtype=np.int64),
            np.ascontiguousarray(current, dtype=float), np.ascontiguousarray(readings, dtype=float),
            self.model.arrays if models is None else models,
            np.zeros((len(x), 0)) if anchor is None else anchor,
            self.parameters, self.model.scale, self.sensors, self.Q, self.start, self.keep, innovation,
        )  # fmt: skip
        return TableEstimate(x, rest, P, innovation)


def _sensors(scenario: Scenario, model: PlanningModel) -> tuple[Any, ...]:
    """Return the sensors as `filter_kernel.SensorArrays`."""
    n, m = model.states, model.order
    if scenario.sensing.full_state:
        s = 4 + 2 * scenario.specimen.stories
        none = np.full(s, -1)
        rounding = np.full(s, ROUNDING**2)
        return np.eye(s, n), np.zeros((s, 2)), none, rounding
    layout = scenario.observation
    measurement = Measurement.from_scenario(scenario)
    s, scale = layout.readings_count, measurement.scale
    rows, outputs = np.zeros((s, n)), np.zeros((s, 2))
    floors = floor_rows(scenario.plant, scenario.nonlinearity.yielding)
    for r, (name, place) in enumerate(
        zip(layout.reading_names, measurement.places.tolist(), strict=True)
    ):
        if place >= 0:
            rows[r, place] = model.scale[place] / scale[r]
        elif name in ("table_acceleration", "base_shear"):
            outputs[r, int(name == "base_shear")] = 1.0 / scale[r]
        else:
            floor = floors[int(name.rsplit("_", 1)[1]) - 1]
            rows[r, 4 : 4 + len(floor)] = floor * model.scale[4 : 4 + len(floor)] / scale[r]
    noise = layout.sensor_values("noise") ** 2 + layout.sensor_values("resolution") ** 2 / 12.0
    offset, biased = layout.sensor_values("bias") > 0.0, np.full(s, -1)
    biased[offset] = m + np.arange(offset.sum())
    return rows, outputs, biased, noise / scale**2 + ROUNDING**2
