"""Offline transfer-function iteration: repeat the test, and correct the drive file by what was missed.

What most laboratories do (Clark, Dynamic characteristics of large multiple degree of freedom shaking
tables, 10th World Conf. Earthquake Eng., 1992): measure the table's frequency response once under
random current, then

    drive_{k+1} = drive_k + gain * H (target - achieved_k),    H = G* / (|G|^2 + eps^2)

within a band. On a linear table whose response is known each frequency's error shrinks by
``1 - gain |G|^2 / (|G|^2 + eps^2)`` a repeat. The regularisation eps is a share of what a table without
mass or oil spring would do, ``omega K_q K_v / A_p``: near a notch of G the drive stays bounded.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from baselines.iterative.drive_file import HOLD_FREQUENCY, DisplacementHold, DriveFile, PeriodModel
from baselines.iterative.repeated_tests import Repeat, Tests, repeat_tests, run_test
from shake_env.controller import NoControl
from shake_env.errors import ParameterError
from shake_env.model.parameters import FloatArray
from shake_env.motion.targets import FilteredNoise
from shake_env.rollout import Earthquake
from shake_env.scenario.scenario import Scenario

ComplexArray = NDArray[np.complex128]

HALVINGS = 5  # of the identification's drive before it is given up
SETTLING = 5.0  # [s] of silence after the motion in which the correction's filter may ring out


@dataclass(frozen=True, kw_only=True)
class IterationPlan:
    """How an offline iteration is run.

    Raises
    ------
    ParameterError
        If a value is out of range.
    """

    repeats: int = 6  # tests
    gain: float = 0.7  # share of the missed motion that a repeat corrects
    regularisation: float = 0.1  # eps over a massless table's response [-]
    low_frequency: float = 0.2  # [Hz] ends of the band that is corrected
    high_frequency: float = 25.0  # [Hz]
    hold_frequency: float = HOLD_FREQUENCY  # [Hz] of the displacement feedback underneath
    level: float = 0.5  # rms acceleration of the identification test over the target's
    measured: bool = True  # whether the response is measured; False: the nominal model's

    def __post_init__(self) -> None:
        if self.repeats < 1:
            raise ParameterError("repeats", self.repeats, "must be at least 1")
        if not 0.0 < self.gain < 2.0:
            raise ParameterError("gain", self.gain, "must be above 0 and below 2, or the error grows")
        if not 0.0 <= self.regularisation < math.inf:
            raise ParameterError("regularisation", self.regularisation, "must be at least 0, finite")
        if not 0.0 < self.low_frequency < self.high_frequency:
            band = (self.low_frequency, self.high_frequency)
            raise ParameterError("band", band, "needs 0 < low_frequency < high_frequency")
        if not 0.0 < self.level < math.inf:
            raise ParameterError("level", self.level, "must be above 0")


@dataclass(frozen=True)
class Iteration:
    """What the repeats of a test came to."""

    tests: Tests
    identification: Repeat | None  # the test in which the response was measured
    response: ComplexArray  # (N or 1, lines) current to acceleration that was used [m/s^2 per A]

    @property
    def controller(self) -> DriveFile:
        """What plays each table's best drive."""
        return DriveFile(self.tests.drive, self.tests.feedback, self.damage)

    @property
    def damage(self) -> FloatArray:
        """Energy that all tests took from the specimens over that of one perfect test, (N,).

        The identification test counts: the specimen stood on the table.
        """
        damage = self.tests.damage
        if self.identification is None:
            return damage
        return damage + self.identification.energy / self.tests.repeats[0].perfect_energy


