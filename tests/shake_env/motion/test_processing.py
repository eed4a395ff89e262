"""Preparation: baseline, band, step, and the scale that brings a motion within a table."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfreqz

from shake_env import RECORD_NAMES, Actuator, Record, RecordedMotion, Specimen, load_record
from shake_env.errors import ParameterError
from shake_env.motion.processing import (
    MotionPeaks,
    TableCapacity,
    filtered,
    fit_amplitude,
    fit_time,
    remove_baseline,
    resampled,
)
from shake_env.motion.targets import target_history


def made(acceleration, interval=0.01):
    return Record("made", np.asarray(acceleration, dtype=float), interval, (("event", "made"),))


def burst(frequency, peak=1.0, seconds=40.0, interval=0.01):
    """A sine with a smooth beginning and end, so that it integrates without drift."""
    time = interval * np.arange(round(seconds / interval) + 1)
    window = np.exp(-(((time - seconds / 2.0) / (seconds / 8.0)) ** 2))
    return made(peak * window * np.sin(2.0 * math.pi * frequency * (time - seconds / 2.0)), interval)


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_a_polynomial_baseline_goes_and_the_motion_stays(order):
    motion = burst(2.0).acceleration
    time = np.linspace(0.0, 1.0, len(motion))
    drift = sum((k + 1.0) * time**k for k in range(order + 1))
    found = remove_baseline(made(motion + drift), order)
    assert np.max(np.abs(found.acceleration - motion)) < 0.01
    exact = remove_baseline(made(drift), order)
    assert np.max(np.abs(exact.acceleration)) < 1e-12
    assert ("preparation 1", f"baseline of order {order} removed") in found.attribution


@pytest.mark.parametrize("order", [-1, 9, 1.5, True, "line"])
def test_senseless_orders_are_refused(order):
    with pytest.raises(ParameterError, match="order"):
        remove_baseline(burst(1.0), order)
    with pytest.raises(ParameterError, match="too few"):
        remove_baseline(made([0.0, 1.0]), 1)


@pytest.mark.parametrize("frequency", [0.05, 0.1, 0.2, 1.0, 20.0, 25.0, 40.0])
def test_the_band_pass_has_the_gain_of_two_butterworth_passes_and_no_delay(frequency):
    record = burst(frequency, seconds=max(400.0, 2000.0 / frequency))
    found = filtered(record, highpass=0.1, lowpass=25.0)
    gain = 1.0
    for kind, corner in (("high", 0.1), ("low", 25.0)):
        _, response = sosfreqz(butter(4, corner, kind, fs=100.0, output="sos"), [frequency], fs=100.0)
        gain *= abs(response[0]) ** 2
    assert np.max(np.abs(found.acceleration - gain * record.acceleration)) < 0.01
    assert "high-passed at 0.1 Hz and low-passed at 25 Hz" in found.attribution[-1][1]


def test_an_open_band_is_the_record_itself():
    record = burst(1.0)
    assert filtered(record) is record


@pytest.mark.parametrize(
    ("band", "field"),
    [
        ({"highpass": 0.0}, "highpass"),
        ({"highpass": 50.0}, "highpass"),
        ({"lowpass": -1.0}, "lowpass"),
        ({"lowpass": math.nan}, "lowpass"),
        ({"highpass": 5.0, "lowpass": 5.0}, "highpass"),
    ],
)
def test_senseless_bands_are_refused(band, field):
    with pytest.raises(ParameterError, match=field):
        filtered(burst(1.0), **band)
    options = {f"{key}_frequency": value for key, value in band.items()}
    with pytest.raises(ParameterError, match=field):
        RecordedMotion(record=burst(1.0), **options)


@pytest.mark.parametrize("points", [2, 3, 15, 16])
def test_short_records_can_be_filtered(points):
    level = made(np.ones(points))
    assert filtered(level, lowpass=20.0).acceleration == pytest.approx(np.ones(points), abs=1e-9)
    for band in ({"highpass": 1.0}, {"highpass": 1.0, "lowpass": 20.0}):
        assert np.max(np.abs(filtered(level, **band).acceleration)) < 1e-9
    values = np.random.default_rng(0).normal(size=points)
    found, thrice = (
        filtered(made(factor * values), highpass=1.0, lowpass=20.0).acceleration for factor in (1.0, 3.0)
    )
    assert np.max(np.abs(found)) > 0.1
    assert thrice == pytest.approx(3.0 * found, rel=1e-9)


def test_resampling_keeps_the_motion_and_says_so():
    found = resampled(burst(3.0), 0.005)
    assert found.sampling_interval == 0.005 and len(found.acceleration) == 8001
    assert np.max(np.abs(found.acceleration[::2] - burst(3.0).acceleration)) < 1e-4
    twice = remove_baseline(found, 0)
    assert [key for key, _ in twice.attribution] == ["event", "preparation 1", "preparation 2"]


def test_a_motion_s_low_pass_is_the_filter_of_records():
    record = load_record(RECORD_NAMES[0])
    motion = RecordedMotion(record=record, highpass_frequency=0.2, lowpass_frequency=25.0)
    ready = RecordedMotion(record=filtered(record, highpass=0.2, lowpass=25.0), highpass_frequency=None)
    for field in ("acceleration", "velocity", "displacement"):
        mine, other = (getattr(target_history(m, 1e-3), field) for m in (motion, ready))
        assert np.array_equal(mine, other)


# --- scaling to a table --------------------------------------------------------------------------


def test_peaks_of_a_sine_are_those_of_theory():
    frequency, peak = 2.0, 3.0
    omega = 2.0 * math.pi * frequency
    motion = RecordedMotion(record=burst(frequency, peak), highpass_frequency=None)
    capacity = TableCapacity(moving_mass=200.0, table_damping=1000.0)
    found = MotionPeaks.from_motion(motion, capacity, 1e-3)
    assert found.acceleration == pytest.approx(peak, rel=5e-3)
    assert found.velocity == pytest.approx(peak / omega, rel=5e-3)
    assert found.displacement == pytest.approx(peak / omega**2, rel=1e-2)
    assert found.force == pytest.approx(peak * math.hypot(200.0, 1000.0 / omega), rel=1e-2)


LIMITS = {
    # A 2 Hz burst of 3 m/s^2 has 0.239 m/s, 19.0 mm and 0.86 kN on the default table.
    "displacement": TableCapacity(displacement=0.010),
    "velocity": TableCapacity(velocity=0.1),
    "force": TableCapacity(force=300.0),
    "nothing": TableCapacity(),
}


@pytest.mark.parametrize("limit", LIMITS)
def test_amplitude_comes_down_to_the_limit_that_governs(limit):
    motion = RecordedMotion(record=burst(2.0, 3.0), highpass_frequency=None, amplitude=0.9)
    fit = fit_amplitude(motion, LIMITS[limit])
    assert fit.governed_by == limit and fit.fits and fit.scaling == "amplitude"
    assert fit.motion.amplitude == 0.9 * fit.factor
    assert fit.motion == replace(motion, amplitude=fit.motion.amplitude)
    assert fit.after == MotionPeaks.from_motion(fit.motion, LIMITS[limit], 1e-3)
    if limit == "nothing":
        assert fit.factor == 1.0 and fit.after == fit.before
    else:
        bound = getattr(LIMITS[limit], limit)
        assert getattr(fit.after, limit) == pytest.approx(bound, rel=1e-6)
        assert getattr(fit.after, limit) <= bound
        assert fit.factor == pytest.approx(bound / getattr(fit.before, limit), rel=1e-6)


@pytest.mark.parametrize("limit", ["displacement", "velocity", "nothing"])
def test_time_is_compressed_to_the_limit_that_governs(limit):
    motion = RecordedMotion(record=burst(2.0, 3.0), highpass_frequency=None)
    fit = fit_time(motion, LIMITS[limit])
    assert fit.governed_by == limit and fit.fits and fit.scaling == "time"
    assert fit.motion.time_compression == pytest.approx(1.0 / fit.factor)
    assert fit.after.acceleration == pytest.approx(fit.before.acceleration, rel=1e-3)
    if limit != "nothing":
        share = getattr(LIMITS[limit], limit) / getattr(fit.before, limit)
        assert fit.factor == pytest.approx(
            math.sqrt(share) if limit == "displacement" else share, rel=1e-3
        )
        assert getattr(fit.after, limit) <= getattr(LIMITS[limit], limit)


def test_no_time_scale_helps_against_force_and_the_result_says_so():
    motion = RecordedMotion(record=burst(2.0, 3.0), highpass_frequency=None)
    fit = fit_time(motion, LIMITS["force"])
    assert fit.governed_by == "force" and not fit.fits
    both = fit_time(motion, TableCapacity(force=300.0, displacement=0.010))
    assert both.governed_by == "force" and not both.fits
    assert both.after.displacement <= 0.010


@pytest.mark.parametrize("name", RECORD_NAMES)
def test_the_embedded_records_come_within_the_table(name):
    motion = RecordedMotion(record=name, highpass_frequency=0.2, lowpass_frequency=25.0)
    for fit in (fit_amplitude(motion), fit_time(motion)):
        assert fit.fits and 0.45 < fit.factor <= 1.0
        assert fit.after.displacement <= 0.070 and fit.after.velocity <= 0.6
        assert fit.after.force <= 21e6 * 0.00237


def test_a_record_at_rest_needs_no_scale():
    motion = RecordedMotion(record=made(np.zeros(100)))
    assert fit_amplitude(motion).factor == fit_time(motion).factor == 1.0


def test_capacity_of_an_actuator_under_a_specimen():
    capacity = TableCapacity.from_actuator(Actuator(), Specimen.uniform(mass_ratio=0.5))
    assert capacity == TableCapacity()
    assert capacity.moving_mass == 270.0 and capacity.force == pytest.approx(49_770.0)
    with pytest.raises(ParameterError, match="velocity"):
        TableCapacity(velocity=0.0)
