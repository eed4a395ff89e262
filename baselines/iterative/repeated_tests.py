"""Tests that are repeated with a corrected drive: what each measured and took from the specimen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.iterative.drive_file import DriveFile
from shake_env.controller import Controller
from shake_env.model.parameters import FloatArray
from shake_env.rollout import Earthquake, rollout, sampled_plants
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.trajectory import Trajectory

# A cost so much above the best before it takes a correction back. Out of the band that is corrected
# costs rise and fall by a percent or so from test to test while the base shear still converges.
WORSE = 1.1


@dataclass(frozen=True)
class Repeat:
    """One test on each of N tables, and what it took from their specimens.

    Every simulated test begins with an undamaged specimen. A real one keeps what earlier tests did to
    it; the sum of the energies over all repeats is what it would have had to take.
    """

    target: FloatArray  # (N, steps, k) y~ after each physics step [m/s^2]; zeros once a test has ended
    acceleration: FloatArray  # (N, steps, k) y_A
    reference_shear: FloatArray  # (N, steps, k) f~_s [N]
    base_shear: FloatArray  # (N, steps, k) f_s
    cost: FloatArray  # (N,) mean stage cost
    acceleration_error: FloatArray  # (N,) rms error over rms of the target [-]
    shear_error: FloatArray  # (N,) rms error over rms of the reference [-]
    energy: FloatArray  # (N,) that the specimen dissipated [J]
    perfect_energy: FloatArray  # (N,) that one perfect test would have dissipated [J]
    peak_drift: FloatArray  # (N,) of the first storey [m]
    reference_drift: FloatArray  # (N,) of the first storey in a perfect test [m]
    stopped: NDArray[np.bool_]  # (N,) whether a limit ended the test


@dataclass(frozen=True)
class Tests:
    """The repeats of a test, and the best drive of each table."""

    __test__ = False  # pytest would take it for tests of its own

    repeats: tuple[Repeat, ...]
    drive: FloatArray  # (N, steps) of each lane's test of least cost, fraction of the current limit
    feedback: Controller | None  # underneath it

    @property
    def controller(self) -> DriveFile:
        """What plays each table's best drive."""
        return DriveFile(self.drive, self.feedback, self.damage)

    @property
    def damage(self) -> FloatArray:
        """Energy that all repeats took from the specimens over that of one perfect test, (N,)."""
        total: FloatArray = np.sum([repeat.energy for repeat in self.repeats], axis=0)
        return total / self.repeats[0].perfect_energy


def repeat_tests(
    scenario: Scenario,
    earthquakes: Sequence[Earthquake],
    still: Repeat,
    correction: Callable[[Repeat], FloatArray],
    number: int,
    feedback: Controller | None,
) -> Tests:
    """Correct each table's drive by what its last test missed, and test again.

    Where a test was clearly worse than the best before it, the correction has overshot: the next one is
    made from the best again, and half as large from there on. A wrong model then costs repeats, and
    does not run away with the specimen.

    Parameters
    ----------
    scenario, earthquakes
        What is tested: each lane's true plant, the same in every repeat.
    still
        A table that does not move: what the first drive is made from.
    correction
        What a test adds to the drive, (N, steps) [A].
    number
        Tests to run.
    feedback
        Controller underneath the drive file.
    """
    steps = still.target.shape[1]
    best, least, step = np.zeros((len(earthquakes), steps)), still.cost, correction(still)
    last, last_step = best, step
    share, repeats = np.ones((len(earthquakes), 1)), []
    for _ in range(number):
        drive = np.clip(last + share * last_step / scenario.current_limit, -1.0, 1.0)
        test = run_test(scenario, earthquakes, DriveFile(drive, feedback), steps)
        repeats.append(test)
        new_step = correction(test)
        better = (test.cost < least)[:, None]
        worse = (test.cost > WORSE * least)[:, None]
        best, step = np.where(better, drive, best), np.where(better, new_step, step)
        least, share = np.minimum(test.cost, least), np.where(worse, 0.5 * share, share)
        last, last_step = np.where(worse, best, drive), np.where(worse, step, new_step)
    return Tests(tuple(repeats), best, feedback)


def run_test(
    scenario: Scenario,
    earthquakes: Sequence[Earthquake],
    controller: Controller,
    steps: int | None = None,
) -> Repeat:
    """Run one test on each earthquake, on the true plants; histories are `steps` periods long.

    What is returned is what happened, not what sensors made of it: a laboratory averages its noise
    away, or lives with it.
    """
    lanes = range(len(earthquakes))
    metrics, histories = rollout(controller, scenario, earthquakes, record=lanes)
    k = scenario.substeps
    if steps is None:
        steps = max(len(history.current) for history in histories.values())
    signals = np.zeros((4, len(earthquakes), steps, k))
    energy, drift = np.zeros((2, len(earthquakes))), np.zeros((2, len(earthquakes)))
    for lane, true in zip(lanes, sampled_plants(scenario, earthquakes), strict=True):
        one = histories[lane]
        for row, values in enumerate(
            (
                one.target_acceleration,
                one.table_acceleration,
                one.reference_base_shear,
                one.base_shear,
            )
        ):
            signals[row, lane, : len(one.current)] = values.reshape(-1, k)
        masses = np.asarray(true.specimen.masses)
        energy[:, lane] = _energies(one, masses, k, scenario.control_period)
        drift[:, lane] = np.max(np.abs(one.state[:, 4])), np.max(np.abs(one.reference[:, 0]))
    return Repeat(
        target=signals[0],
        acceleration=signals[1],
        reference_shear=signals[2],
        base_shear=signals[3],
        cost=np.array([row.cost for row in metrics]),
        acceleration_error=np.array([row.acceleration_rms_error for row in metrics]),
        shear_error=np.array([row.base_shear_rms_error for row in metrics]),
        energy=energy[0],
        perfect_energy=energy[1],
        peak_drift=drift[0],
        reference_drift=drift[1],
        stopped=np.array([row.broken_limit is not None for row in metrics]),
    )


def _energies(one: Trajectory, masses: FloatArray, k: int, period: float) -> tuple[float, float]:
    """Return what the specimen and its reference took [J]: work of the inertia forces on its floors.

    The relative input energy (Uang and Bertero, Earthquake Eng. Struct. Dyn. 19, 1990). Once the motion
    has died away, all of it went into damping and yielding. Accelerations are rough within a period,
    floor velocities are not: the one's mean times that of the other's two ends.
    """
    n, taken = len(masses), []
    for base, floors in (
        (one.table_acceleration, one.state[:, 4 + n : 4 + 2 * n]),
        (one.target_acceleration, one.reference[:, n : 2 * n]),
    ):
        momentum = np.concatenate([[0.0], floors @ masses])
        mean = base.reshape(-1, k).mean(axis=-1)
        taken.append(-float(np.sum(mean * 0.5 * (momentum[1:] + momentum[:-1])) * period))
    return taken[0], taken[1]
