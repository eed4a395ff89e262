"""The figures by which a test is judged, summed while it runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shake_env.simulation.engine import BoolArray, IntArray, StepResult


@dataclass(frozen=True)
class EpisodeMetrics:
    """One controller on one earthquake."""

    earthquake: str
    cost: float  # mean stage cost over the motion, a broken limit's included
    acceleration_rms_error: float  # rms of y_A - y~ over rms of y~ [-]
    acceleration_peak_error: float  # peak of |y_A - y~| over peak of |y~| [-]
    base_shear_rms_error: float  # rms of f_s - f~_s over rms of f~_s [-]
    base_shear_peak_error: float  # peak of |f_s - f~_s| over peak of |f~_s| [-]
    peak_current: float  # [A]
    peak_velocity: float  # of the table [m/s]
    peak_displacement: float  # of the table [m]
    broken_limit: str | None  # what ended the episode early; errors then count what ran


class MetricAccumulator:
    """Running sums and peaks of N lanes, counted only while a lane's episode runs."""

    def __init__(self, lanes: int) -> None:
        self.squares = np.zeros((4, lanes))
        self.peaks = np.zeros((4, lanes))
        self.cost = np.zeros(lanes)
        self.extremes = np.zeros((3, lanes))  # current, velocity, displacement

    def add(self, result: StepResult, running: BoolArray) -> None:
        """Count a control period of the lanes that are `running` (N,)."""
        response, ground = result.outcome.response, result.ground
        signals = np.stack(
            [
                response.table_acceleration - ground.target,
                ground.target,
                response.base_shear - ground.reference_shear,
                ground.reference_shear,
            ]
        )
        self.squares += np.where(running, np.sum(signals**2, axis=-1), 0.0)
        peak = np.max(np.abs(signals), axis=-1)
        self.peaks = np.where(running, np.maximum(self.peaks, peak), self.peaks)
        self.cost += np.where(running, -result.reward, 0.0)
        state = response.state
        now = np.abs(np.stack([result.outcome.current, state[:, 2], state[:, 1]]))
        self.extremes = np.where(running, np.maximum(self.extremes, now), self.extremes)

    def metrics(
        self, names: Sequence[str], steps: IntArray, reasons: Sequence[str | None]
    ) -> list[EpisodeMetrics]:
        """Return each lane's figures.

        Parameters
        ----------
        names
            Of the earthquakes, one a lane.
        steps
            (N,) control periods of each motion.
        reasons
            What ended each episode early, or None.
        """
        rms, peak = np.sqrt(self.squares), self.peaks
        tiny = np.finfo(float).tiny  # a target of zero amplitude divides 0 by it, not by 0
        return [
            EpisodeMetrics(
                earthquake=name,
                cost=float(self.cost[i] / steps[i]),
                acceleration_rms_error=float(rms[0, i] / max(rms[1, i], tiny)),
                acceleration_peak_error=float(peak[0, i] / max(peak[1, i], tiny)),
                base_shear_rms_error=float(rms[2, i] / max(rms[3, i], tiny)),
                base_shear_peak_error=float(peak[2, i] / max(peak[3, i], tiny)),
                peak_current=float(self.extremes[0, i]),
                peak_velocity=float(self.extremes[1, i]),
                peak_displacement=float(self.extremes[2, i]),
                broken_limit=reasons[i],
            )
            for i, name in enumerate(names)
        ]
