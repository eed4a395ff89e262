"""A prepared motion begins and ends at rest, whatever was done; a record as it is keeps its numbers."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.signal import detrend

from shake_env import RECORD_NAMES, Record, RecordedMotion, load_record
from shake_env.errors import RecordError
from shake_env.motion.processing import filtered, remove_baseline, resampled
from shake_env.motion.rest import RAMP, from_rest
from shake_env.motion.targets import band_pass, target_history
from shake_env.records import read_motion, write_record

STEP = 1e-3


def cut_record(offset=0.5):
    """A record that was triggered late and stopped early, on an offset: nothing about it is at rest."""
    record = load_record(RECORD_NAMES[0])
    first, last = (round(time / record.sampling_interval) for time in (4.4, 16.0))
    values = record.acceleration[first:last] + offset
    return Record("cut", values, record.sampling_interval, (("event", "cut"),))


OPTIONS = {
    "high-pass": {},
    "band": {"highpass_frequency": 0.2, "lowpass_frequency": 25.0},
    "low-pass": {"highpass_frequency": None, "lowpass_frequency": 25.0},
    "compressed": {"time_compression": math.sqrt(3.0)},
    "stretched": {"time_compression": 0.5},
    "scaled": {"amplitude": 0.3},
    "cut": {"duration": 6.0},
}
PREPARATIONS = {
    "filtered": lambda record: filtered(record, highpass=0.1, lowpass=25.0),
    "low-passed": lambda record: filtered(record, lowpass=20.0),
    "mean": lambda record: remove_baseline(record, 0),
    "baseline": lambda record: remove_baseline(record, 3),
    "resampled": lambda record: resampled(record, 0.01),
    "all": lambda record: resampled(filtered(remove_baseline(record), highpass=0.2), 0.004),
}


def check_rest(motion):
    history = target_history(motion, STEP)
    whole = target_history(replace(motion, duration=None), STEP)
    peaks = [np.max(np.abs(values)) for values in vars(whole).values()]
    for values, end, peak in zip(vars(history).values(), vars(whole).values(), peaks, strict=True):
        assert values[0] == 0.0
        assert abs(values[1]) < 1e-3 * peak  # no step, one physics step on
        assert abs(end[-1]) < 1e-4 * peak
    # What a table does that starts at rest and has the acceleration: nothing else is hidden in the rest.
    velocity = cumulative_trapezoid(history.acceleration, dx=STEP, initial=0.0)
    assert np.allclose(history.velocity, velocity, rtol=0.0, atol=1e-9 * peaks[1])
    displacement = cumulative_trapezoid(velocity, dx=STEP, initial=0.0)
    assert np.allclose(history.displacement, displacement, rtol=0.0, atol=1e-9 * peaks[2])
    return history


@pytest.mark.parametrize(
    "record", [RECORD_NAMES[0], RECORD_NAMES[5], cut_record()], ids=["napa", "clc", "cut"]
)
@pytest.mark.parametrize("options", OPTIONS)
def test_every_option_of_a_motion(record, options):
    motion = RecordedMotion(record=record, **OPTIONS[options])
    history = check_rest(motion)
    if motion.highpass_frequency is not None:
        bound = 0.6 * motion.amplitude / motion.time_compression**2
        assert np.max(np.abs(history.displacement)) < bound
        ramp = np.abs(history.acceleration[: round(RAMP / motion.time_compression / STEP)])
        assert np.max(ramp) < 0.15 * motion.amplitude * np.max(np.abs(motion.source.acceleration))


@pytest.mark.parametrize("record", [load_record(RECORD_NAMES[5]), cut_record()], ids=["whole", "cut"])
@pytest.mark.parametrize("preparation", PREPARATIONS)
def test_every_preparation_of_a_record(record, preparation, tmp_path):
    prepared = PREPARATIONS[preparation](record)
    check_rest(RecordedMotion(record=prepared, highpass_frequency=None))
    (again,) = read_motion(write_record(prepared, tmp_path / "prepared.csv"))
    assert prepared.prepared and again.prepared and not record.prepared


@pytest.mark.parametrize("name", RECORD_NAMES)
@pytest.mark.parametrize("highpass", [0.1, 0.2])
def test_between_the_ramps_a_quiet_record_is_what_the_filter_left(name, highpass):
    record = load_record(name)
    found = target_history(RecordedMotion(record=name, highpass_frequency=highpass), 0.01).acceleration
    step = record.sampling_interval
    expected = band_pass(record.acceleration, step, highpass, None)[:: round(0.01 / step)]
    if step != 0.01:
        return  # resampled: the next test
    assert len(found) == len(expected)
    ramp = round(RAMP / 0.01)
    middle = slice(ramp, len(found) - ramp)
    # But for the constant that takes the trend of the velocity off.
    difference = (found - expected)[middle]
    assert np.ptp(difference) < 1e-12
    assert abs(np.mean(difference)) < 1e-3 * np.max(np.abs(expected))


def test_the_strong_motion_of_a_record_without_a_quiet_start_is_not_ramped():
    record = cut_record(offset=0.0)
    plain = band_pass(record.acceleration, record.sampling_interval, 0.2, None)
    found = target_history(
        RecordedMotion(record=record, highpass_frequency=0.2), record.sampling_interval
    )
    added = len(found.acceleration) - len(plain)
    assert 0 < added * record.sampling_interval <= 2.0 * RAMP
    lag = int(np.argmax(np.correlate(found.acceleration, plain, "valid")))
    same = found.acceleration[lag : lag + len(plain)] - plain
    strong = np.abs(plain) > 0.1 * np.max(np.abs(plain))
    assert np.ptp(same[strong]) < 1e-12
    assert abs(np.mean(same[strong])) < 0.01 * np.max(np.abs(plain))


def test_a_record_as_it_is_keeps_its_numbers():
    for record in (load_record(RECORD_NAMES[0]), cut_record()):
        step = record.sampling_interval
        history = target_history(RecordedMotion(record=record, highpass_frequency=None), step)
        velocity = detrend(cumulative_trapezoid(record.acceleration, dx=step, initial=0.0))
        assert np.array_equal(history.acceleration, record.acceleration)
        assert np.array_equal(history.velocity, velocity)
        displacement = detrend(cumulative_trapezoid(velocity, dx=step, initial=0.0))
        assert np.array_equal(history.displacement, displacement)


def test_a_cut_is_the_beginning_of_the_whole():
    motion = RecordedMotion(record=RECORD_NAMES[2], highpass_frequency=0.2, duration=12.0)
    cut, whole = target_history(motion, STEP), target_history(replace(motion, duration=None), STEP)
    for field in ("acceleration", "velocity", "displacement"):
        assert np.array_equal(getattr(cut, field), getattr(whole, field)[:12001])


@pytest.mark.parametrize("samples", [2, 3, 100])
def test_short_motions_and_motions_of_zeros(samples):
    for values in (np.zeros(samples), np.ones(samples), np.linspace(-1.0, 1.0, samples)):
        acceleration, velocity, displacement = from_rest(values, 0.01, 0.5)
        assert len(acceleration) == len(velocity) == len(displacement) >= samples
        assert np.isfinite(displacement).all() and acceleration[0] == displacement[0] == 0.0
        if not values.any():
            assert not acceleration.any() and len(acceleration) == samples


def test_targets_that_are_too_large_or_too_long_are_refused():
    large = Record("large", np.full(100, 1e300), 0.01, ())
    with pytest.raises(RecordError, match="must be at most 1e\\+12"):
        target_history(RecordedMotion(record=large, amplitude=1e6, highpass_frequency=None), STEP)
    long = Record("long", np.ones(50_000), 0.9, ())
    with pytest.raises(RecordError, match="cut the record"):
        target_history(RecordedMotion(record=long, highpass_frequency=None), STEP)
