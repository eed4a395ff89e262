"""Target motions: resampling, compression, integrals, envelopes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from shake_env import RECORD_NAMES, Envelope, FilteredNoise, Record, RecordedMotion, load_record
from shake_env.errors import ParameterError, RecordError
from shake_env.motion.rest import RAMP
from shake_env.motion.targets import control_steps, resample, target_history


def made_record(acceleration, interval=0.01, name="made"):
    return Record(name, np.asarray(acceleration, dtype=float), interval, (("event", "made"),))


def sine(frequency, interval, seconds=20.0, phase=0.4):
    time = interval * np.arange(round(seconds / interval) + 1)
    return time, np.sin(2.0 * math.pi * frequency * time + phase)


@pytest.mark.parametrize(
    ("interval", "new"),
    [(0.01, 0.001), (0.005, 0.001), (0.001, 0.005), (0.01, 0.004), (0.01 / math.sqrt(3.0), 0.001)],
)
def test_resample_keeps_what_lies_below_both_nyquist_frequencies(interval, new):
    # 0.9 of the lower Nyquist frequency; the filter's transition is 3 % wide about it.
    for share in (0.05, 0.4, 0.9):
        frequency = share * 0.5 / max(interval, new)
        time, values = sine(frequency, interval)
        found = resample(values, interval, new)
        at = new * np.arange(len(found))
        expected = np.sin(2.0 * math.pi * frequency * at + 0.4)
        assert abs(at[-1] - time[-1]) < new
        inner = (at > 0.5) & (at < time[-1] - 0.5)
        # A ratio that is no small fraction stretches time by some 1e-7.
        late = 0.0 if math.isclose(interval * 1e3, round(interval * 1e3)) else 3e-7 * time[-1]
        allowed = 1e-4 + 2.0 * math.pi * frequency * late
        assert np.max(np.abs(found - expected)[inner]) < allowed, share


@pytest.mark.parametrize("share", [1.1, 1.5, 3.3])
def test_resample_removes_what_lies_above_the_new_nyquist_frequency(share):
    # Straight lines or decimation would fold it back at full size.
    _, values = sine(share * 100.0, 0.001)
    found = resample(values, 0.001, 0.005)
    assert np.max(np.abs(found[100:-100])) < 1e-4


def test_resample_makes_no_images():
    _, values = sine(40.0, 0.01)
    found = resample(values, 0.01, 0.001)
    spectrum = np.abs(np.fft.rfft(found * np.hanning(len(found))))
    frequency = np.fft.rfftfreq(len(found), 0.001)
    assert np.max(spectrum[frequency > 55.0]) < 1e-4 * np.max(spectrum)


@pytest.mark.parametrize("factor", [2, 5, 10])
def test_resample_by_a_whole_number_keeps_the_samples(factor):
    values = np.random.default_rng(0).standard_normal(400)
    found = resample(values, 0.01, 0.01 / factor)
    assert len(found) == 399 * factor + 1
    # The window's end values and the filter's unit gain at 0 Hz: 1e-5 of the largest sample.
    assert np.max(np.abs(found[::factor] - values)) < 1e-4


def test_resample_to_the_same_step_is_a_copy():
    values = np.arange(5.0)
    found = resample(values, 0.01, 0.01)
    assert np.array_equal(found, values) and found is not values


@pytest.mark.parametrize("new", [1e-6, 100.0])
def test_resample_refuses_absurd_steps(new):
    with pytest.raises(ParameterError, match=r"new_interval = .*factor of 1000"):
        resample(np.zeros(10), 0.01, new)


def test_time_compression_halves_duration_and_doubles_frequency():
    record = made_record(sine(3.0, 0.01)[1])
    plain = RecordedMotion(record=record, highpass_frequency=None)
    double = replace(plain, time_compression=2.0)
    slow, fast = (target_history(m, 1e-3).acceleration for m in (plain, double))
    assert len(slow) == 20001 and len(fast) == 10001
    time = 1e-3 * np.arange(len(fast))
    inner = slice(1000, -1000)
    expected = np.sin(2.0 * math.pi * 6.0 * time + 0.4)
    assert np.max(np.abs(fast - expected)[inner]) < 1e-4
    # The same values, every second sample of the slow motion.
    assert np.max(np.abs(fast - slow[::2])[inner]) < 1e-4


def test_time_compression_by_the_root_of_a_length_scale():
    # The similitude law of reduced specimens: an irrational ratio of steps.
    record = made_record(sine(3.0, 0.01)[1])
    for scale in (2.0, 3.0, 5.0, 10.0):
        motion = RecordedMotion(
            record=record, highpass_frequency=None, time_compression=math.sqrt(scale)
        )
        found = target_history(motion, 1e-3).acceleration
        time = 1e-3 * np.arange(len(found))
        expected = np.sin(2.0 * math.pi * 3.0 * math.sqrt(scale) * time + 0.4)
        assert len(found) == math.floor(20.0 / math.sqrt(scale) / 1e-3) + 1
        assert np.max(np.abs(found - expected)[1000:-1000]) < 2e-4


def test_amplitude_is_linear():
    one, three = (
        target_history(RecordedMotion(record=RECORD_NAMES[2], amplitude=a), 1e-3) for a in (1.0, 3.0)
    )
    for field in ("acceleration", "velocity", "displacement"):
        expected = 3.0 * getattr(one, field)
        assert np.max(np.abs(getattr(three, field) - expected)) < 1e-12 * np.max(np.abs(expected))


def test_duration_cuts_the_motion():
    motion = RecordedMotion(record=RECORD_NAMES[0], duration=3.25)
    whole = target_history(replace(motion, duration=None), 1e-3).acceleration
    cut = target_history(motion, 1e-3).acceleration
    assert len(cut) == 3251 and np.array_equal(cut, whole[:3251])
    assert control_steps(motion, 5e-3, 1e-3) == 650


@pytest.mark.parametrize("name", RECORD_NAMES)
def test_record_is_kept_but_for_its_drift(name):
    record = load_record(name)
    history = target_history(RecordedMotion(record=name), 1e-3)
    factor = round(record.sampling_interval / 1e-3)
    # The high-pass at 0.1 Hz takes the drift, up to 3 % of the CLC records, and leaves what lies between
    # the ramps at the ends.
    ramp = round(RAMP / record.sampling_interval)
    error = (history.acceleration[::factor] - record.acceleration)[ramp:-ramp]
    assert np.std(error) < 0.04 * np.std(record.acceleration)
    assert np.max(np.abs(history.displacement)) < 0.6
    assert np.max(np.abs(history.velocity)) < 1.0


def test_highpass_has_no_delay_and_can_be_left_out():
    record = load_record(RECORD_NAMES[4])
    plain = target_history(RecordedMotion(record=record, highpass_frequency=None), 0.01)
    assert np.array_equal(plain.acceleration, record.acceleration)
    filtered = target_history(RecordedMotion(record=record), 0.01).acceleration
    lags = np.arange(-5, 6)
    centre = slice(100, -100)
    match = [np.dot(np.roll(filtered, lag)[centre], record.acceleration[centre]) for lag in lags]
    assert lags[int(np.argmax(match))] == 0


def test_velocity_and_displacement_are_integrals():
    history = target_history(RecordedMotion(record=RECORD_NAMES[0]), 1e-3)
    for value, rate in (
        (history.displacement, history.velocity),
        (history.velocity, history.acceleration),
    ):
        middle = 0.5 * (rate[1:] + rate[:-1])
        difference = np.diff(value) / 1e-3 - middle
        # Integrals less a straight line: the rate differs by one constant, and nothing else.
        assert np.ptp(difference) < 1e-9 * np.max(np.abs(rate))
        assert abs(np.mean(difference)) < 0.02 * np.max(np.abs(rate))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("amplitude", -1.0),
        ("amplitude", math.nan),
        ("amplitude", "1"),
        ("time_compression", 0.0),
        ("time_compression", -2.0),
        ("duration", 0.0),
        ("duration", math.inf),
        ("highpass_frequency", 0.0),
        ("highpass_frequency", 50.0),
        ("highpass_frequency", math.nan),
        ("record", 5),
    ],
)
def test_bad_recorded_motion_raises_a_parameter_error(field, value):
    values = {"record": made_record(np.ones(100)), field: value}
    with pytest.raises(ParameterError) as caught:
        RecordedMotion(**values)
    assert caught.value.field == field and repr(value) in str(caught.value)
    assert "must" in caught.value.remedy


def test_unknown_record_names_the_nearest():
    with pytest.raises(RecordError, match=r"record = 'ridgecrest2019_clc_9'.*'ridgecrest2019_clc_90'"):
        RecordedMotion(record="ridgecrest2019_clc_9")


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [
        (FilteredNoise, "duration", 0.0),
        (FilteredNoise, "duration", math.nan),
        (FilteredNoise, "amplitude", -0.1),
        (Envelope, "rise", -1.0),
        (Envelope, "hold", math.inf),
        (Envelope, "decay_rate", math.nan),
    ],
)
def test_bad_noise_raises_a_parameter_error(kind, field, value):
    with pytest.raises(ParameterError, match=f"{field} = .*must be a finite number"):
        kind(**{field: value})


def test_envelope():
    envelope = Envelope(rise=2.0, hold=3.0, decay_rate=0.5)
    time = np.array([0.0, 1.0, 2.0, 4.9, 5.0, 7.0])
    expected = [0.0, 0.25, 1.0, 1.0, 1.0, math.exp(-1.0)]
    assert envelope.at(time) == pytest.approx(expected, rel=1e-12)
    sudden = Envelope(rise=0.0, hold=1.0, decay_rate=0.0)
    assert np.array_equal(sudden.at(np.array([0.0, 5.0])), [1.0, 1.0])
    fine = envelope.at(np.linspace(0.0, 20.0, 100001))
    assert np.max(np.abs(np.diff(fine))) < 3e-4 and np.max(fine) <= 1.0 and np.min(fine) >= 0.0
