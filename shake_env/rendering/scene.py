"""What a picture of a running test shows, as numbers: positions, histories, errors and scales.

Fed once a control period, whether or not a picture is made, so that what a frame shows does not depend
on how often one is asked for. Drawing is `painter`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shake_env.model.parameters import FloatArray
from shake_env.model.plant import TABLE_DISPLACEMENT
from shake_env.motion.targets import FilteredNoise, Motion
from shake_env.scenario.limits import REASONS
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.engine import BoolArray, StepResult

SPAN = 4.0  # [s] of history in the strips
STRIP_RATE = 200.0  # [Hz] at most: some two points a pixel
DRIFT_CORNER = 0.3  # [Hz] slower motion of an unbounded table is not drawn
LARGEST = 1e6  # SI; what has diverged beyond is drawn there


@dataclass(frozen=True, kw_only=True)
class Scene:
    """One moment of a test; index 0 is the table and its specimen, 1 the reference on real ground."""

    time: float  # [s] since the start
    base: FloatArray  # (2,) displacement of table and ground as drawn [m]
    sway: FloatArray  # (2, stories) floors relative to their base [m]
    yielded: BoolArray  # (2, stories) whose drift has passed its yield value in this episode
    stroke: float  # [m] true position of the table
    current: float  # [A]
    ages: FloatArray  # (samples,) of the histories, oldest first [s]
    acceleration: FloatArray  # (samples, 2) achieved and target [m/s^2]
    shear: FloatArray  # (samples, 2) base shear and reference [N]
    errors: tuple[float, float]  # rms of both errors so far over their target's rms; NaN: no target yet
    scales: tuple[float, float, float, float]  # half range of base, sway [m], [m/s^2] and [N]
    broken: str | None  # limit that ended the episode


class SceneRecorder:
    """Keeps what a scene needs.

    Scales are round numbers that grow with the episode and never shrink in it. Where the scenario limits
    the stroke and knows the ground's displacement (Clough-Penzien high-pass), table and ground are drawn
    where they are. An unbounded table drifts by metres without anything feeling it; there both are drawn
    without their drift, as the same high-pass leaves them: ``x'' + 2 z w x' + w^2 x = a`` at
    `DRIFT_CORNER`, z = 0.7.

    Parameters
    ----------
    scenario
        What runs.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.stories = scenario.specimen.stories
        self.true_positions = (
            scenario.ground.states == 4 and scenario.limits.table_displacement is not None
        )
        self._stride = max(1, round(scenario.control_rate / STRIP_RATE))
        # (samples, 4): achieved and target acceleration, base shear and reference; a ring.
        samples = round(SPAN * scenario.control_rate / self._stride) + 1
        self._ring = np.zeros((samples, 4))
        self.start()

    def start(self, motion: Motion | None = None) -> None:
        """Begin an episode at rest, under the scenario's motion or another one."""
        self._steps = self._samples = 0
        self._state = np.zeros((2, 2 * self.stories))  # [x_r, x_r'] of specimen and reference
        self._base = np.zeros((2, 2))  # displacement and velocity as drawn, of table and ground
        self._stroke = self._current = 0.0
        self._yielded = np.zeros((2, self.stories), dtype=bool)
        self._sums = np.zeros((2, 2))  # squares of error and target, of acceleration and force
        self._broken: str | None = None
        self._scales = [nice_ceiling(v) for v in self._expected(motion or self.scenario.motion)]

    def _expected(self, motion: Motion) -> tuple[float, float, float, float]:
        """Return a first guess of the peaks of base, sway, acceleration and shear."""
        plant, specimen = self.scenario.plant, self.scenario.specimen
        # A record's amplitude is a factor on the record, whose peak is not known here: start low.
        factor = 1.5 if isinstance(motion, FilteredNoise) else 0.5
        peak = factor * max(motion.amplitude, 0.01) * math.sqrt(plant.target_variance)
        shear = peak * sum(specimen.masses)
        limit = self.scenario.limits.table_displacement
        base = limit if self.true_positions and limit else peak / (2.0 * math.pi) ** 2
        return base, sum(shear / k for k in specimen.stiffnesses) / 2.0, peak, shear

    def add(self, result: StepResult) -> None:
        """Take in the control period that lane 0 has just been through."""
        outcome, ground = result.outcome, result.ground
        response = outcome.response
        columns = (
            response.table_acceleration[0], ground.target[0],
            response.base_shear[0], ground.reference_shear[0],
        )  # fmt: skip
        period = np.nan_to_num(np.stack(columns, axis=-1), posinf=LARGEST, neginf=-LARGEST)
        period = np.clip(period, -LARGEST, LARGEST)  # (k, 4)
        state = np.clip(np.nan_to_num(response.state[0]), -LARGEST, LARGEST)
        self._state = np.stack([state[4 : 4 + 2 * self.stories], ground.reference[0]])
        self._stroke, self._current = float(state[TABLE_DISPLACEMENT]), float(outcome.current[0])
        if self.true_positions:
            self._base[:, 0] = self._stroke, ground.ground[0, 2]
        else:
            self._without_drift(period[:, :2])
        self._steps += 1
        if self._steps % self._stride == 0:
            self._ring[self._samples % len(self._ring)] = period[-1]
            self._samples += 1
        error = period[:, 0::2] - period[:, 1::2]
        self._sums += np.stack([np.sum(error**2, axis=0), np.sum(period[:, 1::2] ** 2, axis=0)])
        drifts = np.diff(self._state[:, : self.stories], axis=-1, prepend=0.0)
        self._yielded |= np.abs(drifts) > self.scenario.nonlinearity.yielding.yield_drift
        peaks = (
            np.abs(self._base[:, 0]).max(), np.abs(self._state[:, : self.stories]).max(),
            np.abs(period[:, :2]).max(), np.abs(period[:, 2:]).max(),
        )  # fmt: skip
        for i, peak in enumerate(peaks):
            if peak > self._scales[i]:
                self._scales[i] = nice_ceiling(float(peak))
        if outcome.broken[0]:
            self._broken = REASONS[int(outcome.broken[0]) - 1]

    def _without_drift(self, accelerations: FloatArray) -> None:
        omega, step = 2.0 * math.pi * DRIFT_CORNER, self.scenario.physics_step
        x, v = self._base[:, 0], self._base[:, 1]
        for acceleration in accelerations:
            v = v + step * (acceleration - 1.4 * omega * v - omega**2 * x)
            x = x + step * v
        self._base = np.stack([x, v], axis=-1)

    @property
    def time(self) -> float:
        """Time since the start of the episode [s]."""
        return self._steps * self.scenario.control_period

    def scene(self) -> Scene:
        """Return the present moment."""
        count = min(self._samples, len(self._ring))
        order: NDArray[np.intp] = np.arange(self._samples - count, self._samples) % len(self._ring)
        history = self._ring[order]
        steps = np.arange(self._samples - count + 1, self._samples + 1, dtype=float) * self._stride
        ages: FloatArray = self.time - steps * self.scenario.control_period
        ratios = [
            math.sqrt(error / target) if target > 0.0 else math.nan for error, target in self._sums.T
        ]
        base, sway, acceleration, shear = self._scales
        return Scene(
            time=self.time,
            base=self._base[:, 0].copy(),
            sway=self._state[:, : self.stories].copy(),
            yielded=self._yielded.copy(),
            stroke=self._stroke,
            current=self._current,
            ages=ages,
            acceleration=history[:, :2],
            shear=history[:, 2:],
            errors=(ratios[0], ratios[1]),
            scales=(base, sway, acceleration, shear),
            broken=self._broken,
        )


def nice_ceiling(value: float) -> float:
    """Return the smallest of 1, 1.5, 2, 3, 5, 7 times a power of ten that is at least `value` > 0."""
    power = 10.0 ** math.floor(math.log10(value))
    for factor in (1.0, 1.5, 2.0, 3.0, 5.0, 7.0):
        if value <= factor * power * (1.0 + 1e-9):
            return factor * power
    return 10.0 * power


def nice_floor(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is at most `value` > 0."""
    power = 10.0 ** math.floor(math.log10(value) + 1e-9)
    return max(f * power for f in (1.0, 2.0, 5.0) if f * power <= value * (1.0 + 1e-9))
