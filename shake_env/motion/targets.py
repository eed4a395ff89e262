"""Target motions: filtered white noise and recorded earthquakes. Values only; see `excitation`."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache

import numpy as np
import scipy  # loads scipy.signal on first use, which takes half a second

from shake_env.errors import ParameterError, RecordError
from shake_env.model.parameters import FloatArray, is_number
from shake_env.model.ranges import check_ranges
from shake_env.motion.rest import RAMP, from_rest, integrals
from shake_env.records import Record, load_record

MOST_SAMPLES = 20_000_000  # of a recorded target, some 2 GiB with its integrals
LARGEST = 1e12  # [m/s^2] of a recorded target: 1e6 times any record's


@dataclass(frozen=True, kw_only=True)
class Envelope:
    """Build-up, hold and decay of an earthquake's intensity (Jennings, Housner and Tsai, 1968).

    ``(t / rise)^2`` up to `rise`, 1 for `hold`, then ``exp(-decay_rate (t - rise - hold))``. It scales
    the white noise ahead of the ground filter, so that the filter state stays a state.
    """

    rise: float = 2.0  # [s]
    hold: float = 8.0  # [s]
    decay_rate: float = 0.3  # [1/s]

    def __post_init__(self) -> None:
        check_ranges(self)

    def at(self, time: FloatArray) -> FloatArray:
        """Return the intensity, 0 to 1, at `time` (...) [s]."""
        rising = (time / self.rise) ** 2 if self.rise > 0.0 else np.ones_like(time)
        past = np.maximum(time - self.rise - self.hold, 0.0)
        return np.where(time < self.rise, rising, np.exp(-self.decay_rate * past))


@dataclass(frozen=True, kw_only=True)
class FilteredNoise:
    """White noise through the scenario's ground filter, from rest (paper, eqs. 9 to 11)."""

    duration: float = 20.0  # [s]
    amplitude: float = 1.0  # [-] factor on the target; 1 is the paper's unit intensity
    envelope: Envelope | None = None  # None: stationary

    def __post_init__(self) -> None:
        check_ranges(self)

    def pick(self, stream: np.random.Generator) -> FilteredNoise:
        """Return the motion of an episode: this one; its noise is drawn later."""
        return self


@dataclass(frozen=True, kw_only=True)
class RecordedMotion:
    """A recorded component, prepared for the table.

    The record is high-passed (fourth-order Butterworth, forwards and backwards, so without delay),
    because an uncorrected record integrates to metres of drift; low-passed likewise where asked;
    compressed in time, scaled, and resampled band-limited to the physics step. A motion that is filtered
    here, or whose record was prepared before, begins and ends at rest (`rest.from_rest`).
    """

    record: str | Record  # name of an embedded record, or a record
    amplitude: float = 1.0  # [-]
    time_compression: float = 1.0  # [-] 2 plays the record in half its time
    highpass_frequency: float | None = 0.1  # [Hz] of the record's own time; None leaves it as it is
    duration: float | None = None  # [s] of table time to keep; None keeps all
    lowpass_frequency: float | None = None  # [Hz] of the record's own time; None leaves it as it is

    def __post_init__(self) -> None:
        if not isinstance(self.record, str | Record):
            raise ParameterError("record", self.record, "must be the name of a record, or a Record")
        check_band(self.highpass_frequency, self.lowpass_frequency, self.source.sampling_interval)
        check_ranges(self)

    @property
    def source(self) -> Record:
        """The record itself."""
        return load_record(self.record) if isinstance(self.record, str) else self.record

    @property
    def prepared(self) -> bool:
        """Whether the motion is filtered, or its record was prepared before."""
        filtered = self.highpass_frequency is not None or self.lowpass_frequency is not None
        return filtered or self.source.prepared

    def pick(self, stream: np.random.Generator) -> RecordedMotion:
        """Return the motion of an episode: this one."""
        return self


@dataclass(frozen=True)
class MotionSet:
    """Several motions, of which each episode draws one.

    Raises
    ------
    ParameterError
        If there is no motion, or the amplitude is negative.
    """

    motions: tuple[RecordedMotion | FilteredNoise, ...]
    amplitude: float = 1.0  # [-] factor on every motion's own

    def __post_init__(self) -> None:
        object.__setattr__(self, "motions", tuple(self.motions))
        kinds = (RecordedMotion, FilteredNoise)
        if not self.motions or not all(isinstance(m, kinds) for m in self.motions):
            raise ParameterError(
                "motions", self.motions, "give at least one RecordedMotion or FilteredNoise"
            )
        check_ranges(self)

    @property
    def scaled(self) -> tuple[EpisodeMotion, ...]:
        """The motions with the factor applied."""
        return tuple(replace(m, amplitude=self.amplitude * m.amplitude) for m in self.motions)

    def pick(self, stream: np.random.Generator) -> EpisodeMotion:
        """Return the motion of an episode, drawn from its stream."""
        return self.scaled[int(stream.integers(len(self.motions)))]


EpisodeMotion = FilteredNoise | RecordedMotion
Motion = EpisodeMotion | MotionSet


@dataclass(frozen=True)
class TargetHistory:
    """A recorded target sampled at the physics step.

    Velocity and displacement of a prepared motion are the integrals of its acceleration from rest; those
    of a record as it is are taken less their trend, which the record's base line leaves.
    """

    acceleration: FloatArray  # (samples,) [m/s^2]
    velocity: FloatArray  # (samples,) [m/s]
    displacement: FloatArray  # (samples,) [m]


