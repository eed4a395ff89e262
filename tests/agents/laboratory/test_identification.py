"""Identification: the model that is fitted is the simulated one, and it finds what was put in."""

from dataclasses import fields, replace

import numpy as np
import pytest
from made_logs import laboratory_log, made
from scipy.stats import chi2

from agents.laboratory.identification.calibration import calibrate, data_set
from agents.laboratory.identification.consistency import require_motion
from agents.laboratory.identification.fit import fit
from agents.laboratory.identification.frequency_response import frequency_response
from agents.laboratory.identification.identify import identify, model_of, read_prior
from agents.laboratory.identification.likelihood import Likelihood, LogData, fourier_coefficients
from agents.laboratory.identification.parameters import (
    default_prior,
    nominal_values,
    plants_at,
    to_scale,
)
from agents.laboratory.identification.posterior import Posterior, read_posterior
from agents.laboratory.identification.prediction import predict_response
from agents.laboratory.identification.sampler import sample_posterior
from shake_env.errors import FileError, LogError, ParameterError
from shake_env.motion.targets import RecordedMotion
from shake_env.rollout import Earthquake, rollout
from shake_env.scenario.overrides import make_scenario
from shake_env.scenario.plants.samples import PlantSamples
from shake_env.scenario.plants.values import with_specimen_values
from shake_env.scenario.scenario_file import read_scenario, scenario_fields, scenario_of
from shake_env.scenario.scenario_writer import write_scenario

TRUTH = {
    "specimen_mass": 105.0,
    "storey_stiffness_1": 7.5e4,
    "storey_stiffness_2": 1.0e5,
    "coulomb_friction": 200.0,
    "bulk_modulus": 1.2e8,
    "delay": 3.1,
}


def floors():
    fields = {
        "sensing.sensors.floor_accelerations.noise": 0.05,
        "sensing.sensors.base_shear.noise": 5.0,
    }
    return make_scenario("laboratory", {"fields": fields})


def test_a_prediction_is_the_simulation_but_for_the_noise():
    log = laboratory_log()
    scenario = log.scenario
    readings = predict_response([scenario], log.channels["current"], log.measured).readings[0]
    for c, name in enumerate(log.measured):
        error = log.channels[name] - readings[:, c]
        place = scenario.observation.reading_names.index(name)
        noise = scenario.observation.sensor_values("noise")[place]
        assert np.std(error) == pytest.approx(noise, rel=0.1), name
        assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < 0.12, name


@pytest.mark.parametrize("name", ["yielding", "laboratory"])
def test_each_lane_of_a_batch_is_the_table_alone(name):
    """Yield drift and supply pressure differ between lanes by a change of units: exact to rounding."""
    scenario = make_scenario(name)
    prior = default_prior(scenario)
    names = (*prior.names, "supply_pressure") if name == "laboratory" else prior.names
    prior = default_prior(scenario, names)
    tables = plants_at(scenario, names, prior.draw(3, np.random.default_rng(1)))
    current = 0.02 * np.sin(0.05 * np.arange(200.0) ** 1.3)
    channels = ("table_acceleration", "base_shear", "load_pressure", "table_displacement")
    channels += ("floor_acceleration_1", "floor_acceleration_2")
    together = predict_response(tables, current, channels).readings
    for lane, table in enumerate(tables):
        alone = predict_response([table], current, channels).readings[0]
        scale = np.abs(alone).max(axis=0)
        assert np.max(np.abs(together[lane] - alone) / scale) < 1e-9


def test_fourier_coefficients_are_orthonormal():
    rng = np.random.default_rng(0)
    for samples in (64, 65):
        signal = rng.standard_normal((samples, 2)) + 5.0
        coefficients = fourier_coefficients(signal)
        assert coefficients.shape == (samples - 1, 2)
        power = np.sum((signal - signal.mean(axis=0)) ** 2, axis=0)
        np.testing.assert_allclose(np.sum(coefficients**2, axis=0), power, rtol=1e-12)


