"""What a report shows beside curves over time: errors by frequency, the trade-off, what was drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import csd

from baselines.lqr.sampled import sampled_lqr
from shake_env.errors import NumericalError
from shake_env.model.parameters import ModelEquations
from shake_env.rollout import Earthquake
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.streams import earthquake_stream
from shake_env.simulation.trajectory import Trajectory

FloatArray = NDArray[np.float64]

SEGMENT = 4.0  # [s] of a window of the spectral estimate
BANDS: FloatArray = np.geomspace(0.4, 50.0, 46)  # [Hz] ends of the bands that estimates are summed over
FRONTIER: FloatArray = np.geomspace(1e-3, 1e3, 25)  # weights of base shear over acceleration


class TransferEstimate:
    """Transfer functions from the target acceleration to both errors, from records.

    ``H = S_xe / S_xx`` by Welch's method, each density summed over all tests and over each of `BANDS`
    before they are divided: the least-squares estimate, biased by nothing that is uncorrelated with the
    target (Bendat and Piersol, Random Data, 2010, ch. 6). Where the table is not linear it is its best
    linear approximation under these motions.
    """

    def __init__(self, step: float) -> None:
        self._step = step
        self._sums = np.zeros((3, len(BANDS) - 1), dtype=complex)

    def add(self, trajectory: Trajectory) -> None:
        """Count a test, unless it ended before the first window did."""
        length = round(SEGMENT / self._step)
        target = trajectory.target_acceleration
        if len(target) < length:
            return
        errors = (
            target,
            trajectory.table_acceleration - target,
            trajectory.base_shear - trajectory.reference_base_shear,
        )
        segments = 2 * len(target) // length - 1
        for total, error in zip(self._sums, errors, strict=True):
            frequency, density = csd(
                target, error, 1.0 / self._step, nperseg=length, detrend=False, scaling="density"
            )
            place = np.digitize(frequency, BANDS) - 1
            inside = (place >= 0) & (place < len(BANDS) - 1)
            np.add.at(total, place[inside], segments * density[inside])

    @property
    def known(self) -> bool:
        """Whether a test was long enough."""
        return bool(np.any(self._sums[0] != 0.0))

    def response(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return frequencies [Hz], |H| to acceleration error [-] and to base shear error [N s^2/m].

        Bands that hold no line of the estimate are left out.
        """
        power = self._sums[0].real
        held = power > 0.0
        centres = np.sqrt(BANDS[1:] * BANDS[:-1])
        acceleration, shear = np.abs(self._sums[1:, held]) / power[held]
        return centres[held], acceleration, shear


@dataclass(frozen=True)
class SampledParameters:
    """What the uncertainty drew for each earthquake."""

    parameters: dict[str, FloatArray]  # (earthquakes,) SI, by name

    @classmethod
    def from_scenario(cls, scenario: Scenario, earthquakes: Sequence[Earthquake]) -> SampledParameters:
        """Repeat the draws of `Simulation.start`: the motion first, then the plant."""
        rows = []
        for quake in earthquakes:
            stream = earthquake_stream(quake.seed)
            quake.motion.pick(stream)
            rows.append(scenario.uncertainty.sample(stream, scenario.specimen.stories))
        names = rows[0].keys() if rows else ()
        return cls({name: np.array([row[name] for row in rows]) for name in names})


def lqr_frontier(scenario: Scenario) -> list[tuple[float, float]]:
    """Return (acceleration, base shear) rms errors of LQRs from one weight to the other.

    Stationary and exact, relative to the target's rms: no law on the full state without preview lies
    below it. Empty where the scenario is not that linear task.
    """
    linear = (
        scenario.sensing.full_state
        and not scenario.sensing.preview
        and not scenario.nonlinearity.active
        and not scenario.delay
        and not scenario.uncertainty.active
        and scenario.equations == ModelEquations()
        and scenario.objective.normalised
    )
    points = []
    for ratio in FRONTIER if linear else ():
        weights = replace(
            scenario.objective,
            acceleration_weight=1.0 / np.sqrt(ratio),
            force_weight=float(np.sqrt(ratio)),
        )
        try:
            performance = sampled_lqr(
                scenario.discrete, weights.coefficients(scenario.plant)
            ).performance
        except NumericalError:
            continue  # a corner of the curve without a safe solution is left out
        points.append((performance.acceleration_rms_ratio, performance.base_shear_rms_ratio))
    return points
