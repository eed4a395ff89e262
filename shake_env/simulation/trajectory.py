"""Histories of tables, collected over a roll-out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shake_env.model.parameters import FloatArray
from shake_env.simulation.engine import BoolArray, StepResult


@dataclass(frozen=True)
class Trajectory:
    """One table's history; sample j of each is taken at ``time[j]``."""

    time: FloatArray  # (samples,) [s] after each physics step
    target_acceleration: FloatArray  # (samples,) [m/s^2]
    table_acceleration: FloatArray  # (samples,) [m/s^2]
    reference_base_shear: FloatArray  # (samples,) [N]
    base_shear: FloatArray  # (samples,) [N]
    control_time: FloatArray  # (steps,) [s] at each period's end
    current: FloatArray  # (steps,) [A]
    state: FloatArray  # (steps, states) SI, [x_A, x_S] first
    reference: FloatArray  # (steps, 2 stories) reference specimen x~_S SI


class Recorder:
    """Collects some lanes of a batch.

    Parameters
    ----------
    lanes
        Indices of the lanes that are wanted.
    """

    def __init__(self, lanes: Sequence[int]) -> None:
        self._lanes = list(lanes)
        self._signals: list[FloatArray] = []
        self._current: list[FloatArray] = []
        self._state: list[FloatArray] = []
        self._reference: list[FloatArray] = []
        self._steps = np.zeros(len(self._lanes), dtype=int)  # control periods that each lane ran

    def add(self, result: StepResult, running: BoolArray) -> None:
        """Keep a control period of the lanes; those not in `running` (N,) are cut off later."""
        if not self._lanes:
            return
        response, ground = result.outcome.response, result.ground
        signals = (
            ground.target,
            response.table_acceleration,
            ground.reference_shear,
            response.base_shear,
        )
        self._signals.append(np.stack([signal[self._lanes] for signal in signals]))
        self._current.append(result.outcome.current[self._lanes])
        self._state.append(response.state[self._lanes])
        self._reference.append(ground.reference[self._lanes])
        self._steps += running[self._lanes]

    def trajectories(self, physics_step: float, period: float) -> dict[int, Trajectory]:
        """Return the trajectory of each lane, by its index."""
        if not self._lanes:
            return {}
        signals = np.concatenate(self._signals, axis=-1)
        current, state = np.stack(self._current), np.stack(self._state)
        reference = np.stack(self._reference)
        substeps = signals.shape[-1] // len(current)
        trajectories = {}
        for row, (lane, steps) in enumerate(zip(self._lanes, self._steps.tolist(), strict=True)):
            target, table, reference_shear, shear = signals[:, row, : steps * substeps]
            trajectories[lane] = Trajectory(
                time=physics_step * np.arange(1, len(target) + 1, dtype=np.float64),
                target_acceleration=target,
                table_acceleration=table,
                reference_base_shear=reference_shear,
                base_shear=shear,
                control_time=period * np.arange(1, steps + 1, dtype=np.float64),
                current=current[:steps, row],
                state=state[:steps, row],
                reference=reference[:steps, row],
            )
        return trajectories
