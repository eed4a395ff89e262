"""Discretisation against scipy, quadrature and Monte-Carlo."""

import itertools

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm
from scipy.signal import cont2discrete, lsim

from shake_env import GroundFilter, ModelEquations, Specimen
from shake_env.errors import NumericalError, ParameterError
from shake_env.model.discretization import (
    DiscretePlant,
    DiscreteStateSpace,
    first_order_hold,
    lift,
    noise_covariance,
    noise_factor,
    zero_order_hold,
)
from shake_env.model.parameters import Actuator
from shake_env.model.plant import CoupledPlant, StateSpace


def plant(stories=2, equations=None, highpass=None):
    return CoupledPlant(
        Actuator(),
        Specimen.uniform(stories=stories),
        GroundFilter(highpass_frequency=highpass),
        equations or ModelEquations(),
    )


def oscillator():
    """A well-conditioned model: two modes, two inputs, a real pole, feed-through."""
    rng = np.random.default_rng(5)
    A = np.array(
        [
            [0.0, 1.0, 0.0, 0.0, 0.0],
            [-9.0, -0.4, 0.5, 0.0, 0.3],
            [0.0, 0.0, 0.0, 1.0, 0.0],
            [0.6, 0.0, -30.0, -0.9, 0.0],
            [0.2, 0.0, 0.0, 0.1, -2.0],
        ]
    )
    return StateSpace(A, rng.standard_normal((5, 2)), rng.standard_normal((3, 5)), np.ones((3, 2)))


PLANTS = [
    plant(),
    plant(stories=10),
    plant(stories=5, highpass=0.5),
    plant(stories=1, equations=ModelEquations.as_printed()),
]


@pytest.mark.parametrize("p", PLANTS, ids=lambda p: f"n{p.specimen.stories}")
@pytest.mark.parametrize("dt", [1e-4, 1e-3, 5e-3])
def test_zero_order_hold_against_scipy(p, dt):
    found = zero_order_hold(p.coupled, dt, p.state_scale)
    T = p.state_scale
    scaled = (p.coupled.A * T / T[:, None], p.coupled.B / T[:, None], p.coupled.C * T, p.coupled.D)
    A, B, C, D, _ = cont2discrete(scaled, dt)
    assert np.max(np.abs(found.A * T / T[:, None] - A)) < 1e-9 * np.max(np.abs(A))
    for column in range(2):
        difference = found.B[:, column] / T - B[:, column]
        assert np.max(np.abs(difference)) < 1e-9 * np.max(np.abs(B[:, column]))
    assert np.allclose(found.C * T, C, rtol=1e-14, atol=0.0) and np.array_equal(found.D, D)
    assert found.dt == dt


def test_zero_order_hold_does_not_depend_on_the_scale():
    model = oscillator()
    plain = zero_order_hold(model, 0.1, np.ones(5))
    scaled = zero_order_hold(model, 0.1, np.array([1e-4, 3.0, 1e2, 0.7, 1e-2]))
    assert pytest.approx(plain.A, rel=1e-11, abs=1e-13) == scaled.A
    assert pytest.approx(plain.B, rel=1e-11, abs=1e-13) == scaled.B


def test_zero_order_hold_against_lsim_of_a_staircase():
    model, dt = oscillator(), 0.05
    rng = np.random.default_rng(1)
    u = rng.standard_normal((40, 2))
    found = zero_order_hold(model, dt, np.ones(5))
    x = np.zeros(5)
    for sample in u:
        x = found.A @ x + found.B @ sample
    time = dt * np.arange(41)
    _, _, states = lsim((model.A, model.B, model.C, model.D), np.vstack([u, u[-1:]]), time, interp=False)
    assert x == pytest.approx(states[-1], rel=1e-10)


def test_first_order_hold_against_scipy():
    model, dt = oscillator(), 0.1
    found, B_next = first_order_hold(model, dt, np.ones(5))
    A, B, C, D, _ = cont2discrete((model.A, model.B, model.C, model.D), dt, method="foh")
    assert pytest.approx(A, rel=1e-12, abs=1e-14) == found.A
    # scipy returns the form whose state is x - B_next u: x[j+1] = A x[j] + B u[j] + B_next u[j+1].
    assert found.A @ B_next + found.B == pytest.approx(B, rel=1e-11, abs=1e-13)
    assert model.D + model.C @ B_next == pytest.approx(D, rel=1e-11, abs=1e-13)
    assert pytest.approx(C) == found.C


