"""Extreme scenarios: they build, reset and step with finite numbers, or raise a ShakeError."""

import math
import tracemalloc
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from shake_env import (
    RECORD_NAMES,
    Actuator,
    Envelope,
    FilteredNoise,
    Friction,
    GroundFilter,
    Limits,
    Nonlinearity,
    Objective,
    RecordedMotion,
    Scenario,
    Sensing,
    Sensor,
    ServoValve,
    ShakeTableEnv,
    ShakeTableVectorEnv,
    Specimen,
    StrokeStops,
    Yielding,
    make_scenario,
)
from shake_env.errors import NumericalError, ParameterError, ScenarioError, ShakeError
from shake_env.model.ranges import RANGES
from shake_env.simulation.memory import memory_needed
from shake_env.simulation.simulation import Simulation

# Class to one that is made of the fields of the table, beside what it needs anyway.
KINDS = {
    "Actuator": Actuator,
    "Specimen.uniform": Specimen.uniform,
    "GroundFilter": GroundFilter,
    "Envelope": Envelope,
    "FilteredNoise": FilteredNoise,
    "Objective": Objective,
    "Objective.raw": lambda **values: Objective.raw(**{"q_1": 1.0, "q_2": 1.0, **values}),
    "Limits": Limits,
    "Friction": Friction,
    "ServoValve": ServoValve,
    "StrokeStops": StrokeStops,
    "Yielding": Yielding,
    "Scenario": Scenario,
    "Sensor": lambda **values: Sensor(signal="base_shear", **values),
    "RecordedMotion": lambda **values: RecordedMotion(
        **{"record": RECORD_NAMES[0], "highpass_frequency": None, **values}
    ),
}
SENSORS = tuple(Sensor(signal="table_velocity", noise=0.01) for _ in range(1))


@pytest.mark.parametrize("kind", KINDS)
def test_every_field_is_held_against_its_range(kind):
    for field, allowed in RANGES[kind].items():
        outside = [-1.0, -math.inf, math.nan, "1", 1j, True, [1.0]]
        outside += [] if allowed.low == 0 else [allowed.low * 0.999, 5e-324]
        if allowed.high < math.inf:
            outside += [allowed.high * 1.001 + 1, math.inf, 10**400, 10**5000]
        outside += [] if allowed.optional else [None]
        for value in outside:
            with pytest.raises(ParameterError) as caught:
                KINDS[kind](**{field: value})
            assert caught.value.field == field
            assert (
                f"{allowed.high:g}" in caught.value.remedy
                or "Hz" in caught.value.remedy
                or (field in ("cost_factor", "static"))
            )


def test_the_table_of_ranges_names_every_number():
    """A field that is added to a part needs a range."""
    from dataclasses import fields

    for kind in (Actuator, Friction, ServoValve, StrokeStops, Yielding, Limits, Objective, Envelope):
        numeric = {f.name for f in fields(kind)} - {"normalised", "soft_share"}
        assert set(RANGES[kind.__name__]) == numeric


@pytest.mark.parametrize(
    "overrides",
    [
        {"mass_ratio": 1e6},
        {"mass_ratio": 5e-324},
        {"damping_ratio": 1e9},
        {"damping_ratio": 5e-324},
        {"highpass_frequency": 1e9},
        {"control_rate": 0.1},
        {"physics_step": 1e-9},
        {"amplitude": 1e300},
        {"stories": 2**31},
        {"stories": 10**400},
        {"duration": 1e300},
        {"delay": 1e12},
        {"current_limit": 1e300},
        {"fields": {"sensing.preview": 1e9}},
        {"fields": {"uncertainty.mass_ratio": [0.0, 1.0]}},
        {"fields": {"uncertainty.mass_ratio": ["a", 1.0]}},
        {"fields": {"specimen.masses": list(range(1, 1000))}},
        {"fields": {"specimen.masses": "12"}},
        {"fields": {"actuator.valve_time_constant": 1e-5}},
    ],
    ids=str,
)
def test_values_out_of_range_are_refused_by_name(overrides):
    with pytest.raises(ShakeError):
        make_scenario("laboratory", overrides)


def ends(allowed):
    """Values of a range, mostly near its ends."""
    low, high = math.log(max(allowed.low, 1e-30)), math.log(min(max(allowed.high, 1e-30), 1e300))
    inner = st.floats(low, high).map(lambda e: min(max(math.exp(e), allowed.low), allowed.high))
    values = [st.sampled_from([allowed.low, allowed.high]), inner]
    values += [st.just(0.0)] * allowed.zero
    values += [st.none()] * allowed.optional
    return st.one_of(values)