def test_a_fit_finds_what_was_put_in():
    scenario = floors()
    driven = scenario.with_plant(TRUTH)
    log = made(scenario, driven=driven, seconds=6.0, amplitude=0.1)
    result = identify([log], scenario, samples=400)
    truth = nominal_values(driven)
    names = [name for name in result.fit.names if name != "leakage"]
    at = [result.fit.names.index(name) for name in names]
    z = (result.fit.mode[at] - to_scale(names, truth)) / result.fit.deviations[at]
    assert np.max(np.abs(z)) < 4.0, dict(zip(names, z, strict=True))
    assert np.sum(z**2) < 35.0  # chi-squared of 11, at 0.0003
    values = result.fit.values
    for name in ("storey_stiffness_1", "storey_stiffness_2"):
        assert values[name] == pytest.approx(truth[name], rel=0.01)
    assert values["specimen_mass"] == pytest.approx(truth["specimen_mass"], rel=0.02)
    assert all(share == 0.0 for share in dict(result.posterior.shares).values())


def test_what_a_log_cannot_tell_is_named_with_the_excitation_that_would():
    log = laboratory_log()
    result = identify([log], log.scenario, samples=10)
    words = {each.names: str(each) for each in result.unidentified}
    assert "as wide as the prior" in words["leakage",]
    assert "large load pressure at low velocity" in words["leakage",]
    assert all(abs(result.fit.correlation[0, i]) <= 1.0 for i in range(3))


@pytest.mark.slow
def test_what_the_model_lacks_is_estimated_and_widens_the_posterior():
    scenario = floors()
    parts = scenario.nonlinearity
    friction = replace(parts.friction, static=320.0, coulomb=200.0)
    driven = replace(scenario, nonlinearity=replace(parts, friction=friction))
    log = made(scenario, driven=driven, seconds=5.0, amplitude=0.05)
    prior, data = default_prior(scenario), [LogData.from_log(log, scenario)]
    with_it = fit(Likelihood.from_data(scenario, prior.names, data), prior)
    without = fit(Likelihood.from_data(scenario, prior.names, data), prior, discrepancy=False)
    assert max(share.max() for share in with_it.likelihood.shares) > 0.003
    assert np.all(with_it.deviations > 0.99 * without.deviations)
    assert with_it.deviations[-2] > 1.3 * without.deviations[-2]


def test_shuffled_channels_are_refused_by_name():
    log = laboratory_log()
    swapped = dict(log.channels)
    swapped["table_velocity"], swapped["table_displacement"] = (
        swapped["table_displacement"],
        swapped["table_velocity"],
    )
    with pytest.raises(LogError, match="table_velocity looks like table_displacement"):
        identify([replace(log, channels=swapped)], log.scenario)


def test_a_log_of_another_rate_or_table_is_refused(tmp_path):
    log = laboratory_log()
    with pytest.raises(LogError, match="another rate"):
        LogData.from_log(replace(log, sampling_interval=0.004), log.scenario)
    (tmp_path / "table.toml").write_text(
        'schema = 1\nbase = "laboratory"\n[actuator]\npiston_area = "30 cm^2"\n'
    )
    with pytest.raises(LogError, match=r"piston_area.*another table"):
        model_of([log], table=tmp_path / "table.toml")
    (tmp_path / "specimen.toml").write_text(
        'schema = 1\nbase = "laboratory"\n[specimen.uniform]\nstories = 3\nmass_ratio = 0.5\n'
        'storey_frequency = "7 Hz"\ndamping_ratio = 0.05\n'
    )
    with pytest.raises(LogError, match="another specimen"):
        model_of([log], specimen=tmp_path / "specimen.toml")