@pytest.mark.parametrize("kind", ["oscillator", "plant"])
def test_first_order_hold_against_lsim(kind):
    if kind == "oscillator":
        model, scale, dt = oscillator(), np.ones(5), 0.05
    else:
        p = plant(stories=3)
        model, scale, dt = p.driven, p.state_scale[2:], 1e-3
    rng = np.random.default_rng(1)
    size = 1.0 if kind == "oscillator" else np.array([0.01, 3.0])
    u = rng.standard_normal((60, 2)) * size
    found, B_next = first_order_hold(model, dt, scale)
    x = np.zeros(model.order)
    outputs = [model.D @ u[0]]
    for now, following in itertools.pairwise(u):
        x = found.A @ x + found.B @ now + B_next @ following
        outputs.append(model.C @ x + model.D @ following)
    T = scale
    scaled = (model.A * T / T[:, None], model.B / T[:, None], model.C * T, model.D)
    _, y, states = lsim(scaled, u, dt * np.arange(60))
    assert np.max(np.abs(x / T - states[-1])) < 1e-9 * np.max(np.abs(states[-1]))
    assert np.max(np.abs(np.array(outputs) - y), axis=0) == pytest.approx(
        np.zeros(3), abs=1e-9 * np.max(np.abs(y))
    )


def test_holds_agree_on_a_constant_and_a_straight_line():
    model, dt = oscillator(), 0.2
    held = zero_order_hold(model, dt, np.ones(5))
    ramped, B_next = first_order_hold(model, dt, np.ones(5))
    assert ramped.B + B_next == pytest.approx(held.B, rel=1e-12, abs=1e-14)
    # u = t: the exact particular solution by one more integrator.
    big = np.zeros((7, 7))
    big[:5, :5], big[:5, 5] = model.A, model.B[:, 0]
    big[5, 6] = 1.0
    exact = (expm(big * dt) @ np.r_[np.zeros(6), 1.0])[:5]
    assert B_next[:, 0] * dt == pytest.approx(exact, rel=1e-11)


@pytest.mark.parametrize("p", PLANTS, ids=lambda p: f"n{p.specimen.stories}")
@pytest.mark.parametrize("dt", [1e-3, 5e-3])
def test_noise_covariance_against_quadrature(p, dt):
    T = p.state_scale
    A, B = p.coupled.A * T / T[:, None], p.coupled.B[:, 1:] / T[:, None]

    def integrand(s):
        column = expm(A * s) @ B
        return column @ column.T

    expected, _ = quad_vec(integrand, 0.0, dt, epsrel=1e-13, epsabs=0.0)
    found = noise_covariance(p.coupled.A, p.coupled.B[:, 1:], dt, T) / np.outer(T, T)
    assert np.max(np.abs(found - expected)) < 1e-9 * np.max(np.abs(expected))
    # State by state, so that the small ones count: x_w gets dt^2 less than x_w', and so on down. What
    # lies below 1e-16 of the largest is rounding (floors of the reference after one step).
    root = np.sqrt(np.diag(expected))
    seen = root > 1e-6 * root.max()
    difference = (found - expected)[np.ix_(seen, seen)]
    assert seen.sum() >= 3
    assert np.max(np.abs(difference / np.outer(root[seen], root[seen]))) < 1e-6


def test_noise_covariance_against_a_fine_step_monte_carlo():
    """200 steps a period with the noise at each one's middle, 100 000 paths."""
    model = oscillator()
    A, B = model.A, model.B[:, :1]
    dt, fine, paths = 0.5, 200, 100_000
    rng = np.random.default_rng(2009)
    h = dt / fine
    step, half = expm(A * h), expm(A * h / 2) @ B[:, 0] * np.sqrt(h)
    x = np.zeros((paths, 5))
    for _ in range(fine):
        x = x @ step.T + rng.standard_normal((paths, 1)) * half
    found = x.T @ x / paths
    exact = noise_covariance(A, B, dt, np.ones(5))
    # A sample covariance of normals has the standard error sqrt((s_ij^2 + s_ii s_jj) / paths); the
    # largest of 15 entries stays within 3.5 of it in 99.3 % of seeds. The bias, (|A| h)^2 / 24 of an
    # entry or 1e-5, is a hundredth of that.
    error = np.sqrt((exact**2 + np.outer(np.diag(exact), np.diag(exact))) / paths)
    assert np.all(np.abs(found - exact) < 3.5 * error)
    # The statistic can tell a covariance that is 1.6 % wrong.
    assert np.all(3.5 * np.diag(error) < 0.016 * np.diag(exact))


def test_noise_of_the_plant_against_a_fine_step_monte_carlo():
    """One control period of the real ground filter and reference, 64 fine steps a physics step."""
    p = plant()
    discrete = DiscretePlant(p, 1e-3, 5)
    keep = np.r_[p.layout.ground, p.layout.reference]
    T = p.state_scale[keep]
    A = p.coupled.A[np.ix_(keep, keep)] * T / T[:, None]
    B = p.coupled.B[keep, 1] / T
    rng = np.random.default_rng(11)
    fine, paths = 320, 60_000
    h = 5e-3 / fine
    step = expm(A * h)
    half = expm(A * h / 2) @ B * np.sqrt(h)  # noise at the middle of a step: bias of order h^2
    x = np.zeros((paths, len(keep)))
    for _ in range(fine):
        x = x @ step.T + rng.standard_normal((paths, 1)) * half
    found = x.T @ x / paths
    noise = discrete.lifted.state[keep, p.layout.order + 1 :] / T[:, None]
    exact = noise @ noise.T
    error = np.sqrt((exact**2 + np.outer(np.diag(exact), np.diag(exact))) / paths)
    # Small states nearly repeat larger ones, so few entries are independent; 4 errors leave 1e-3.
    seen = np.sqrt(np.diag(exact)) > 1e-6 * np.sqrt(np.max(np.diag(exact)))
    pick = np.ix_(seen, seen)
    assert seen.sum() >= 4
    assert np.all(np.abs(found - exact)[pick] < 4.0 * error[pick])


