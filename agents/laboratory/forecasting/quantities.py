"""What is forecast of a test, summed while a batch runs: one lane a sample of the posterior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agents.evaluation.fidelity import spectrum
from shake_env.kernels.layout import REPORT
from shake_env.model.parameters import FloatArray
from shake_env.scenario.limits import Limits
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.engine import BoolArray, StepResult

ORDINATES = (0.1, 0.2, 0.5, 1.0)  # [s] periods of the response-spectrum ordinates
UNITS = {
    "base_shear_error": "-",
    "acceleration_error": "-",
    "peak_base_shear": "N",
    "peak_drift": "m",
    "drift_ratio": "-",
    "energy": "J",
    "energy_ratio": "-",
    "peak_displacement": "m",
    "peak_velocity": "m/s",
    "peak_pressure": "Pa",
    "peak_acceleration": "m/s^2",
    "peak_current": "A",
    **{f"spectrum_{period:g}": "m/s^2" for period in ORDINATES},
}
CURRENT = REPORT.index("current")
LIMITED = {
    "peak_displacement": "table_displacement",
    "peak_velocity": "table_velocity",
    "peak_pressure": "load_pressure",
    "peak_acceleration": "table_acceleration",
    "peak_current": "current",
}  # quantity, and the field of `Limits` that bounds it


@dataclass(frozen=True)
class Outcomes:
    """What N tests of one controller at one amplitude came to."""

    values: dict[str, FloatArray]  # (N,) of each quantity of `UNITS`
    measured: dict[str, FloatArray]  # (N,) rms, and peak, of each channel's readings
    broken: BoolArray  # (N,) a limit was reached
    time: FloatArray  # (points,) [s]
    base_shear: FloatArray  # (N, points) [N]
    reference: FloatArray  # (N, points) [N]
    drift: FloatArray  # (N, points) of the first storey [m]

    @classmethod
    def joined(cls, parts: Sequence[Outcomes]) -> Outcomes:
        """Return the outcomes of several batches of the same test as one."""
        first = parts[0]
        return cls(
            values={k: np.concatenate([p.values[k] for p in parts]) for k in first.values},
            measured={k: np.concatenate([p.measured[k] for p in parts]) for k in first.measured},
            broken=np.concatenate([p.broken for p in parts]),
            time=first.time,
            base_shear=np.concatenate([p.base_shear for p in parts]),
            reference=np.concatenate([p.reference for p in parts]),
            drift=np.concatenate([p.drift for p in parts]),
        )


class OutcomeRecorder:
    """Sums what is forecast; handed to `rollout` as its `log`.

    Parameters
    ----------
    scenario
        What is driven.
    lanes
        Number of tables N.
    plant
        What is simulated in its place with the same sensors; None: the scenario itself.
    drifts
        (2, N) of specimens and references in the first storey at the start [m], which earlier shakes
        left (`Simulation.first_drifts`); None: zeros.
    """

    def __init__(
        self,
        scenario: Scenario,
        lanes: int,
        plant: Scenario | None = None,
        drifts: FloatArray | None = None,
    ) -> None:
        self.scenario, self._lanes = scenario, lanes
        shown = scenario if plant is None else plant
        self._full = scenario.sensing.full_state
        self._readings = scenario.observation.readings
        self._scale = shown.observation.reading_scale
        self._squares, self._peaks = np.zeros((4, lanes)), np.zeros((9, lanes))
        s = len(self._scale)
        self._read_squares, self._read_peaks = np.zeros((lanes, s)), np.zeros((lanes, s))
        self._energy, self._last = np.zeros((2, lanes)), np.zeros((4, lanes))
        if drifts is not None:
            self._last[2:] = drifts
        self._periods = np.zeros(lanes)
        self._rows: list[NDArray[np.float32]] = []
        self.broken = np.zeros(lanes, dtype=bool)

    def add(self, result: StepResult, running: BoolArray) -> None:
        """Add a control period of the lanes that are `running` (N,)."""
        response, ground = result.outcome.response, result.ground
        # Samples of a period first, so that sums and peaks run along whole rows of tables.
        shear, reference, acceleration, target = (
            np.ascontiguousarray(signal.T)
            for signal in (
                response.base_shear, ground.reference_shear, response.table_acceleration, ground.target
            )
        )  # fmt: skip
        signals = np.stack([shear - reference, reference, acceleration - target, target])
        squares = np.einsum("skn,skn->sn", signals, signals)
        state = response.state.T
        now = np.stack([shear[-1], reference[-1], state[4], ground.reference[:, 0]])
        sizes = np.empty((9, len(running)))
        np.abs(shear).max(axis=0, out=sizes[0])
        np.abs(reference).max(axis=0, out=sizes[1])
        np.abs(now[2:], out=sizes[2:4])
        np.abs(state[[1, 2, 0]], out=sizes[4:7])
        np.abs(acceleration).max(axis=0, out=sizes[7])
        np.abs(result.report[CURRENT], out=sizes[8])
        work = 0.5 * (now[:2] + self._last[:2]) * (now[2:] - self._last[2:])
        held = np.empty((4, len(running)), dtype=np.float32)
        held[:3], held[3] = now[:3], acceleration.mean(axis=0)
        readings = None
        if not self._full:
            readings = result.observation[:, self._readings] * self._scale
        if not running.all():  # a table whose test is over adds nothing
            squares, sizes, work, held = (
                np.where(running, each, each.dtype.type(0)) for each in (squares, sizes, work, held)
            )
            now = np.where(running, now, self._last)
            readings = None if readings is None else np.where(running[:, None], readings, 0.0)
        self._squares += squares
        np.maximum(self._peaks, sizes, out=self._peaks)
        self._energy += work
        self._last = now
        if readings is not None:
            self._read_squares += readings**2
            np.maximum(self._read_peaks, np.abs(readings), out=self._read_peaks)
        self._periods += running
        if result.ended:
            self.broken |= running & result.terminated
        self._rows.append(held)

    @property
    def energy(self) -> FloatArray:
        """Dissipated in the first storey of specimens and references so far (2, N) [J]."""
        return self._energy.copy()

    def outcomes(self, points: int = 1500) -> Outcomes:
        """Return what the tests came to; histories have about `points` samples."""
        rows = np.stack(self._rows, axis=-1)  # (4, N, periods)
        period = self.scenario.control_period
        error, peaks = np.sqrt(self._squares), self._peaks
        tiny = np.finfo(float).tiny
        values = {
            "base_shear_error": error[0] / np.maximum(error[1], tiny),
            "acceleration_error": error[2] / np.maximum(error[3], tiny),
            "peak_base_shear": peaks[0],
            "peak_drift": peaks[2],
            "drift_ratio": peaks[2] / np.maximum(peaks[3], tiny),
            "energy": self._energy[0],
            "energy_ratio": self._energy[0] / np.maximum(self._energy[1], tiny),
            "peak_displacement": peaks[4],
            "peak_velocity": peaks[5],
            "peak_pressure": peaks[6],
            "peak_acceleration": peaks[7],
            "peak_current": peaks[8],
        }
        ordinates = np.array(ORDINATES)
        spectra = np.stack([spectrum(row.astype(float), period, ordinates) for row in rows[3]])
        values |= {f"spectrum_{t:g}": spectra[:, i] for i, t in enumerate(ORDINATES)}
        periods = np.maximum(self._periods, 1.0)
        measured = {}
        for i, name in enumerate(() if self._full else self.scenario.observation.reading_names):
            measured[f"{name}_rms"] = np.sqrt(self._read_squares[:, i] / periods)
            measured[f"{name}_peak"] = self._read_peaks[:, i]
        every = max(1, rows.shape[-1] // points)
        time = period * np.arange(1, rows.shape[-1] + 1)[::every]
        shear, reference, drift = (rows[i, :, ::every].astype(float) for i in range(3))
        return Outcomes(values, measured, self.broken.copy(), time, shear, reference, drift)


def beyond_limits(values: dict[str, FloatArray], limits: Limits) -> BoolArray:
    """Return whether any limited quantity (N,) lies beyond its limit."""
    over = np.zeros(len(next(iter(values.values()))), dtype=bool)
    for quantity, field in LIMITED.items():
        limit = getattr(limits, field)
        if limit is not None:
            over |= values[quantity] > limit
    return over
