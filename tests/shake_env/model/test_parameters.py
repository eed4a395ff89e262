"""Bad input: a typed error that names field, value and remedy. Good input: frozen, with what follows."""

import math
import pickle
from dataclasses import FrozenInstanceError, fields, replace

import numpy as np
import pytest
from bad_values import BAD_NUMBERS

from shake_env import (
    Actuator,
    Envelope,
    FilteredNoise,
    GroundFilter,
    Limits,
    ModelEquations,
    Objective,
    RecordedMotion,
    Scenario,
    Specimen,
)
from shake_env.errors import (
    ActionError,
    NumericalError,
    ParameterError,
    PolicyFileError,
    RecordError,
    RunDirectoryError,
    ScenarioError,
    ShakeError,
)

POSITIVE = [
    "table_mass",
    "piston_area",
    "oil_volume",
    "bulk_modulus",
    "flow_gain",
    "valve_gain",
    "valve_time_constant",
]


def names_three_parts(error, field, value):
    """The message names what is wrong, what was found and what would be right."""
    message = str(error)
    return field in message and repr(value) in message and len(error.remedy) > 5


@pytest.mark.parametrize("field", POSITIVE)
@pytest.mark.parametrize("value", [0.0, -1.0, *BAD_NUMBERS], ids=repr)
def test_actuator_values_must_be_positive(field, value):
    with pytest.raises(ParameterError, match="above 0") as caught:
        Actuator(**{field: value})
    assert caught.value.field == field and names_three_parts(caught.value, field, value)


@pytest.mark.parametrize("field", ["table_damping", "table_stiffness", "leakage"])
@pytest.mark.parametrize("value", [-1e-20, *BAD_NUMBERS], ids=repr)
def test_actuator_values_that_may_be_zero(field, value):
    assert getattr(Actuator(**{field: 0.0}), field) == 0.0
    with pytest.raises(ParameterError, match="at least 0") as caught:
        Actuator(**{field: value})
    assert names_three_parts(caught.value, field, value)


def test_every_actuator_field_is_checked():
    checked = {*POSITIVE, "table_damping", "table_stiffness", "leakage"}
    assert {f.name for f in fields(Actuator)} == checked


@pytest.mark.parametrize("field", ["masses", "stiffnesses", "dampings"])
@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf], ids=repr)
def test_storey_values(field, value):
    good = {"masses": (1.0, 2.0), "stiffnesses": (3.0, 4.0), "dampings": (0.0, 0.1)}
    with pytest.raises(ParameterError) as caught:
        Specimen(**{**good, field: (1.0, value)})
    assert names_three_parts(caught.value, f"{field}[storey 2]", value)


def test_only_damping_may_be_zero():
    for field in ("masses", "stiffnesses"):
        with pytest.raises(ParameterError, match=rf"{field}\[storey 1\] = 0.0: .*above 0"):
            Specimen(**{"masses": (1,), "stiffnesses": (1,), "dampings": (0,), field: (0.0,)})


@pytest.mark.parametrize(
    ("masses", "stiffnesses", "dampings"),
    [((1, 2), (1,), (1, 2)), ((1,), (1, 2), (1,)), ((1, 2), (1, 2), ()), ((), (), ())],
)
def test_storeys_must_match(masses, stiffnesses, dampings):
    with pytest.raises(ParameterError, match="same number of storeys") as caught:
        Specimen(masses=masses, stiffnesses=stiffnesses, dampings=dampings)
    assert caught.value.value == (len(masses), len(stiffnesses), len(dampings))


@pytest.mark.parametrize("values", [5.0, None, "ab", ((1.0, 2.0),)], ids=repr)
def test_storeys_must_be_numbers(values):
    with pytest.raises(ParameterError, match=r"masses = .*sequence of numbers"):
        Specimen(masses=values, stiffnesses=(1.0,), dampings=(1.0,))


@pytest.mark.parametrize("value", [0, -1, 2.0, 2.5, True, None, "2", math.nan], ids=repr)
def test_stories_must_be_a_whole_number(value):
    with pytest.raises(ParameterError, match=r"stories = .*whole number of at least 1"):
        Specimen.uniform(stories=value)


@pytest.mark.parametrize("field", ["mass_ratio", "storey_frequency", "table_mass"])
@pytest.mark.parametrize("value", [0.0, -0.5, *BAD_NUMBERS], ids=repr)
def test_uniform_values_must_be_positive(field, value):
    with pytest.raises(ParameterError, match="above 0") as caught:
        Specimen.uniform(**{field: value})
    assert names_three_parts(caught.value, field, value)


def test_uniform_damping_may_be_zero_but_not_less():
    assert Specimen.uniform(damping_ratio=0.0).dampings == (0.0, 0.0)
    with pytest.raises(ParameterError, match=r"damping_ratio = -0.1: .*at least 0"):
        Specimen.uniform(damping_ratio=-0.1)