def extreme(kind, most=3):
    """Up to `most` fields of a part, the others as they are."""
    table = RANGES[kind]
    return st.lists(st.sampled_from(sorted(table)), max_size=most, unique=True).flatmap(
        lambda names: st.fixed_dictionaries({name: ends(table[name]) for name in names})
    )


@st.composite
def scenarios(draw):
    actuator = Actuator(**draw(extreme("Actuator")))
    uniform = draw(extreme("Specimen.uniform", 2))
    uniform["stories"] = draw(st.sampled_from([1, 2, 3, 12]))
    parts = {"table_mass": actuator.table_mass, **uniform}
    step = draw(st.sampled_from([1e-3, 1e-3, 1e-5, 5e-3, 0.1]))
    nonlinear = draw(st.booleans())
    return Scenario(
        actuator=actuator,
        specimen=Specimen.uniform(**parts),
        ground=GroundFilter(**draw(extreme("GroundFilter", 2))),
        motion=FilteredNoise(duration=draw(st.sampled_from([0.5, 1e5])), amplitude=draw(ends(
            RANGES["FilteredNoise"]["amplitude"]))),
        objective=Objective(**draw(extreme("Objective", 1))),
        limits=Limits(**draw(extreme("Limits", 2))),
        nonlinearity=Nonlinearity(
            friction=Friction(coulomb=draw(ends(RANGES["Friction"]["coulomb"]))),
            valve=ServoValve(**draw(extreme("ServoValve", 2))),
            stops=StrokeStops(**draw(extreme("StrokeStops", 2))),
            yielding=Yielding(**draw(extreme("Yielding", 2))),
        ) if nonlinear else Nonlinearity(),
        physics_step=step,
        control_rate=1.0 / (step * draw(st.sampled_from([1, 5]))),
        current_limit=draw(ends(RANGES["Scenario"]["current_limit"])),
        sensing=Sensing(sensors=SENSORS, history=draw(st.sampled_from([0, 3])))
        if draw(st.booleans()) else Sensing(),
    )  # fmt: skip


BUILT = []


@settings(
    max_examples=40, deadline=None, derandomize=True, database=None,
    suppress_health_check=list(HealthCheck),
)  # fmt: skip
@given(st.data())
def check_random_scenarios(data):
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            scenario = data.draw(scenarios())
            env = ShakeTableEnv(scenario)
            observation, _ = env.reset(seed=0)
            assert np.isfinite(observation).all()
            for action in (1.0, -1.0, 0.5):
                observation, reward, terminated, truncated, info = env.step(np.array([action]))
                assert np.isfinite(observation).all() and math.isfinite(reward)
                if terminated or truncated:
                    break
                assert all(math.isfinite(value) for value in info.values())
        except ShakeError as error:
            BUILT.append(type(error))
        else:
            BUILT.append(None)


def test_random_scenarios_step_with_finite_numbers_or_say_what_is_wrong():
    BUILT.clear()
    check_random_scenarios()
    # The test would say nothing if none were built, or none refused.
    assert BUILT.count(None) >= 10 and len(set(BUILT)) >= 2
    assert set(BUILT) <= {None, ParameterError, ScenarioError, NumericalError}


def test_memory_is_estimated_before_it_is_taken():
    with pytest.raises(ScenarioError, match=r"memory = '.* GiB': .*num_envs \(10000000\)"):
        ShakeTableVectorEnv(10_000_000)
    with pytest.raises(ScenarioError, match="memory"):
        ShakeTableVectorEnv(1000, "unknown-specimen", stories=200)
    with pytest.raises(ParameterError, match="num_envs"):
        ShakeTableVectorEnv(10**9)


@pytest.mark.parametrize(
    ("name", "lanes", "overrides"),
    [
        ("linear", 2048, {}),
        ("linear", 1, {"stories": 60}),
        ("laboratory", 256, {"fields": {"sensing.history": 300}}),
        ("unknown-specimen", 128, {}),
        ("linear", 1, {"control_rate": 2.0}),
    ],
)
def test_the_estimate_is_near_what_is_taken(name, lanes, overrides):
    scenario = make_scenario(name, overrides)
    Simulation(replace(scenario), 1)  # what is compiled or imported once is not the scenario's
    tracemalloc.start()
    try:
        simulation = Simulation(scenario, lanes)
        simulation.start(range(lanes), [np.random.default_rng(i) for i in range(lanes)])
        simulation.step(np.zeros(lanes))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert 0.7 * peak < memory_needed(scenario, lanes) < 4.0 * peak
