"""Bad scenarios: a typed error that names field, value and remedy; what overrides reach."""

import math
from dataclasses import replace

import numpy as np
import pytest
from bad_values import BAD_NUMBERS

from shake_env import (
    Actuator,
    FilteredNoise,
    Limits,
    ModelEquations,
    Objective,
    RecordedMotion,
    Scenario,
    ShakeTableEnv,
    Specimen,
    load_record,
    make_scenario,
)
from shake_env.errors import (
    ParameterError,
    RecordError,
    ScenarioError,
)


@pytest.mark.parametrize("name", ["printed", "", 3, None, ["as_printed"]], ids=repr)
def test_unknown_equations(name):
    with pytest.raises(ParameterError, match=r"equations = .*known: as_printed, corrected"):
        make_scenario("linear", {"equations": name})


@pytest.mark.parametrize("field", ["physics_step", "control_rate", "current_limit"])
@pytest.mark.parametrize("value", [0.0, -1.0, *BAD_NUMBERS], ids=repr)
def test_timing_must_be_positive(field, value):
    with pytest.raises(ParameterError, match=f"{field} = .*above 0"):
        Scenario(**{field: value})


@pytest.mark.parametrize(
    ("rate", "nearest"), [(300.0, "333.333"), (1500.0, "1000"), (2500.0, "1000"), (201.0, "200")]
)
def test_control_period_must_be_a_whole_number_of_steps(rate, nearest):
    with pytest.raises(ParameterError, match=rf"control_rate = {rate}: .*try {nearest} Hz"):
        Scenario(control_rate=rate)


@pytest.mark.parametrize(
    ("rate", "step", "substeps"),
    [(200.0, 1e-3, 5), (1000.0, 1e-3, 1), (1000.0 / 3, 1e-3, 3), (100.0, 1e-4, 100), (60.0, 1 / 240, 4)],
)
def test_control_periods_that_fit(rate, step, substeps):
    scenario = Scenario(control_rate=rate, physics_step=step)
    assert scenario.substeps == substeps
    assert scenario.control_period == pytest.approx(1.0 / rate, rel=1e-9)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("actuator", 3),
        ("specimen", "tower"),
        ("ground", None),
        ("equations", "corrected"),
        ("motion", "napa2014_68150_hne"),
        ("objective", (1, 1)),
        ("limits", "laboratory"),
    ],
)
def test_parts_of_a_scenario_have_their_type(field, value):
    with pytest.raises(ScenarioError, match=rf"{field} = .*must be a \w+") as caught:
        Scenario(**{field: value})
    assert repr(value) in str(caught.value)


@pytest.mark.parametrize("name", ["liner", "", "LINEAR"])
def test_unknown_scenario(name):
    with pytest.raises(
        ScenarioError, match=r"scenario = .*known: .*as-printed, field, laboratory, linear"
    ):
        make_scenario(name)
    with pytest.raises(ScenarioError, match="scenario"):
        ShakeTableEnv(name)


def test_a_near_miss_is_guessed():
    with pytest.raises(ScenarioError, match="did you mean 'linear'"):
        make_scenario("liner")
    with pytest.raises(ScenarioError, match="did you mean 'mass_ratio'"):
        make_scenario("linear", {"mas_ratio": 0.2})


@pytest.mark.parametrize("value", [None, 5, Scenario])
def test_a_scenario_is_a_name_or_a_value(value):
    with pytest.raises(ScenarioError, match=r"scenario = .*must be a Scenario or the name"):
        make_scenario(value)


def test_unknown_override():
    with pytest.raises(ScenarioError, match=r"scenario option = 'colour': .*known: .*control_rate"):
        ShakeTableEnv(colour="red")


@pytest.mark.parametrize(
    ("overrides", "names"),
    [
        ({"specimen": Specimen.uniform(), "stories": 3}, "specimen.*stories"),
        ({"objective": Objective(), "force_weight": 2.0}, "objective.*force_weight"),
        ({"motion": FilteredNoise(), "duration": 2.0}, "motion.*duration"),
        ({"motion": FilteredNoise(), "record": "napa2014_68150_hne"}, "motion.*record"),
        ({"time_compression": 2.0}, "time_compression.*record="),
    ],
)
def test_contradicting_overrides(overrides, names):
    with pytest.raises(ScenarioError, match=names):
        make_scenario("linear", overrides)


def test_uneven_specimen_is_not_changed_by_a_word():
    uneven = Specimen(masses=(1.0, 2.0), stiffnesses=(1e3, 1e3), dampings=(1.0, 1.0))
    scenario = replace(Scenario(), specimen=uneven)
    with pytest.raises(ParameterError, match="its storeys differ"):
        make_scenario(scenario, {"mass_ratio": 0.3})


