"""Fidelity measures against theory and against eqsig."""

import eqsig.sdof
import numpy as np
import pytest

from agents.evaluation.fidelity import PERIODS, delay, fidelity, spectrum
from baselines.lqr.sampled import lqr
from shake_env import make_scenario
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.simulation.trajectory import Trajectory


def motion(samples=6000, seed=0, step=1e-3):
    rng = np.random.default_rng(seed)
    time = step * np.arange(samples)
    frequencies = rng.uniform(0.5, 20.0, 30)
    phases = rng.uniform(0.0, 2 * np.pi, 30)
    return np.sum(np.sin(2 * np.pi * np.outer(time, frequencies) + phases), axis=1)


def test_spectrum_equals_eqsigs():
    acceleration = motion() * np.hanning(6000)  # from rest: the two take a first sample differently
    expected = eqsig.sdof.pseudo_response_spectra(acceleration, 1e-3, PERIODS, 0.05)[2]
    np.testing.assert_allclose(spectrum(acceleration, 1e-3), expected, rtol=1e-6)


def test_spectrum_of_a_long_sine_is_its_resonance():
    """At resonance, after many cycles, the amplification is 1 / (2 zeta)."""
    period = 0.2
    time = 1e-3 * np.arange(20_000)
    found = spectrum(np.sin(2 * np.pi * time / period), 1e-3, np.array([period]))
    assert found[0] == pytest.approx(1.0 / (2 * 0.05), rel=1e-3)


@pytest.mark.parametrize("lag", [-0.0123, 0.0, 0.0034, 0.02])
def test_delay_finds_a_shift_between_samples(lag):
    fine = motion(samples=60_000, step=1e-4)
    first = 1000
    target = fine[first : first + 50_000 : 10]
    # A twentieth of a step: as the window slides, what leaves at one end and comes in at the other tilts
    # the correlation by the order of one sample in its length.
    achieved = fine[first - round(lag / 1e-4) :][:50_000:10]
    assert delay(target, achieved, 1e-3) == pytest.approx(lag, abs=5e-5)


def test_a_perfect_test_is_perfect_and_a_scaled_one_is_seen():
    scenario = make_scenario("linear", {"duration": 4.0})
    _, traces = rollout(lqr(scenario), scenario, noise_earthquakes(scenario, 1), record=[0])
    trace = traces[0]

    def scaled(factor):
        return Trajectory(
            time=trace.time,
            target_acceleration=trace.target_acceleration,
            table_acceleration=factor * trace.target_acceleration,
            reference_base_shear=trace.reference_base_shear,
            base_shear=factor * trace.reference_base_shear,
            control_time=trace.control_time,
            current=trace.current,
            state=np.concatenate([trace.state[:, :4], factor * trace.reference], axis=1),
            reference=trace.reference,
        )

    perfect = fidelity(scaled(1.0), 1e-3)
    assert (perfect.spectral_error, perfect.arias_ratio) == (0.0, 1.0)
    assert perfect.delay == pytest.approx(0.0, abs=1e-5)
    assert perfect.drift_ratio == perfect.energy_ratio == 1.0
    louder = fidelity(scaled(1.2), 1e-3)
    assert louder.spectral_error == 1.0 and louder.drift_ratio == pytest.approx(1.2)
    assert louder.arias_ratio == pytest.approx(1.44) == pytest.approx(louder.energy_ratio)
    real = fidelity(trace, 1e-3)
    assert 0.0 < real.delay < 0.008 and 0.8 < real.arias_ratio < 1.2
