"""Damage that logged tests left in a specimen: a state for each sample of what its parameters may be.

The table's storeys are simulated under the logged commands, those of the reference specimen under the
logged targets. A sample's damage follows from its parameters and the logs alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from agents.laboratory.identification.prediction import predict_response
from agents.laboratory.logs.test_log import CURRENT, TARGET, TestLog
from shake_env.dynamics.yielding_reference import YieldingReference
from shake_env.model.parameters import FloatArray, stacked
from shake_env.model.plant import CoupledPlant
from shake_env.model.specimen_state import NEW, SpecimenState
from shake_env.scenario.scenario import Scenario

LANES = 256  # samples simulated at a time


def damage_after(scenarios: Sequence[Scenario], logs: Sequence[TestLog]) -> list[SpecimenState]:
    """Return the state of each of N specimens after tests.

    Parameters
    ----------
    scenarios
        N tables that differ in values of their parameters only.
    logs
        Of the tests that the specimen has borne, all of them, in order.
    """
    if not scenarios or not scenarios[0].nonlinearity.yielding.active:
        return [NEW] * len(scenarios)
    states: list[SpecimenState] = []
    for first in range(0, len(scenarios), LANES):
        states += _damage(scenarios[first : first + LANES], logs)
    return states


def _damage(scenarios: Sequence[Scenario], logs: Sequence[TestLog]) -> list[SpecimenState]:
    first, number = scenarios[0], len(scenarios)
    yielding, stories = first.nonlinearity.yielding, first.specimen.stories
    plant = CoupledPlant(
        stacked([each.actuator for each in scenarios]),
        stacked([each.specimen for each in scenarios]),
        first.ground,
        first.equations,
    )
    reference = YieldingReference.from_plant(plant, yielding, first.physics_step)
    # The law is homogeneous: at a target and drifts measured in its yield drift every lane has the same.
    unit = yielding.yield_drift / np.array([s.nonlinearity.yielding.yield_drift for s in scenarios])
    slip: FloatArray = np.zeros((number, stories))
    held = np.zeros((number, 3 * stories))
    energies = np.zeros((2, number))
    for log in logs:
        prediction = predict_response(scenarios, log.channels[CURRENT], (), slip)
        slip = prediction.slip
        energies[0] += np.maximum(prediction.energy, 0.0)
        start = np.concatenate([held[:, :stories], 0.0 * slip, held[:, 2 * stories :]], axis=1)
        target = _at_physics_steps(log, first.physics_step)
        held, states, shear = reference.run(start, target[:, None] * unit)
        drift = np.concatenate([start[None, :, 0], states[:, :, 0]])
        force = np.concatenate([np.zeros((1, number)), shear])
        work = np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(drift, axis=0), axis=0)
        energies[1] += np.maximum(work / unit**2, 0.0)
        # At rest a storey bears no force.
        slips = held[:, 2 * stories :]
        floors = np.cumsum((1.0 - yielding.stiffness_ratio) * slips, axis=1)
        held = np.concatenate([floors, np.zeros_like(slips), slips], axis=1)
    reference_slip = held[:, 2 * stories :] / unit[:, None]
    return [
        SpecimenState(
            slip=tuple(slip[i].tolist()),
            reference_slip=tuple(reference_slip[i].tolist()),
            energy=float(energies[0, i]),
            reference_energy=float(energies[1, i]),
        )
        for i in range(number)
    ]


def _at_physics_steps(log: TestLog, step: float) -> FloatArray:
    """Return a log's target (samples,) [m/s^2] at each physics step, from time 0 on.

    By cubic splines between the samples of the log: what lies above half of its rate is lost.
    """
    ends = np.concatenate([[0.0], log.channels[TARGET]])
    times = log.sampling_interval * np.arange(len(ends))
    count = round(log.duration / step)
    target: FloatArray = CubicSpline(times, ends)(step * np.arange(count + 1))
    return target
