"""Tracking figures of signals whose errors are known."""

import math

import numpy as np
import pytest

from agents.evaluation.tracking import BANDS, band_ratios, tracking_figures
from agents.reporting.report.tracking import TRACKING_COLUMNS, tracking_rows
from shake_env.simulation.trajectory import Trajectory

STEP, SUBSTEPS = 1e-3, 5
TIME = STEP * np.arange(1, 20_001)
OMEGA = 2.0 * math.pi * 3.0


def trajectory(target, table, velocity, displacement):
    ends = slice(SUBSTEPS - 1, None, SUBSTEPS)
    state = np.zeros((len(TIME) // SUBSTEPS, 8))
    state[:, 1], state[:, 2] = displacement[ends], velocity[ends]
    zeros = np.zeros(len(TIME))
    return Trajectory(
        TIME, target, table, zeros, zeros, TIME[ends], np.zeros(len(state)), state, np.zeros((1, 4))
    )


def sine(amplitude=1.0, lag=0.0):
    """Acceleration, velocity and displacement of a motion from rest with one line."""
    t = np.maximum(TIME - lag, 0.0)
    return (
        amplitude * np.sin(OMEGA * t),
        amplitude / OMEGA * (1.0 - np.cos(OMEGA * t)),
        amplitude / OMEGA * (t - np.sin(OMEGA * t) / OMEGA),
    )


def test_a_perfect_table_has_no_error():
    a, v, d = sine()
    figures = tracking_figures(trajectory(a, a, v, d), STEP)
    errors = [getattr(figures, name) for name in vars(figures) if name.endswith(("_peak", "_rms"))]
    assert max(errors) < 1e-3  # of the trapezoids
    assert figures.delay == pytest.approx(0.0, abs=1e-5) and figures.error_energy == 0.0


def test_ten_percent_too_much():
    a, v, d = sine()
    figures = tracking_figures(trajectory(a, 1.1 * a, 1.1 * v, 1.1 * d), STEP)
    for name in ("acceleration", "velocity", "displacement"):
        assert getattr(figures, f"{name}_peak") == pytest.approx(0.1, rel=0.01)
        assert getattr(figures, f"{name}_rms") == pytest.approx(0.1, rel=0.01)
    assert figures.error_energy == pytest.approx(0.01, rel=1e-9)
    place = BANDS.index((2.0, 4.0))
    assert figures.band_ratios[place] == pytest.approx(1.1, rel=1e-9)


def test_a_late_table():
    a = sine()[0]
    figures = tracking_figures(trajectory(a, *sine(lag=0.012)), STEP)
    assert figures.delay == pytest.approx(0.012, abs=2e-4)
    # |1 - exp(-j omega tau)| = 2 sin(omega tau / 2) of a sine's rms.
    expected = 2.0 * math.sin(OMEGA * 0.012 / 2.0)
    assert figures.acceleration_rms == pytest.approx(expected, rel=0.01)
    assert figures.error_energy == pytest.approx(expected**2, rel=0.02)


def test_bands_are_told_apart():
    rng = np.random.default_rng(1)
    target = rng.standard_normal(len(TIME))
    spectrum, f = np.fft.rfft(target), np.fft.rfftfreq(len(TIME), STEP)
    gain = np.where(f < 3.9, 0.8, np.where(f < 16.5, 1.0, 1.3))
    ratios = band_ratios(np.fft.irfft(spectrum * gain, len(TIME)), target, STEP)
    assert ratios[:2] == pytest.approx((0.8, 0.8), rel=0.01)
    assert ratios[3:5] == pytest.approx((1.0, 1.0), rel=0.02)
    assert ratios[5] == pytest.approx(1.3, rel=0.02)
    assert np.isnan(band_ratios(target[:400], target[:400], STEP)[0])  # 0.4 s hold no 0.5 Hz


def test_a_still_table_and_its_row():
    a, _, _ = sine()
    still = tracking_figures(trajectory(a, 0.0 * a, 0.0 * a, 0.0 * a), STEP)
    assert still.acceleration_rms == pytest.approx(1.0) and still.error_energy == pytest.approx(1.0)
    assert still.to_json()["delay"] is None
    (row,) = tracking_rows({"none": [still]}, [0]).values()
    assert len(row) == len(TRACKING_COLUMNS) == 8 + len(BANDS)
    assert row[1] == pytest.approx(100.0) and np.isnan(row[6])  # no delay
