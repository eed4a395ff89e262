"""Logs in a wrong unit or of a wrong sign, and logs that end early, are told from right ones."""

import time
from dataclasses import replace

import numpy as np
import pytest
from made_logs import laboratory_log, noise

from agents.laboratory.identification.consistency import part_covered, require_explained, require_motion
from agents.laboratory.identification.fit import fit
from agents.laboratory.identification.identify import identify
from agents.laboratory.identification.likelihood import Likelihood, LogData
from agents.laboratory.identification.parameters import default_prior
from agents.laboratory.identification.plausibility import (
    require_plausible,
    require_possible_command,
    unit_mistake,
)
from shake_env.errors import LogError
from shake_env.motion.targets import RecordedMotion

QUIET = 0.03  # amplitude at which acceleration and load pressure are near their sensors' noise
SEED = 0


def changed(log, **factors):
    channels = {name: factors.get(name, 1.0) * values for name, values in log.channels.items()}
    return replace(log, channels=channels, scenario_text=None, digest=None)


def checked(log, scenario):
    require_possible_command(log, scenario)
    prior = default_prior(scenario)
    data = [LogData.from_log(log, scenario)]
    require_plausible(Likelihood.from_data(scenario, prior.names, data), prior, SEED)


@pytest.mark.parametrize("amplitude", [0.22, QUIET])
def test_a_right_log_is_plausible(amplitude):
    log = laboratory_log(4.0, amplitude)
    checked(log, log.scenario)


@pytest.mark.parametrize("amplitude", [0.22, QUIET])
@pytest.mark.parametrize(
    ("channel", "factor", "words"),
    [
        ("table_acceleration", 1.0 / 9.80665, "in g and declared as m/s\\^2"),
        ("table_acceleration", 9.80665, "in m/s\\^2 and declared as g"),
        ("table_displacement", 1e3, "in mm and declared as m"),
        ("table_displacement", 1e-3, "in m and declared as mm"),
        ("table_velocity", 1e3, "in mm/s and declared as m/s"),
        ("load_pressure", 1e-3, "in kPa and declared as Pa"),
        ("load_pressure", 1e-5, "in bar and declared as Pa"),
        ("load_pressure", 1e5, "in Pa and declared as bar"),
        ("spool_position", 1e-3, "in m and declared as mm"),
        ("table_velocity", -1.0, "its sign is wrong"),
        ("current", -1.0, "current has the wrong sign"),
        ("current", 1e3, "in mA and declared as A"),
        ("current", 1e-3, "in A and declared as mA"),
        ("target_acceleration", 1.0 / 9.80665, "target_acceleration.*in g and declared as m/s\\^2"),
        ("target_acceleration", -1.0, "target_acceleration.*its sign is wrong"),
    ],
)
def test_a_wrong_unit_or_sign_is_refused_before_the_fit(amplitude, channel, factor, words):
    log = laboratory_log(4.0, amplitude)
    with pytest.raises(LogError, match=words):
        checked(changed(log, **{channel: factor}), log.scenario)


def test_a_wrong_sign_takes_a_fraction_of_a_fit():
    log = laboratory_log()
    identify([log], log.scenario, samples=4)  # what is loaded and compiled once
    begun = time.process_time()
    with pytest.raises(LogError, match="current has the wrong sign"):
        identify([changed(log, current=-1.0)], log.scenario)
    refused = time.process_time() - begun
    begun = time.process_time()
    identify([log], log.scenario, samples=4)
    assert refused < 0.5 * (time.process_time() - begun)


def test_a_channel_of_noise_alone_is_refused():
    log = laboratory_log()
    for name in log.measured:
        sensor = 1e-9 * np.random.default_rng(1).standard_normal(log.samples)
        quiet = replace(log, channels={**log.channels, name: sensor})
        with pytest.raises(LogError, match=rf"{name} is .* times.*not connected"):
            checked(quiet, log.scenario)


def test_what_the_fitted_model_predicts_must_be_in_the_log():
    """A channel near its noise in the log is asked for where the model has it far above."""
    log = laboratory_log()
    scenario, prior = log.scenario, default_prior(log.scenario)
    kept = fit(
        Likelihood.from_data(scenario, prior.names, [LogData.from_log(log, scenario)]), prior,
        discrepancy=False,
    )  # fmt: skip
    require_explained(kept)
    for factor in (0.05, 1.0 / 9.80665):
        other = changed(log, table_acceleration=factor)
        data = LogData.from_log(other, scenario)
        column = data.channels.index("table_acceleration")
        variance = data.variance.copy()
        variance[column] = 0.6 * np.mean(data.coefficients[:, column] ** 2)  # power below twice it
        likelihood = replace(kept.likelihood, data=(replace(data, variance=variance),))
        with pytest.raises(LogError, match=r"of table_acceleration the model explains .* rms is 0"):
            require_explained(replace(kept, likelihood=likelihood))


def test_mistakes_of_units_have_their_ratio():
    assert unit_mistake("m/s^2", 0.1) == "its numbers are in g and declared as m/s^2"
    assert unit_mistake("m/s^2", -0.1).startswith("its sign is wrong and its numbers are in g")
    assert unit_mistake("Pa", 1.1e5) == "its numbers are in Pa and declared as bar"
    assert unit_mistake("m", 1.0) == unit_mistake("m/s^2", 4.0) == unit_mistake("-", 1000.0) == ""


def test_a_motion_in_another_unit_is_named():
    log = laboratory_log()
    motion = RecordedMotion(record="napa2014_68150_hne", amplitude=0.2, duration=4.0)
    from shake_env.motion.targets import target_history

    step = log.scenario.physics_step
    wanted = target_history(motion, step).acceleration[log.scenario.substeps :: log.scenario.substeps]
    scenario = replace(log.scenario, motion=motion)
    for factor, words in ((1.0, None), (1.0 / 9.80665, "in g and"), (-1.0, "sign is wrong")):
        channels = {name: values[: len(wanted)] for name, values in log.channels.items()}
        other = replace(log, channels={**channels, "target_acceleration": factor * wanted})
        if words is None:
            require_motion(other, scenario)
            continue
        with pytest.raises(LogError, match=words):
            require_motion(other, scenario)


def test_a_log_that_ends_before_its_motion_says_how_much_it_covers():
    log = laboratory_log()
    assert part_covered(log, log.scenario) is None
    half = replace(log, channels={name: values[:400] for name, values in log.channels.items()})
    assert part_covered(half, log.scenario) == pytest.approx((2.0, 4.0))
    nearly = replace(log, channels={name: values[:-3] for name, values in log.channels.items()})
    assert part_covered(nearly, log.scenario) is None  # a recorder that stops a few samples early
    recorded = RecordedMotion(record="napa2014_68150_hne", duration=8.0)
    assert part_covered(log, replace(log.scenario, motion=recorded)) == pytest.approx((4.0, 8.0))
    assert part_covered(log, replace(log.scenario, motion=noise(4.0))) is None
