"""Plants made by compiled small matrices equal those that arrays make, which stay the reference."""

import math
from fractions import Fraction

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from shake_env import make_scenario
from shake_env.dynamics.nonlinear import controlled_plant, controlled_scale
from shake_env.errors import ScenarioError
from shake_env.model.nonlinearity import Friction, Nonlinearity, ServoValve, Yielding
from shake_env.model.plant import stationary_covariance
from shake_env.scenario.observation import Sensing, Sensor
from shake_env.scenario.uncertainty import Uncertainty, Uniform
from shake_env.simulation.plant_batch import PlantBatch

small = pytest.importorskip("shake_env.kernels.small_matrices")

SENSORS = tuple(
    Sensor(signal=name, lowpass_frequency=frequency)
    for name, frequency in (
        ("load_pressure", 60.0),
        ("table_acceleration", 80.0),
        ("base_shear", 40.0),
        ("floor_accelerations", 90.0),
    )
)


def scenario(stories, second_order, yields, highpass, sensors, directions):
    spread = {
        "mass_ratio": Uniform(0.1, 1.0), "storey_frequency": Uniform(3.0, 12.0),
        "damping_ratio": Uniform(0.001, 0.08), "bulk_modulus": Uniform(0.8e8, 1.6e8),
        "leakage": Uniform(1e-16, 1e-11), "valve_gain": Uniform(4e-4, 6e-4),
        "table_mass": Uniform(150.0, 200.0), "storey_factor": Uniform(0.8, 1.2),
        "delay": Uniform(0.0, 6.0), "supply_pressure": Uniform(15e6, 21e6),
    }  # fmt: skip
    name = "valve_natural_frequency" if second_order else "valve_time_constant"
    spread[name] = Uniform(40.0, 80.0) if second_order else Uniform(0.005, 0.02)
    parts = Nonlinearity(
        friction=Friction(coulomb=100.0),
        valve=ServoValve(
            supply_pressure=21e6, natural_frequency=60.0 if second_order else None, damping_ratio=0.9
        ),
        yielding=Yielding(yield_drift=0.006) if yields else Yielding(),
    )
    fields = {"noise_directions": directions}
    return make_scenario(
        "linear",
        {
            "stories": stories, "nonlinearity": parts, "highpass_frequency": highpass,
            "uncertainty": Uncertainty(**spread), "sensing": Sensing(sensors=sensors), "fields": fields,
        },
    )  # fmt: skip


@settings(max_examples=12, deadline=None)
@given(
    stories=st.integers(1, 5),
    second_order=st.booleans(),
    yields=st.booleans(),
    highpass=st.sampled_from([None, 0.2, 0.5]),
    sensors=st.sampled_from([None, SENSORS[:1], SENSORS]),
    directions=st.sampled_from([1, 2, None]),
    seed=st.integers(0, 1000),
)
def test_every_matrix_is_the_one_that_arrays_make(
    stories, second_order, yields, highpass, sensors, directions, seed
):
    given = scenario(stories, second_order, yields, highpass, sensors, directions)
    batch, reference = PlantBatch(given, 3), PlantBatch(given, 3)
    assert batch._compiled is not None
    reference._compiled = None
    for each in (batch, reference):
        each.sample([2, 0], [np.random.default_rng((seed, i)) for i in range(2)])
    ours, theirs = batch._stacks(), reference._stacks()
    low_passes = given.observation.low_passes
    for lane in (2, 0):
        true = batch.plants[lane]
        scale = controlled_scale(true.plant, true.parts, low_passes)
        size = {"plant_dynamics_advance": np.concatenate([1.0 / scale, np.ones(4 + stories * yields)])}
        for name, expected in theirs.items():
            found, wanted = ours[name][lane], expected[lane]
            if name in ("plant_dynamics_advance", "plant_dynamics_slope"):
                # Its small entries beside a current's 2.5e5 have ten digits in the reference.
                columns = size.get(name, 1.0)
                found, wanted = (part / scale[:, None] / columns for part in (found, wanted))
                norm = np.maximum(np.abs(wanted).max(axis=0), 1.0)
                assert (np.abs(found - wanted) <= 1e-12 * norm).all(), name
            elif name == "plant_noise":
                norm = np.linalg.norm(wanted, axis=1, keepdims=True)
                few = directions is not None  # rounding is all that the last of six directions are
                np.testing.assert_allclose(found / norm, wanted / norm, 0, 1e-11 if few else 1e-7)
            else:
                np.testing.assert_allclose(found, wanted, rtol=1e-11, atol=1e-13, err_msg=name)
    assert ours["plant_noise"][1].any() and (ours["plant_noise"][1] == theirs["plant_noise"][1]).all()