@dataclass(frozen=True)
class Lines:
    """The frequencies of a padded record of control periods, and those of them in the band."""

    length: int
    omega: FloatArray  # (lines,) [rad/s]
    inside: NDArray[np.bool_]  # (lines,)

    @classmethod
    def from_plan(cls, scenario: Scenario, plan: IterationPlan, steps: int) -> Lines:
        """Return the lines for tests of `steps` control periods.

        Raises
        ------
        ParameterError
            If the band reaches beyond half the control rate.
        """
        period = scenario.control_period
        if plan.high_frequency >= 0.5 / period:
            raise ParameterError(
                "high_frequency", plan.high_frequency, f"must lie below {0.5 / period:.6g} Hz"
            )
        length = next_fast_len(steps + round(SETTLING / period), real=True)
        frequency: FloatArray = np.arange(length // 2 + 1) / (length * period)
        inside = (frequency >= plan.low_frequency) & (frequency <= plan.high_frequency)
        omega: FloatArray = 2.0 * np.pi * frequency
        return cls(length, omega, inside)


def nominal_response(scenario: Scenario, plan: IterationPlan, omega: FloatArray) -> ComplexArray:
    """Return the nominal model's response (lines,), hold and delay within [m/s^2 per A]."""
    model = PeriodModel.from_scenario(scenario, DisplacementHold(scenario, plan.hold_frequency).gain)
    return model.frequency_response(omega, scenario.control_period)


def measured_response(
    scenario: Scenario, earthquakes: Sequence[Earthquake], plan: IterationPlan, lines: Lines
) -> tuple[ComplexArray, Repeat]:
    """Measure each true table's response under band-limited noise; return it (N, lines), and the test.

    The noise repeats itself after the padded record's length, so that its second period, once the
    start has died away, gives the response at each line without leakage (Pintelon and Schoukens,
    System Identification, 2012, ch. 2). Its amplitude falls as 1/f: the table's acceleration is then
    about white, and its displacement small.

    Raises
    ------
    ParameterError
        If a limit stopped the test at a thirty-second of its level, too.
    """
    omega, inside = lines.omega[lines.inside], lines.inside
    spectrum = np.zeros((len(earthquakes), len(inside)), dtype=complex)
    for lane, quake in enumerate(earthquakes):
        phases = np.random.default_rng(quake.seed).uniform(0.0, 2.0 * np.pi, len(omega))
        spectrum[lane, inside] = np.exp(1j * phases) / omega
    expected = np.fft.irfft(
        spectrum * _spread(nominal_response(scenario, plan, omega), inside), lines.length
    )
    wanted = [
        plan.level * q.motion.amplitude * math.sqrt(scenario.plant.target_variance) for q in earthquakes
    ]
    spectrum *= (np.asarray(wanted) / np.std(expected, axis=-1))[:, None]
    current = np.fft.irfft(spectrum, lines.length)
    played = np.tile(current / scenario.current_limit, 2)
    # A motion of the length of the noise; what it asks of the table is not played.
    duration = played.shape[-1] * scenario.control_period
    quiet = [replace(q, motion=FilteredNoise(duration=duration)) for q in earthquakes]
    hold = DisplacementHold(scenario, plan.hold_frequency)
    # As at a table: where a limit stops the test, the drive is halved and the test run again.
    for _ in range(HALVINGS + 1):
        test = run_test(scenario, quiet, DriveFile(played, hold))
        if not test.stopped.any():
            break
        lower = np.where(test.stopped, 0.5, 1.0)[:, None]
        played, spectrum = played * lower, spectrum * lower
    else:
        raise ParameterError("level", plan.level, "limits stopped the identification: lower it")
    achieved = np.fft.rfft(np.mean(test.acceleration, axis=-1)[:, lines.length :], lines.length)
    response = np.zeros_like(spectrum)
    response[:, inside] = achieved[:, inside] / spectrum[:, inside]
    return response, test


def _spread(values: ComplexArray, inside: NDArray[np.bool_]) -> ComplexArray:
    full = np.zeros(len(inside), dtype=complex)
    full[inside] = values
    return full


def regularised_inverse(
    scenario: Scenario, plan: IterationPlan, response: ComplexArray, omega: FloatArray
) -> ComplexArray:
    """Return H (..., lines) [A s^2/m]; nowhere above ``1 / (2 eps)``, and zero where G is."""
    eps = plan.regularisation * omega * scenario.actuator.velocity_gain
    square = np.abs(response) ** 2 + eps**2
    return response.conj() / np.where(square > 0.0, square, 1.0)


def transfer_function_iteration(
    scenario: Scenario, earthquakes: Sequence[Earthquake], plan: IterationPlan | None = None
) -> Iteration:
    """Repeat each earthquake's test and correct its drive file; the best test's drive is kept.

    A test that a limit stopped is corrected up to there.

    Parameters
    ----------
    scenario
        Whose true plants are tested: each lane's own, the same in every repeat.
    earthquakes
        One a lane.
    plan
        None: the default.
    """
    plan = IterationPlan() if plan is None else plan
    hold = DisplacementHold(scenario, plan.hold_frequency)
    # No table needs to move to say what one that stands still misses: the target.
    still = run_test(scenario, earthquakes, NoControl())
    steps = still.target.shape[1]
    lines = Lines.from_plan(scenario, plan, steps)
    identification = None
    response: ComplexArray
    if plan.measured:
        response, identification = measured_response(scenario, earthquakes, plan, lines)
    else:
        nominal = nominal_response(scenario, plan, lines.omega[lines.inside])
        response = _spread(nominal, lines.inside)[None]
    inverse = regularised_inverse(scenario, plan, response, lines.omega) * lines.inside

    def correction(test: Repeat) -> FloatArray:
        missed = np.fft.rfft(np.mean(test.target - test.acceleration, axis=-1), lines.length)
        added: FloatArray = plan.gain * np.fft.irfft(inverse * missed, lines.length)[:, :steps]
        return added

    tests = repeat_tests(scenario, earthquakes, still, correction, plan.repeats, hold)
    return Iteration(tests, identification, response)