@lru_cache(maxsize=64)
def target_history(motion: RecordedMotion, physics_step: float) -> TargetHistory:
    """Return the target of a recorded motion at multiples of `physics_step` [s]."""
    record = motion.source
    acceleration = band_pass(
        record.acceleration,
        record.sampling_interval,
        motion.highpass_frequency,
        motion.lowpass_frequency,
    )
    interval = record.sampling_interval / motion.time_compression
    samples = record.duration / motion.time_compression / physics_step
    if samples > MOST_SAMPLES:
        raise RecordError(
            record.name,
            f"{samples:.3g} samples at {physics_step:g} s",
            f"must be at most {MOST_SAMPLES:.3g}: cut the record, or lengthen the physics step",
        )
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused
        acceleration = motion.amplitude * resample(acceleration, interval, physics_step)
    peak = float(np.max(np.abs(acceleration)))
    if not peak <= LARGEST:
        raise RecordError(record.name, f"{peak:.3g} m/s^2", f"must be at most {LARGEST:g} m/s^2")
    end = None if motion.duration is None else round(motion.duration / physics_step) + 1
    if motion.prepared:
        parts = from_rest(acceleration, physics_step, RAMP / motion.time_compression)
        return TargetHistory(*(values[:end] for values in parts))
    return TargetHistory(*integrals(acceleration[:end], physics_step))


def control_steps(motion: EpisodeMotion, period: float, physics_step: float) -> int:
    """Return the number of whole control periods in a motion.

    Raises
    ------
    ParameterError
        If the motion is shorter than one period.
    """
    if isinstance(motion, FilteredNoise):
        duration = motion.duration
    else:
        duration = (len(target_history(motion, physics_step).acceleration) - 1) * physics_step
    return whole_periods(duration, period)


def whole_periods(duration: float, period: float, field: str = "duration") -> int:
    """Return the number of whole control periods in a time [s]; an error names `field`.

    Raises
    ------
    ParameterError
        If the time is shorter than one period [s], or not finite.
    """
    steps = math.floor(duration / period + 1e-9) if math.isfinite(duration) else 0
    if steps < 1:
        raise ParameterError(field, duration, f"must hold at least one control period ({period:g} s)")
    return steps


def check_band(highpass: float | None, lowpass: float | None, interval: float) -> None:
    """Raise ParameterError unless ``0 < highpass < lowpass < Nyquist`` [Hz], where given."""
    nyquist = 0.5 / interval
    for field, frequency in (("highpass_frequency", highpass), ("lowpass_frequency", lowpass)):
        if frequency is not None and not (is_number(frequency) and 0.0 < frequency < nyquist):
            raise ParameterError(field, frequency, f"must lie in 0 to {nyquist} Hz, or be None")
    if highpass is not None and lowpass is not None and highpass >= lowpass:
        raise ParameterError(
            "highpass_frequency", highpass, f"must be below the low-pass at {lowpass} Hz"
        )


def band_pass(
    values: FloatArray, interval: float, highpass: float | None, lowpass: float | None
) -> FloatArray:
    """Return `values` (samples,) between two frequencies [Hz], without delay.

    Fourth-order Butterworth filters, each run forwards and backwards: half the power, twice over, is
    lost at the frequency itself. None leaves a side open.
    """
    check_band(highpass, lowpass, interval)
    for kind, frequency in (("high", highpass), ("low", lowpass)):
        if frequency is not None:
            sections = scipy.signal.butter(4, frequency, kind, fs=1.0 / interval, output="sos")
            # 15 samples are scipy's own choice for this order; a shorter record has fewer.
            values = scipy.signal.sosfiltfilt(sections, values, padlen=min(15, len(values) - 1))
    return values


def resample(values: FloatArray, interval: float, new_interval: float) -> FloatArray:
    """Resample a band-limited signal from one step to another.

    A polyphase windowed sinc (Kaiser, -100 dB) of 32 lobes a side passes what lies below both Nyquist
    frequencies and keeps images and aliases out; straight lines between samples would add both. The
    ratio of steps is taken as a fraction of whole numbers up to 10 000: exact for the usual ones, and
    for an irrational one (time compressed by the root of a length scale) off by about 1e-7.

    Parameters
    ----------
    values
        (samples,) at multiples of `interval` [s], at rest outside.
    interval, new_interval
        Old and new step [s].

    Returns
    -------
    (new samples,) from the first sample's time to the last one's.
    """
    exact = interval / new_interval
    if not 1e-3 <= exact <= 1e3:
        raise ParameterError(
            "new_interval", new_interval, f"must be within a factor of 1000 of the record's {interval} s"
        )
    ratio = Fraction(exact).limit_denominator(int(10_000 / max(exact, 1.0)))
    up, down = ratio.numerator, ratio.denominator
    if up == down:
        return values.copy()
    wider = max(up, down)
    window = scipy.signal.firwin(2 * 32 * wider + 1, 1.0 / wider, window=("kaiser", 10.0))
    resampled: FloatArray = scipy.signal.resample_poly(values, up, down, window=window)
    return resampled[: math.floor((len(values) - 1) * up / down) + 1]
