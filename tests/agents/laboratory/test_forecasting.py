"""Forecasts: intervals hold what is drawn from the belief, and what is advised keeps the limits."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_logs import noise
from rich.console import Console

from agents.cli.commands import parse
from agents.laboratory.forecasting.coupling import _base_shear
from agents.laboratory.forecasting.coverage import forecast_coverage
from agents.laboratory.forecasting.forecast import advice, centred_scenario, forecast, with_model_error
from agents.laboratory.forecasting.quantities import OutcomeRecorder
from baselines.registry import make_baseline
from shake_env.errors import ParameterError, ScenarioError
from shake_env.motion.targets import RecordedMotion, target_history
from shake_env.rollout import Earthquake, rollout
from shake_env.scenario.overrides import make_scenario
from shake_env.scenario.plants.samples import PlantSamples


def belief(shares=(), seconds=3.0, amplitude=0.22):
    rng = np.random.default_rng(5)
    rows = np.exp(rng.normal([np.log(90.0), np.log(87e3), np.log(150.0)], 0.1, size=(40, 3)))
    samples = PlantSamples(
        names=("specimen_mass", "storey_stiffness_1", "coulomb_friction"),
        rows=rows.tolist(),
        channels=tuple(name for name, _ in shares),
        shares=tuple(share for _, share in shares),
    )
    return replace(make_scenario("laboratory"), motion=noise(seconds, amplitude), uncertainty=samples)


@cache
def forecasts():
    return forecast(belief(), ("lqg", "tvc"), amplitudes=(0.5, 1.0), samples=40)


def test_a_forecast_counts_what_a_roll_out_does():
    scenario = make_scenario("laboratory", {"motion": noise(3.0)})
    quakes = [Earthquake("a", noise(3.0), 1), Earthquake("b", noise(3.0), 2)]
    recorder = OutcomeRecorder(scenario, 2)
    metrics, traces = rollout(
        make_baseline("lqg", scenario), scenario, quakes, record=[0, 1], log=recorder
    )
    outcomes = recorder.outcomes()
    for lane, each in enumerate(metrics):
        trace = traces[lane]
        values = {name: column[lane] for name, column in outcomes.values.items()}
        assert values["base_shear_error"] == pytest.approx(each.base_shear_rms_error)
        assert values["acceleration_error"] == pytest.approx(each.acceleration_rms_error)
        assert values["peak_displacement"] == pytest.approx(each.peak_displacement)
        assert values["peak_current"] == pytest.approx(each.peak_current)
        assert values["peak_base_shear"] == pytest.approx(np.abs(trace.base_shear).max())
        assert values["peak_drift"] == pytest.approx(np.abs(trace.state[:, 4]).max())
        noise_rms = 7.6e-5
        rms = np.sqrt(np.mean(trace.state[:, 1] ** 2))
        assert outcomes.measured["table_displacement_rms"][lane] == pytest.approx(rms, abs=3 * noise_rms)


def test_intervals_hold_a_test_drawn_from_the_belief():
    """Of other seeds: the plants, the motions' noise and the sensors' are drawn anew."""
    one = forecasts()[1]
    assert (one.controller, one.amplitude) == ("lqg", 1.0)
    other = forecast(belief(), ("lqg",), samples=30, seed=99)[0]
    inside = []
    for name in ("base_shear_error", "peak_drift", "peak_displacement", "energy"):
        low, middle, high = one.interval(name)
        assert low < middle < high
        values = other.outcomes.values[name]
        inside.append(np.mean((values >= low) & (values <= high)))
    assert 0.75 < np.mean(inside) <= 1.0


def test_coverage_counts_tests_of_other_seeds():
    result = forecast_coverage(belief(), "lqg", shakes=30, samples=40)
    assert (result["shakes"], result["samples"]) == (30, 40)
    assert set(result["coverage"]) >= {"base_shear_error", "energy", "load_pressure_rms"}
    assert 0.7 < result["mean"] <= 1.0
    narrow = forecast_coverage(belief(), "lqg", shakes=30, samples=40, probability=0.2)
    assert narrow["mean"] < 0.5


def test_a_stronger_test_needs_more_of_the_table():
    weak, strong = forecasts()[:2]
    assert strong.interval("peak_displacement")[1] > 1.5 * weak.interval("peak_displacement")[1]
    band = strong.band(strong.outcomes.base_shear)
    assert np.all(band[0] <= band[1]) and np.all(band[1] <= band[2])


def test_what_is_advised_keeps_the_limits():
    found = forecasts()
    chosen = advice(found, 0.95)
    assert chosen.amplitude == 1.0
    errors = {f.controller: f.interval("base_shear_error")[1] for f in found if f.amplitude == 1.0}
    assert chosen.controller == min(errors, key=errors.get)
    tight = replace(found[1], broken=np.ones(40, dtype=bool))
    assert tight.limit_probability > 0.95
    chosen = advice([found[0], tight], 0.95)
    assert chosen.amplitude == 0.5
    chosen = advice([tight], 0.95)
    assert chosen.amplitude == 0.0
    assert "no controller keeps every limit" in chosen.reason


def test_a_limit_that_the_belief_reaches_is_forecast():
    scenario = belief()
    limits = replace(scenario.limits, table_displacement=0.02)
    found = forecast(replace(scenario, limits=limits), ("lqg",), samples=30)[0]
    free = forecasts()[1].outcomes.values["peak_displacement"]
    assert found.limit_probability == pytest.approx(np.mean(free > 0.02), abs=0.2)
    assert found.limit_probability > 0.05


def test_what_the_model_lacks_widens_the_intervals():
    outcomes = forecasts()[1].outcomes
    lacking = belief((("load_pressure", 0.1), ("table_displacement", 0.05)))
    wider = with_model_error(outcomes, lacking, np.random.default_rng(0))
    ratio = np.log(wider.values["peak_displacement"] / outcomes.values["peak_displacement"])
    assert np.std(ratio) == pytest.approx(0.05, rel=0.4)
    assert np.mean(wider.values["base_shear_error"] ** 2) == pytest.approx(
        np.mean(outcomes.values["base_shear_error"] ** 2) + 0.1**2, rel=0.3
    )
    assert with_model_error(outcomes, belief(), np.random.default_rng(0)) is outcomes


def test_a_rigid_table_blames_the_specimen():
    for each in forecasts():
        assert 0.0 <= each.coupling.share <= 1.0
    scenario = replace(
        belief(), motion=RecordedMotion(record="napa2014_68150_hne", amplitude=0.2, duration=4.0)
    )
    found = forecast(scenario, ("lqg",), samples=8)[0]
    assert found.coupling.must_model == (found.coupling.error > 0.05)
    assert "specimen" in str(found.coupling)
    middle = centred_scenario(scenario)
    target = target_history(scenario.motion, 1e-3).acceleration
    shear = _base_shear(middle.specimen, target, 1e-3)
    peak = np.abs(np.median(found.outcomes.reference, axis=0)).max()
    assert np.abs(shear).max() == pytest.approx(peak, rel=0.3)


def test_what_cannot_be_forecast_is_refused():
    with pytest.raises(ScenarioError, match="uncertainty"):
        forecast(make_scenario("laboratory"), ("lqg",))
    with pytest.raises(ParameterError, match="amplitudes"):
        forecast(belief(), ("lqg",), amplitudes=(0.0,))
    with pytest.raises(ParameterError, match="controllers"):
        forecast(belief(), ())
    with pytest.raises(ScenarioError, match="controller"):
        forecast(belief(), ("nothing",))
    with pytest.raises(ScenarioError, match="motion"):
        forecast(replace(belief(), motion=make_scenario("records").motion), ("lqg",))


def test_the_command_writes_a_page(tmp_path):
    line = (
        "forecast unknown-specimen --controllers lqg --samples 4 --processes 1 --quiet "
        f"--motion tests/data/CICLC_trimmed.v1 --motion.column 1 --output {tmp_path / 'out'}"
    )
    result = parse(line.split()).run(Console(quiet=True))
    page = (tmp_path / "out" / "forecast.html").read_text()
    assert "P(limit)" in page and "forecast.svg" in page
    written = json.loads((tmp_path / "out" / "forecast.json").read_text())
    assert written == json.loads(json.dumps(result))
    low, middle, high = written["forecasts"][0]["intervals"]["base_shear_error"]
    assert low <= middle <= high
