"""Preparing recorded motions: baseline, band, step, and the scale that brings one within a table.

Each function returns a new record whose attribution says what was done to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from shake_env.errors import ParameterError
from shake_env.model.parameters import Actuator, FloatArray, Specimen
from shake_env.model.ranges import check_ranges
from shake_env.motion.targets import RecordedMotion, band_pass, resample, target_history
from shake_env.records import Record
from shake_env.records.record import PREPARATION

SUPPLY_PRESSURE = 21e6  # [Pa] the rated 50 kN over the piston's area
SOFT_STROKE = 0.070  # [m] to either side
RATED_VELOCITY = 0.6  # [m/s]


def remove_baseline(record: Record, order: int = 1) -> Record:
    """Return a record less the polynomial in time that fits its acceleration best.

    Parameters
    ----------
    record
        What to correct.
    order
        0 takes off the mean, 1 a line, and so on up to 8.

    Raises
    ------
    ParameterError
        If the order is no whole number of 0 to 8, or the record has not more samples than that.
    """
    if isinstance(order, bool) or not isinstance(order, int) or not 0 <= order <= 8:
        raise ParameterError("order", order, "must be a whole number of 0 to 8")
    if len(record.acceleration) <= order + 1:
        raise ParameterError("order", order, f"{len(record.acceleration)} samples are too few for it")
    time = np.linspace(-1.0, 1.0, len(record.acceleration))
    baseline = np.polynomial.Polynomial.fit(time, record.acceleration, order, domain=[-1.0, 1.0])
    return _prepared(record, record.acceleration - baseline(time), f"baseline of order {order} removed")


def filtered(record: Record, *, highpass: float | None = None, lowpass: float | None = None) -> Record:
    """Return a record between two frequencies [Hz], as :func:`~shake_env.motion.targets.band_pass` does.

    Raises
    ------
    ParameterError
        Unless ``0 < highpass < lowpass < Nyquist``, where given.
    """
    acceleration = band_pass(record.acceleration, record.sampling_interval, highpass, lowpass)
    passed = " and ".join(
        f"{kind}-passed at {frequency:g} Hz"
        for kind, frequency in (("high", highpass), ("low", lowpass))
        if frequency is not None
    )
    if not passed:
        return record
    return _prepared(record, acceleration, f"{passed} (Butterworth, order 4, both ways)")


def resampled(record: Record, sampling_interval: float) -> Record:
    """Return a record at another step [s], band-limited; see `targets.resample`."""
    acceleration = resample(record.acceleration, record.sampling_interval, sampling_interval)
    note = f"resampled from {record.sampling_interval:g} s to {sampling_interval:g} s"
    return replace(_prepared(record, acceleration, note), sampling_interval=sampling_interval)


def _prepared(record: Record, acceleration: FloatArray, note: str) -> Record:
    done = sum(key.startswith(PREPARATION) for key, _ in record.attribution)
    attribution = (*record.attribution, (f"{PREPARATION}{done + 1}", note))
    return Record(record.name, acceleration, record.sampling_interval, attribution)


@dataclass(frozen=True, kw_only=True)
class TableCapacity:
    """What a motion must stay within to be repeated by a table.

    The defaults are the table of Table I of the paper with its specimen of half the table's mass. The
    force is what moves table and specimen as one rigid mass against the table's damping; a flexible
    specimen near resonance needs more.

    Raises
    ------
    ParameterError
        If a value is not above zero (the damping: not below).
    """

    displacement: float = SOFT_STROKE  # [m] to either side
    velocity: float = RATED_VELOCITY  # [m/s]
    acceleration: float = math.inf  # [m/s^2] inf: no limit
    force: float = SUPPLY_PRESSURE * Actuator.piston_area  # [N]
    moving_mass: float = 1.5 * Actuator.table_mass  # [kg] table and specimen
    table_damping: float = Actuator.table_damping  # [N s/m]

    def __post_init__(self) -> None:
        check_ranges(self)

    @classmethod
    def from_actuator(
        cls,
        actuator: Actuator,
        specimen: Specimen,
        *,
        displacement: float = SOFT_STROKE,
        velocity: float = RATED_VELOCITY,
    ) -> TableCapacity:
        """Return the capacity of an actuator under a specimen, its force at 21 MPa."""
        return cls(
            displacement=displacement,
            velocity=velocity,
            force=SUPPLY_PRESSURE * actuator.piston_area,
            moving_mass=actuator.table_mass + specimen.mass,
            table_damping=actuator.table_damping,
        )


@dataclass(frozen=True)
class MotionPeaks:
    """Largest values of a target motion, and of the force that it needs."""

    acceleration: float  # [m/s^2]
    velocity: float  # [m/s]
    displacement: float  # [m]
    force: float  # [N]

    @classmethod
    def from_motion(
        cls, motion: RecordedMotion, capacity: TableCapacity, physics_step: float
    ) -> MotionPeaks:
        """Return the peaks of a motion at multiples of `physics_step` [s]."""
        history = target_history(motion, physics_step)
        force = capacity.moving_mass * history.acceleration + capacity.table_damping * history.velocity
        a, v, x, f = (
            float(np.max(np.abs(values)))
            for values in (history.acceleration, history.velocity, history.displacement, force)
        )
        return cls(a, v, x, f)


@dataclass(frozen=True)
class TableFit:
    """A motion brought within a table: by how much, because of what, and what became of its peaks."""

    scaling: Literal["amplitude", "time"]
    factor: float  # on the amplitude, or on the time axis; 1 leaves the motion as it was
    governed_by: Literal["displacement", "velocity", "acceleration", "force", "nothing"]
    before: MotionPeaks
    after: MotionPeaks
    fits: bool  # whether the scaled motion is within every limit
    motion: RecordedMotion  # the scaled motion


def fit_amplitude(
    motion: RecordedMotion, capacity: TableCapacity | None = None, *, physics_step: float = 1e-3
) -> TableFit:
    """Scale a motion's amplitude down, never up, until a table can repeat it.

    Parameters
    ----------
    motion
        What the table should repeat; its own amplitude is scaled further.
    capacity
        The table's; None is that of Table I.
    physics_step
        Step [s] at which the peaks are taken.
    """
    capacity = TableCapacity() if capacity is None else capacity
    before = MotionPeaks.from_motion(motion, capacity, physics_step)
    shares = _shares(before, capacity)
    name = max(shares, key=lambda key: shares[key])
    # A whisker below, so that rounding leaves no peak above its limit.
    factor = (1.0 - 1e-9) / shares[name] if shares[name] > 1.0 else 1.0
    scaled = replace(motion, amplitude=motion.amplitude * factor)
    return _fit("amplitude", factor, name, before, scaled, capacity, physics_step)


def fit_time(
    motion: RecordedMotion, capacity: TableCapacity | None = None, *, physics_step: float = 1e-3
) -> TableFit:
    """Compress a motion in time, as similitude does for a small specimen, until a table can repeat it.

    With time multiplied by a factor s below 1, accelerations stay, velocities fall by s and
    displacements by s squared. Acceleration stays and force hardly falls: where one of them is too
    large, the result says ``fits = False``.

    Parameters
    ----------
    motion
        What the table should repeat; its own time compression is raised further.
    capacity
        The table's; None is that of Table I.
    physics_step
        Step [s] at which the peaks are taken.
    """
    capacity = TableCapacity() if capacity is None else capacity
    before = MotionPeaks.from_motion(motion, capacity, physics_step)
    shares = _shares(before, capacity)
    needed = {"displacement": math.sqrt(shares["displacement"]), "velocity": shares["velocity"]}
    name = max(needed, key=lambda key: needed[key])
    compression = max(needed[name], 1.0)
    stays = max(("force", "acceleration"), key=lambda key: shares[key])
    governed_by = name if shares[stays] <= 1.0 else stays
    if governed_by == name and needed[name] <= 1.0:
        return _fit("time", 1.0, name, before, motion, capacity, physics_step)
    scaled = motion
    for _ in range(8):  # what lies above the physics step's Nyquist frequency is lost: not quite the law
        scaled = replace(motion, time_compression=motion.time_compression * compression)
        left = _shares(MotionPeaks.from_motion(scaled, capacity, physics_step), capacity)
        worst = max(math.sqrt(left["displacement"]), left["velocity"])
        if worst <= 1.0:
            break
        compression *= worst * (1.0 + 1e-9)
    return _fit("time", 1.0 / compression, governed_by, before, scaled, capacity, physics_step)


def _shares(peaks: MotionPeaks, capacity: TableCapacity) -> dict[str, float]:
    return {
        "displacement": peaks.displacement / capacity.displacement,
        "velocity": peaks.velocity / capacity.velocity,
        "acceleration": peaks.acceleration / capacity.acceleration,
        "force": peaks.force / capacity.force,
    }


def _fit(
    scaling: Literal["amplitude", "time"],
    factor: float,
    name: str,
    before: MotionPeaks,
    scaled: RecordedMotion,
    capacity: TableCapacity,
    physics_step: float,
) -> TableFit:
    after = MotionPeaks.from_motion(scaled, capacity, physics_step)
    fits = max(_shares(after, capacity).values()) <= 1.0
    limits: dict[str, Literal["displacement", "velocity", "acceleration", "force"]] = {
        "displacement": "displacement", "velocity": "velocity", "acceleration": "acceleration",
        "force": "force",
    }  # fmt: skip
    governed_by = limits[name] if factor < 1.0 or not fits else "nothing"
    return TableFit(scaling, factor, governed_by, before, after, fits, scaled)
