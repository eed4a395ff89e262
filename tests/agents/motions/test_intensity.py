"""Intensity measures through eqsig, against formulas of our own."""

import math

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.signal import lsim

from agents.motions.intensity import (
    PERIODS,
    SAMPLES_A_PERIOD,
    arias_intensity,
    response_spectrum,
    significant_duration,
)
from shake_env import RECORD_NAMES, Record, load_record
from shake_env.errors import ParameterError
from shake_env.model.parameters import GRAVITY


def made(acceleration, interval=0.01):
    return Record("made", np.asarray(acceleration, dtype=float), interval, (("event", "made"),))


@pytest.mark.parametrize("name", RECORD_NAMES)
def test_arias_intensity_is_the_integral_by_trapezoids(name):
    record = load_record(name)
    expected = math.pi / (2.0 * GRAVITY) * trapezoid(record.acceleration**2, dx=record.sampling_interval)
    assert arias_intensity(record) == pytest.approx(expected, rel=1e-12)


def test_arias_intensity_of_a_sine():
    time = 0.001 * np.arange(10_001)
    found = arias_intensity(made(2.0 * np.sin(2.0 * math.pi * time), 0.001))
    assert found == pytest.approx(math.pi / (2.0 * GRAVITY) * 2.0 * 10.0, rel=1e-6)


@pytest.mark.parametrize("name", RECORD_NAMES)
def test_significant_duration_lies_between_5_and_95_percent(name):
    record = load_record(name)
    built_up = np.cumsum(record.acceleration**2) / np.sum(record.acceleration**2)
    first, last = np.searchsorted(built_up, [0.05, 0.95])
    expected = (last - first) * record.sampling_interval
    assert significant_duration(record) == pytest.approx(expected, abs=2.1 * record.sampling_interval)


def test_significant_duration_of_a_steady_motion_is_nine_tenths_of_it():
    assert significant_duration(made(np.ones(10_001), 0.001)) == pytest.approx(9.0, abs=0.003)


def test_significant_duration_of_a_spike_and_of_rest_is_0():
    spike = np.zeros(100)
    spike[40] = 1.0
    assert significant_duration(made(spike)) == 0.0
    assert significant_duration(made(np.zeros(100))) == 0.0


@pytest.mark.parametrize("period", [0.1, 0.5, 1.0, 3.0])
def test_response_spectrum_is_that_of_an_oscillator_in_scipy(period):
    record = load_record("ridgecrest2019_clc_360")
    omega, damping = 2.0 * math.pi / period, 0.05
    # Relative displacement u'' + 2 zeta omega u' + omega^2 u = -a, straight lines between samples.
    system = (
        [[0.0, 1.0], [-(omega**2), -2.0 * damping * omega]],
        [[0.0], [-1.0]],
        [[1.0, 0.0]],
        [[0.0]],
    )
    time = record.sampling_interval * np.arange(len(record.acceleration))
    _, displacement, _ = lsim(system, record.acceleration, time)
    (found,) = response_spectrum(record, np.array([period]), damping)
    assert found == pytest.approx(omega**2 * np.max(np.abs(displacement)), rel=1e-6)


def test_response_spectrum_in_parts_is_the_whole(monkeypatch):
    record = made(np.sin(0.3 * np.arange(400)))
    whole = response_spectrum(record)
    monkeypatch.setattr("agents.motions.intensity._CELLS", 1000)
    assert np.array_equal(response_spectrum(record), whole)
    assert whole.shape == PERIODS.shape


def wave(step, frequency=9.3):
    """A burst of fewer than three samples a wave at the coarsest step, the same at every step."""
    time = step * np.arange(round(12.0 / step) + 1) - 6.0
    return made(np.exp(-((time / 1.5) ** 2)) * np.sin(2.0 * math.pi * frequency * time + 0.3), step)


@pytest.mark.parametrize("step", [0.01, 0.02, 0.04])
def test_short_periods_are_those_of_the_motion_between_the_samples(step):
    periods = np.array([2.0, 2.5, 3.0, 4.0, 5.0, 5.99]) * step
    fine = response_spectrum(wave(2e-4), periods)  # direct integration, nothing interpolated
    coarse = response_spectrum(wave(step), periods)
    assert np.allclose(coarse, fine, rtol=6e-3)
    if step == 0.02:  # where eqsig gives the peak of the ground for all of them
        assert np.max(coarse) > 1.5 * np.max(np.abs(wave(step).acceleration))


def test_a_steady_wave_has_the_analytic_amplification_of_each_oscillator():
    step, frequency, damping = 0.02, 8.0, 0.05
    time = step * np.arange(4001)
    rise = np.clip(time / 30.0, 0.0, 1.0) * np.clip((80.0 - time) / 30.0, 0.0, 1.0)
    record = made(rise * np.sin(2.0 * math.pi * frequency * time), step)
    periods = np.array([0.045, 0.06, 0.08, 0.1, 0.115])
    ratio = periods * frequency
    expected = 1.0 / np.abs(1.0 - ratio**2 + 2j * damping * ratio)
    assert np.all(periods < SAMPLES_A_PERIOD * step)
    assert np.allclose(response_spectrum(record, periods, damping), expected, rtol=0.01)


def test_periods_that_the_record_cannot_hold_are_refused():
    with pytest.raises(ParameterError, match=r"periods = 0.01: .*at least two samples of 0.01 s"):
        response_spectrum(made(np.ones(100)), np.array([0.01, 1.0]))
