"""Intensity measures through eqsig, against formulas of our own."""

import math

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.signal import lsim

from agents.intensity import PERIODS, arias_intensity, response_spectrum, significant_duration
from shake_env import RECORD_NAMES, Record, load_record
from shake_env.parameters import GRAVITY


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
    monkeypatch.setattr("agents.intensity._CELLS", 1000)
    assert np.array_equal(response_spectrum(record), whole)
    assert whole.shape == PERIODS.shape