def exactly(generator):
    """Return the exponential of a matrix by its series, in fractions of 200 bits."""

    def short(value):
        return Fraction(round(value * 2**200), 2**200)

    n = len(generator)
    entries = [[Fraction(float(value)) for value in row] for row in generator]
    power = [[Fraction(int(i == j)) for j in range(n)] for i in range(n)]
    total = [row[:] for row in power]
    for order in range(1, 40):
        power = [
            [
                short(
                    sum((a * power[k][j] for k, a in enumerate(row) if a and power[k][j]), Fraction(0))
                )
                / order
                for j in range(n)
            ]
            for row in entries
        ]
        total = [[a + b for a, b in zip(*rows, strict=True)] for rows in zip(total, power, strict=True)]
    return np.array([[float(value) for value in row] for row in total])


def test_the_held_table_is_exact_where_scipy_loses_six_digits():
    """An input's large entry, which no power of the matrix repeats, calls for no squaring."""
    given = make_scenario("unknown-specimen")
    plant = controlled_plant(given.plant, given.parts, given.observation.low_passes)
    scale = controlled_scale(given.plant, given.parts, given.observation.low_passes)
    n, inputs = plant.B.shape
    generator = np.zeros((n + 2 * inputs, n + 2 * inputs))
    generator[:n, :n] = plant.A * scale / scale[:, None] * 1e-3
    generator[:n, n : n + inputs] = plant.B / scale[:, None] * 1e-3
    generator[n : n + inputs, n + inputs :] = np.eye(inputs)
    exact = exactly(generator)
    moved, level, slope = small.hold(plant.A.copy(), plant.B.copy(), scale, 1e-3)
    found = np.concatenate([moved * scale, level, slope], axis=1) / scale[:, None]
    np.testing.assert_allclose(found, exact[:n], rtol=2e-14, atol=0)
    by_scipy = scipy.linalg.expm(generator)
    away = np.abs(by_scipy - exact)[exact != 0.0] / np.abs(exact[exact != 0.0])
    assert 1e-11 < away.max() < 1e-8  # the reason for the tolerance above


def test_stationary_covariances_are_those_of_a_schur_decomposition():
    rng = np.random.default_rng(1)
    A, b = rng.normal(size=(9, 8, 8)), rng.normal(size=(9, 8))
    A -= (1e-3 + np.linalg.eigvals(A).real.max(axis=1))[:, None, None] * np.eye(
        8
    )  # slow beside the rest
    found = np.empty_like(A)
    for each in range(9):
        small.stationary_covariance(A[each], b[each], found[each])
    expected = stationary_covariance(A, b[..., None])
    size = np.abs(expected).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(found / size, expected / size, rtol=0, atol=1e-11)
    for each in range(9):
        small.stationary_covariance(-A[each], b[each], found[each])  # unstable: there is none
    assert np.isnan(found).any(axis=(1, 2)).all()


def test_what_is_unsound_is_refused_as_the_reference_refuses_it():
    """A drawn plant that the physics step does not resolve names the field."""
    fast = Uncertainty(storey_frequency=Uniform(900.0, 900.0))
    given = make_scenario("linear", {"uncertainty": fast, "physics_step": 1e-3, "control_rate": 200.0})
    batch = PlantBatch(given, 1)
    with pytest.raises(ScenarioError, match="stiffnesses"):
        batch.sample([0], [np.random.default_rng(0)])
    assert batch.plants == [given] and math.isfinite(batch._noise.sum())