@pytest.mark.parametrize("p", PLANTS, ids=lambda p: f"n{p.specimen.stories}")
def test_noise_factor_reproduces_the_covariance(p):
    T = p.state_scale
    covariance = noise_covariance(p.coupled.A, p.coupled.B[:, 1:], 1e-3, T)
    factor = noise_factor(covariance, T)
    assert 1 <= factor.shape[1] <= p.layout.order
    difference = (factor @ factor.T - covariance) / np.outer(T, T)
    assert np.max(np.abs(difference)) < 1e-14 * np.max(np.abs(covariance / np.outer(T, T)))


def test_noise_factor_of_no_noise_and_of_nonsense():
    assert noise_factor(np.zeros((3, 3)), np.ones(3)).shape == (3, 0)
    with pytest.raises(NumericalError, match="noise covariance"):
        noise_factor(np.diag([1.0, -1e-3]), np.ones(2))


@pytest.mark.parametrize("p", PLANTS, ids=lambda p: f"n{p.specimen.stories}")
def test_two_half_steps_are_one(p):
    T, dt = p.state_scale, 2e-3
    whole, half = (zero_order_hold(p.coupled, step, T) for step in (dt, dt / 2))
    scale = np.outer(1.0 / T, T)
    A = half.A @ half.A
    assert np.max(np.abs((A - whole.A) * scale)) < 1e-12 * np.max(np.abs(whole.A * scale))
    B = half.A @ half.B + half.B
    for column in range(2):
        assert np.max(np.abs((B - whole.B)[:, column] / T)) < 1e-12 * np.max(
            np.abs(whole.B[:, column] / T)
        )
    W, w = (noise_covariance(p.coupled.A, p.coupled.B[:, 1:], step, T) for step in (dt, dt / 2))
    joined = half.A @ w @ half.A.T + w
    assert np.max(np.abs((joined - W) / np.outer(T, T))) < 1e-12 * np.max(np.abs(W / np.outer(T, T)))


@pytest.mark.parametrize("rank", [1, 3])
@pytest.mark.parametrize("with_next", [False, True])
def test_lift_against_one_step_after_the_other(rank, with_next):
    model, dt, k = oscillator(), 0.1, 7
    discrete = zero_order_hold(
        StateSpace(model.A, model.B[:, :1], model.C, np.zeros((3, 1))), dt, np.ones(5)
    )
    rng = np.random.default_rng(rank)
    disturbance = rng.standard_normal((5, rank))
    following = rng.standard_normal((5, rank)) if with_next else None
    lifted = lift(discrete, disturbance, k, following)
    samples = rng.standard_normal((k + with_next, rank))
    x = x0 = rng.standard_normal(5)
    u = 0.7
    stacked = np.concatenate([x0, [u], samples.ravel()])
    assert lifted.state.shape == (5, len(stacked)) and lifted.outputs.shape == (k, 3, len(stacked))
    for j in range(k):
        x = discrete.A @ x + discrete.B[:, 0] * u + disturbance @ samples[j]
        if following is not None:
            x = x + following @ samples[j + 1]
        assert lifted.outputs[j] @ stacked == pytest.approx(model.C @ x, rel=1e-12, abs=1e-12)
    assert lifted.state @ stacked == pytest.approx(x, rel=1e-12, abs=1e-12)


def test_lifted_covariance_is_that_of_the_whole_period():
    p = plant(stories=5)
    discrete = DiscretePlant(p, 1e-3, 5)
    noise = discrete.lifted.state[:, p.layout.order + 1 :]
    exact = noise_covariance(p.coupled.A, p.coupled.B[:, 1:], 5e-3, p.state_scale)
    scale = np.outer(p.state_scale, p.state_scale)
    assert np.max(np.abs((noise @ noise.T - exact) / scale)) < 1e-12 * np.max(np.abs(exact / scale))


@pytest.mark.parametrize("dt", [0.0, -1e-3, np.nan, np.inf])
def test_bad_step_raises_a_parameter_error(dt):
    model = oscillator()
    for attempt in (
        lambda: zero_order_hold(model, dt, np.ones(5)),
        lambda: first_order_hold(model, dt, np.ones(5)),
        lambda: noise_covariance(model.A, model.B, dt, np.ones(5)),
        lambda: DiscreteStateSpace(model.A, model.B, model.C, model.D, dt),
        lambda: DiscretePlant(plant(), dt, 5),
    ):
        with pytest.raises(ParameterError, match=r"dt = .*above 0 s"):
            attempt()


def test_bad_substeps_raise_a_parameter_error():
    with pytest.raises(ParameterError, match=r"substeps = 0: must be a whole number"):
        DiscretePlant(plant(), 1e-3, 0)