def test_a_motion_that_the_log_does_not_contain_is_refused():
    scenario = make_scenario("laboratory")
    motion = RecordedMotion(record="napa2014_68150_hne", amplitude=0.2, duration=4.0)
    from agents.laboratory.logs.recorder import LogRecorder
    from shake_env.controller import NoControl

    quakes = [Earthquake("napa", motion)]
    recorder = LogRecorder(scenario, quakes)
    rollout(NoControl(), scenario, quakes, log=recorder)
    log = recorder.logs()[0]
    require_motion(log, replace(scenario, motion=motion))
    with pytest.raises(LogError, match=r"0\.5 times its amplitude"):
        require_motion(log, replace(scenario, motion=replace(motion, amplitude=0.4)))
    other = replace(motion, record="ridgecrest2019_clc_90")
    with pytest.raises(LogError, match="is another motion"):
        require_motion(log, replace(scenario, motion=other))
    require_motion(laboratory_log(), scenario)


def test_a_posterior_is_a_file_and_a_scenarios_uncertainty(tmp_path):
    log = laboratory_log()
    posterior = identify([log], log.scenario, samples=50).posterior
    posterior.write(tmp_path / "posterior.json")
    again = read_posterior(tmp_path / "posterior.json")
    np.testing.assert_allclose(again.points, posterior.points, rtol=1e-12, atol=1e-12)
    assert again.logs == ((log.name, log.sha256),)
    for field in fields(posterior):
        if field.name != "points":  # an array
            assert getattr(again, field.name) == getattr(posterior, field.name)
    (tmp_path / "test.toml").write_text(
        'schema = 1\nbase = "laboratory"\n[uncertainty.posterior]\npath = "posterior.json"\n'
    )
    scenario = read_scenario(tmp_path / "test.toml")
    assert isinstance(scenario.uncertainty, PlantSamples)
    assert len(scenario.uncertainty.rows) == 50
    drawn = scenario.drawn(np.random.default_rng(0))
    assert drawn.specimen != scenario.specimen
    assert scenario_of(scenario_fields(scenario)) == scenario
    write_scenario(scenario, tmp_path / "whole.toml")
    assert replace(read_scenario(tmp_path / "whole.toml"), name=scenario.name) == scenario
    text = (tmp_path / "posterior.json").read_text()
    for old, new in (('"version": 1', '"version": 2'), ('"samples": [[', '"samples": [["x", ')):
        (tmp_path / "wrong.json").write_text(text.replace(old, new))
        with pytest.raises(FileError):
            read_posterior(tmp_path / "wrong.json")


def test_draws_of_the_normal_posterior_explain_a_log_that_tells_a_sum_only():
    """Leakage and damping of the table damp alike: draws must not leave the ridge of their sum."""
    scenario = make_scenario("laboratory")
    prior = default_prior(scenario)
    _, log = data_set(scenario, prior, np.random.default_rng([0, 5]), 8.0, 0.1, "none")
    result = identify([log], scenario, prior=prior, samples=200, discrepancy=False)
    assert result.fit.normal.by_value
    drop = result.fit.log_posterior(result.fit.mode[None]) - result.fit.log_posterior(
        result.posterior.points
    )
    # Twice the drop is chi-squared with as many degrees of freedom as there are parameters.
    shares = np.array([0.5, 0.75, 0.9])
    expected = chi2.ppf(shares, len(prior.names))
    np.testing.assert_allclose(np.quantile(2.0 * drop, shares), expected, rtol=0.2)


@pytest.mark.slow
def test_samples_of_a_normal_posterior_are_normal():
    log = laboratory_log()
    prior = default_prior(log.scenario, ["coulomb_friction", "bulk_modulus", "specimen_mass"])
    data = [LogData.from_log(log, log.scenario)]
    result = fit(Likelihood.from_data(log.scenario, prior.names, data), prior)
    posterior = sample_posterior(result, moves=60, seed=1)
    again = sample_posterior(result, moves=60, seed=1)
    assert np.array_equal(posterior.points, again.points)
    z = (posterior.points - result.mode) / result.deviations
    assert np.max(np.abs(z.mean(axis=0))) < 0.25
    assert np.max(np.abs(z.std(axis=0) - 1.0)) < 0.25
    assert max(posterior.r_hat) < 1.2
    assert min(posterior.effective) > 100.0


