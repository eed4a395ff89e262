"""Tests from a drive file: how it is played, what a test measured, and what it took from the specimen.

Laboratories write the whole current of a test ahead and play it back. A weak feedback of displacement
keeps the table in its place underneath; what it asks for is in the drive's own response, and a method
that corrects the drive corrects that, too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.controller import Controller, decide
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import TABLE_DISPLACEMENT
from shake_env.rollout import Earthquake, rollout, sampled_plants
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uncertainty
from shake_env.simulation.trajectory import Trajectory
from shake_env.simulation.transition import dynamics_of

# A cost so much above the best before it takes a correction back. Out of the band that is corrected
# costs rise and fall by a percent or so from test to test while the base shear still converges.
WORSE = 1.1
HOLD_FREQUENCY = 0.2  # [Hz] of the displacement feedback underneath a drive


class DisplacementHold:
    """Weak feedback of the table's displacement, ``u = -gain x_a``, against drift.

    Parameters
    ----------
    scenario
        Whose observation it reads: the full state, or a reading of the displacement.
    frequency
        [Hz] of the first-order loop that it closes around valve and piston.

    Raises
    ------
    ParameterError
        If the frequency is not a number above 0 Hz.
    ScenarioError
        If the scenario shows no displacement.
    """

    def __init__(self, scenario: Scenario, frequency: float = HOLD_FREQUENCY) -> None:
        if not 0.0 < frequency < math.inf:
            raise ParameterError("frequency", frequency, "must be above 0 Hz, finite")
        shown, plant = scenario.observation, scenario.plant
        self.gain = 2.0 * math.pi * frequency / scenario.actuator.velocity_gain  # [A/m]
        if scenario.sensing.full_state:
            self._entry = plant.layout.table_displacement
            scale = float(plant.state_scale[self._entry])
        elif "table_displacement" in shown.reading_names:
            place = shown.reading_names.index("table_displacement")
            self._entry = shown.readings.start + place
            scale = float(shown.reading_scale[place])
        else:
            raise ScenarioError("sensing", shown.reading_names, "must show the table's displacement")
        self._weight = -self.gain * scale / scenario.current_limit

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the action (..., 1) for an observation (..., n), within [-1, 1]."""
        action = np.clip(self._weight * observation[..., self._entry], -1.0, 1.0)
        return action[..., None].astype(np.float32), None


class DriveFile:
    """A prepared current, played back; zero once it has ended.

    Memory is the index of the coming step, and the feedback's own.

    Parameters
    ----------
    drive
        (steps,) fraction of the current limit, for any number of tables; or (N, steps), one a lane.
    feedback
        A controller whose action is added; None: none.
    damage
        (N,) energy that the tests in which the drive was found took from the specimens, over that of
        one perfect test; None: it was found without tests.

    Raises
    ------
    ParameterError
        If the drive is not finite or has another number of axes; in `predict`, if it is for another
        number of lanes.
    """

    def __init__(
        self,
        drive: FloatArray,
        feedback: Controller | None = None,
        damage: FloatArray | None = None,
    ) -> None:
        if drive.ndim not in (1, 2) or not np.isfinite(drive).all():
            raise ParameterError("drive shape", drive.shape, "must be (steps,) or (N, steps), finite")
        self.drive, self.feedback, self.damage = drive, feedback, damage
        self._padded = np.concatenate([drive, np.zeros((*drive.shape[:-1], 1))], axis=-1)

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the action (..., 1) for an observation (..., n), within [-1, 1]."""
        lanes = observation.shape[:-1]
        if self.drive.ndim == 2 and lanes != self.drive.shape[:1]:
            raise ParameterError(
                "observation shape", observation.shape, f"needs {len(self.drive)} lanes"
            )
        index, below = (np.zeros(lanes, dtype=int), None) if state is None else state
        if episode_start is not None:
            index = np.where(np.reshape(episode_start, lanes), 0, index)
        at = np.minimum(index, self.drive.shape[-1])
        if self.drive.ndim == 1:
            action = self._padded[at]
        else:
            action = np.take_along_axis(self._padded, at[:, None], axis=-1)[:, 0]
        if self.feedback is not None:
            added, below = decide(self.feedback, observation, below, episode_start, deterministic)
            action = action + added[..., 0]
        return np.clip(action, -1.0, 1.0)[..., None].astype(np.float32), (index + 1, below)


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


@dataclass(frozen=True)
class PeriodModel:
    """One control period of the nominal linear table, its loop delay and a displacement hold within.

    ``x[i+1] = F x[i] + G u[i]``; ``[y_A, f_s]`` after each physics step are ``Z_x x[i] + Z_u u[i]``.
    """

    F: FloatArray  # (m, m) SI
    G: FloatArray  # (m,) per A
    Z_x: FloatArray  # (2, k, m) [m/s^2, N]
    Z_u: FloatArray  # (2, k)

    @classmethod
    def from_scenario(cls, scenario: Scenario, hold: float = 0.0) -> PeriodModel:
        """Run the nominal linear update on a basis; `hold` [A/m] is the displacement feedback's gain."""
        nominal = replace(scenario, nonlinearity=Nonlinearity(), uncertainty=Uncertainty())
        dynamics = dynamics_of(nominal)
        m = dynamics.states
        current = np.zeros(m + 1)
        current[m], current[TABLE_DISPLACEMENT] = 1.0, -hold
        response = dynamics.control_step(np.eye(m + 1, m), current)
        outputs = np.stack([response.table_acceleration, response.base_shear])  # (2, m + 1, k)
        return cls(
            F=response.state[:m].T,
            G=response.state[m],
            Z_x=np.swapaxes(outputs[:, :m], 1, 2),
            Z_u=outputs[:, m],
        )

    def frequency_response(self, omega: FloatArray, period: float) -> NDArray[np.complex128]:
        """Return current to the period's mean table acceleration [m/s^2 per A]; `omega` in rad/s."""
        z = np.exp(1j * omega * period)[:, None, None]
        # States span ten decades; balancing by G's own size keeps the solve's digits.
        size = np.maximum(np.abs(self.G), 1e-12 * np.max(np.abs(self.G)))
        F, G = self.F * size / size[:, None], self.G / size
        inside = np.linalg.solve(
            z * np.eye(len(F)) - F, np.broadcast_to(G[:, None], (len(z), len(G), 1))
        )
        row, direct = np.mean(self.Z_x[0], axis=0) * size, np.mean(self.Z_u[0])
        response: NDArray[np.complex128] = inside[..., 0] @ row + direct
        return response