@pytest.mark.parametrize(
    "field", ["frequency", "damping_ratio", "highpass_frequency", "highpass_damping_ratio"]
)
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, "1"], ids=repr)
def test_ground_filter(field, value):
    with pytest.raises(ParameterError, match=f"{field} = .*above 0"):
        GroundFilter(**{field: value})


@pytest.mark.parametrize("field", [f.name for f in fields(ModelEquations)])
def test_equations_are_switches(field):
    with pytest.raises(ParameterError, match=f"{field} = 1: must be True or False"):
        ModelEquations(**{field: 1})


@pytest.mark.parametrize(
    "value",
    [
        Actuator(),
        Specimen.uniform(),
        GroundFilter(),
        ModelEquations(),
        Limits(),
        Objective(),
        FilteredNoise(),
        Envelope(),
        RecordedMotion(record="napa2014_68150_hne"),
        Scenario(),
    ],
    ids=lambda v: type(v).__name__,
)
def test_values_are_frozen_hashable_and_survive_pickling(value):
    name = fields(value)[0].name
    with pytest.raises(FrozenInstanceError):
        setattr(value, name, getattr(value, name))
    assert hash(value) == hash(replace(value))
    again = pickle.loads(pickle.dumps(value))
    assert again == value and hash(again) == hash(value)


def test_positions_are_not_accepted():
    for kind in (Actuator, Specimen, GroundFilter, Limits, Objective, FilteredNoise, Scenario):
        with pytest.raises(TypeError, match="positional"):
            kind(1.0)


def test_a_caller_cannot_change_a_specimen_through_its_array():
    masses = np.array([10.0, 20.0])
    specimen = Specimen(masses=masses, stiffnesses=[1e3, 1e3], dampings=[1.0, 1.0])
    masses[0] = 99.0
    assert specimen.masses == (10.0, 20.0)


def test_table_one():
    a = Actuator()
    assert (a.table_damping, a.table_mass, a.table_stiffness) == (1000.0, 180.0, 0.0)
    assert (a.piston_area, a.oil_volume, a.bulk_modulus) == (0.00237, 0.00036, 1.4e8)
    assert (a.leakage, a.flow_gain, a.valve_gain) == (1e-16, 76.0, 5e-4)
    assert a.valve_time_constant == 0.010
    g = GroundFilter()
    assert (g.frequency, g.damping_ratio, g.highpass_frequency) == (1.1, 1.4, None)
    assert g.omega == pytest.approx(6.911503837897545, rel=1e-15)
    # SPEC 3: the paper's text says 30 Hz and 1 %.
    assert a.oil_column_frequency == pytest.approx(35.07, abs=5e-3)
    assert a.oil_column_damping == pytest.approx(0.0126, abs=5e-5)
    assert a.oil_stiffness == pytest.approx(4 * 1.4e8 * 0.00237**2 / 0.00036, rel=1e-15)


@pytest.mark.parametrize("stories", [1, 2, 5, 10])
def test_uniform_specimen(stories):
    s = Specimen.uniform(stories=stories, mass_ratio=0.2)
    m = 0.2 * 180.0 / stories
    k = (2 * math.pi * 7.0) ** 2 * m
    assert s.stories == stories
    assert s.masses == pytest.approx((m,) * stories, rel=1e-15)
    assert s.stiffnesses == pytest.approx((k,) * stories, rel=1e-15)
    assert s.dampings == pytest.approx((2 * 0.05 * math.sqrt(m * k),) * stories, rel=1e-15)
    assert s.mass == pytest.approx(36.0, rel=1e-15)
    # k T: 2 on the diagonal, 1 at the roof, -1 beside it.
    T = s.stiffness_matrix / k
    expected = 2 * np.eye(stories) - np.eye(stories, k=1) - np.eye(stories, k=-1)
    expected[-1, -1] = 1.0
    assert pytest.approx(expected, abs=1e-14) == T
    assert s.damping_matrix / s.dampings[0] == pytest.approx(expected, abs=1e-14)
    assert np.array_equal(s.mass_matrix, np.diag(s.masses))
    modes = np.arange(1, stories + 1)
    exact = 14.0 * np.sin(math.pi * (2 * modes - 1) / (2 * (2 * stories + 1)))
    assert s.fixed_base_frequencies == pytest.approx(exact, rel=1e-10)


@pytest.mark.parametrize(
    "kind",
    [
        ActionError,
        NumericalError,
        ParameterError,
        PolicyFileError,
        RecordError,
        RunDirectoryError,
        ScenarioError,
    ],
)
def test_errors_have_one_base_and_survive_pickling(kind):
    error = kind("field", 3.5, "use another")
    assert isinstance(error, ShakeError) and isinstance(error, ValueError)
    assert str(error) == "field = 3.5: use another"
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind
    assert (again.field, again.value, again.remedy) == ("field", 3.5, "use another")