def test_a_posterior_is_the_prior_of_the_next_update(tmp_path):
    log = laboratory_log()
    first = identify([log], log.scenario, samples=300)
    second = identify([log], log.scenario, samples=300, prior=first.posterior.prior())
    ratio = second.fit.deviations / first.fit.deviations
    told = [i for i, name in enumerate(first.fit.names) if name != "leakage"]
    np.testing.assert_allclose(ratio[told], 0.5**0.5, rtol=0.15)


def test_priors_are_read_from_files(tmp_path):
    scenario = make_scenario("laboratory")
    file = tmp_path / "prior.toml"
    file.write_text(
        'parameters = ["bulk_modulus", "delay"]\n[bulk_modulus]\nmedian = "200 MPa"\nfactor = 1.5\n'
        '[delay]\nmean = "2 ms"\ndeviation = "0.5 ms"\n'
    )
    prior = read_prior(file, scenario)
    np.testing.assert_allclose(prior.mean, [np.log(2e8), 2.0])
    np.testing.assert_allclose(prior.deviations, [np.log(1.5), 0.5])
    for text in (
        "[bulk_modulus]\nmedian = 1",
        "[nothing]\nmedian = 1\nfactor = 2",
        "[delay]\nmean=1\nfactor=2",
    ):
        file.write_text(text)
        with pytest.raises(ParameterError):
            read_prior(file, scenario)


def test_an_uncertain_specimen_ties_stiffnesses_and_masses_in_the_prior():
    prior = default_prior(make_scenario("unknown-specimen"))
    at = {name: i for i, name in enumerate(prior.names)}
    correlation = prior.covariance / np.outer(prior.deviations, prior.deviations)
    assert correlation[at["storey_stiffness_1"], at["storey_stiffness_2"]] > 0.9
    assert correlation[at["storey_stiffness_1"], at["specimen_mass"]] > 0.5


def test_values_of_a_specimen_by_name():
    specimen = make_scenario("laboratory").specimen
    changed = with_specimen_values(specimen, {"specimen_mass": 45.0, "storey_stiffness_2": 1e5})
    assert changed.mass == pytest.approx(45.0)
    assert changed.stiffnesses == (specimen.stiffnesses[0], 1e5)
    assert with_specimen_values(specimen, {}) is specimen


def test_a_frequency_response_is_that_of_the_plant():
    log = laboratory_log(8.0)
    response = frequency_response(log, "spool_position", "table_velocity")
    inside = response.shown & (response.frequency > 1.0) & (response.frequency < 10.0)
    assert inside.sum() >= 5
    actuator = log.scenario.actuator
    gain = actuator.flow_gain / actuator.piston_area  # below the oil column's frequency
    np.testing.assert_allclose(np.abs(response.h1[inside]), gain, rtol=0.25)
    assert np.all(np.abs(response.h2[inside]) >= np.abs(response.h1[inside]))


def test_posterior_of_a_fit_has_its_seed():
    log = laboratory_log()
    result = identify([log], log.scenario, samples=10, seed=3)
    assert np.array_equal(Posterior.from_fit(result.fit, 10, 3).points, result.posterior.points)


def rows_of_ranks(ranks, p):
    return [
        {"number": i, "ranks": [rank] * p, "errors": [0.01] * p, "widths": [0.5] * p, "seconds": 1.0}
        for i, rank in enumerate(ranks)
    ]


def test_calibration_goes_on_and_tells_uniform_ranks():
    scenario = make_scenario("laboratory")
    even = rows_of_ranks(range(2, 200, 5), len(default_prior(scenario).names))
    told = []
    # Every data set is there already: nothing is simulated.
    result = calibrate(scenario, data_sets=40, samples=200, done=even, on_row=told.append)
    assert told == [] and result["data_sets"] == 40
    assert all(result["uniform"].values()) and set(result["inside_90"].values()) == {0.9}
    low = [{**row, "ranks": [rank // 4 for rank in row["ranks"]]} for row in even]
    result = calibrate(scenario, data_sets=40, samples=200, done=low)
    assert not any(result["uniform"].values())
    with pytest.raises(ParameterError, match="none could be identified: no reason"):
        calibrate(scenario, data_sets=1, done=[{"number": 0, "failure": "no reason"}])