def test_unknown_record():
    with pytest.raises(RecordError, match=r"record = 'kobe': known: napa2014"):
        load_record("kobe")
    with pytest.raises(RecordError, match="kobe"):
        ShakeTableEnv(record="kobe")


@pytest.mark.parametrize("value", ["strict", "", None, 3])
def test_unknown_limits(value):
    with pytest.raises(ParameterError, match=r"limits = .*known: laboratory, off"):
        make_scenario("linear", {"limits": value})


@pytest.mark.parametrize(
    "field",
    [
        "table_displacement",
        "table_velocity",
        "load_pressure",
        "table_acceleration",
        "state_limit",
        "cost_horizon",
    ],
)
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, "1"], ids=repr)
def test_limits_must_be_positive(field, value):
    with pytest.raises(ParameterError, match=f"{field} = .*above 0"):
        Limits(**{field: value})


@pytest.mark.parametrize("value", [0.99, -1.0, math.nan, math.inf, "5", None], ids=repr)
def test_limit_cost_factor(value):
    with pytest.raises(ParameterError, match=r"cost_factor = .*breaking a limit costs less"):
        Limits(cost_factor=value)


def test_state_limit_stays_within_the_observation():
    with pytest.raises(ParameterError, match=r"state_limit = 2000.0: .*1000"):
        Limits(state_limit=2e3)


@pytest.mark.parametrize("field", ["acceleration_weight", "force_weight"])
@pytest.mark.parametrize("value", [-1.0, *BAD_NUMBERS], ids=repr)
def test_weights_must_not_be_negative(field, value):
    with pytest.raises(ParameterError, match=f"{field} = .*at least 0"):
        Objective(**{field: value})


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan], ids=repr)
def test_the_current_must_cost_something(value):
    with pytest.raises(ParameterError, match=r"current_weight = .*above 0"):
        Objective(current_weight=value)


@pytest.mark.parametrize("field", ["q_1", "q_2", "r"])
@pytest.mark.parametrize("value", [-1.0, *BAD_NUMBERS], ids=repr)
def test_raw_weights(field, value):
    with pytest.raises(ParameterError, match=f"{field} = .*at least 0"):
        Objective.raw(**{"q_1": 1.0, "q_2": 1.0, "r": 1.0, field: value})


def test_an_undamped_reference_cannot_be_normalised_by():
    with pytest.raises(ParameterError, match=r"dampings = .*give the force no weight"):
        ShakeTableEnv(damping_ratio=0.0)
    env = ShakeTableEnv(damping_ratio=0.0, force_weight=0.0)
    env.reset(seed=0)
    assert math.isfinite(env.step(np.zeros(1))[1])


def test_mass_ratio_refers_to_the_scenarios_table():
    heavy = replace(Scenario(), actuator=Actuator(table_mass=360.0))
    assert make_scenario(heavy, {"mass_ratio": 0.5}).specimen.mass == pytest.approx(180.0)


def test_overrides_reach_their_place():
    scenario = make_scenario(
        "as-printed",
        {
            "stories": 4,
            "storey_frequency": 5.0,
            "control_rate": 500.0,
            "force_weight": 3.0,
            "record": "ridgecrest2019_clc_90",
            "amplitude": 0.4,
            "time_compression": 2.0,
            "highpass_frequency": 0.5,
            "current_limit": 0.025,
            "limits": "laboratory",
        },
    )
    assert scenario.name == "as-printed" and scenario.equations == ModelEquations.as_printed()
    assert scenario.specimen == Specimen.uniform(stories=4, storey_frequency=5.0)
    assert scenario.substeps == 2 and scenario.current_limit == 0.025
    assert scenario.objective == Objective(force_weight=3.0)
    assert scenario.motion == RecordedMotion(
        record="ridgecrest2019_clc_90", amplitude=0.4, time_compression=2.0
    )
    assert scenario.ground.highpass_frequency == 0.5
    assert scenario.limits == Limits.laboratory()
    back = make_scenario(scenario, {"equations": "corrected", "mass_ratio": 0.1})
    assert back.specimen == Specimen.uniform(stories=4, storey_frequency=5.0, mass_ratio=0.1)
    assert back.equations == ModelEquations()


def test_no_overrides_change_nothing():
    scenario = Scenario()
    assert make_scenario(scenario) == make_scenario("linear") == scenario
    assert make_scenario(scenario, {"stories": 2}) == scenario
