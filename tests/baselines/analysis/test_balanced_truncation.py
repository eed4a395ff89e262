import control
import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov, solve_sylvester

from agents.studies.reproduction.tables import WEIGHTS, table_plant
from baselines.analysis.balanced_truncation import (
    balanced_truncation,
    gain_curve,
    gramian_factor,
    h_infinity_norm,
    hankel_singular_values,
    order_within,
)
from baselines.analysis.closed_loop import CURRENT, ERRORS, closed_loop
from baselines.analysis.h2 import h2_lyapunov, tracking_response
from baselines.lqr.continuous import continuous_lqr
from shake_env.errors import NumericalError, ParameterError
from shake_env.model.plant import StateSpace

ROUNDING = 3e-10  # of the closed loop's norm: what poles of 1e-6 and 2e5 rad/s leave of sixteen digits


def random_system(seed, n=9, inputs=2, outputs=3):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A -= (np.max(np.linalg.eigvals(A).real) + rng.uniform(0.05, 1.0)) * np.eye(n)
    D = rng.normal(size=(outputs, inputs))
    return StateSpace(A, rng.normal(size=(n, inputs)), rng.normal(size=(outputs, n)), D)


@pytest.fixture(scope="module")
def loops():
    found = {}
    for table, stories, mass_ratio in (
        ("II", 2, 0.5),
        ("III", 2, 0.5),
        ("II", 10, 0.1),
        ("III", 5, 0.2),
    ):
        plant = table_plant(stories, mass_ratio)
        q_1, q_2 = WEIGHTS[table]
        gain = continuous_lqr(plant, q_1=q_1, q_2=q_2).gain
        found[table, stories] = closed_loop(plant, gain), gain
    return found


CASES = [("II", 2), ("III", 2), ("II", 10), ("III", 5)]


def without_current(loop):
    return loop.scaled(tuple(name for name in loop.outputs if name != CURRENT))


@pytest.mark.parametrize("seed", range(4))
def test_gramian_factor_solves_the_lyapunov_equation(seed):
    s = random_system(seed)
    factor = gramian_factor(s.A, s.B)
    np.testing.assert_allclose(
        factor @ factor.T, solve_continuous_lyapunov(s.A, -s.B @ s.B.T), rtol=1e-9, atol=1e-10
    )


def test_gramian_factor_of_a_mode_that_is_not_excited():
    A = np.diag([-1.0, -2.0, -3.0])
    factor = gramian_factor(A, np.array([[1.0], [0.0], [1.0]]))
    np.testing.assert_allclose((factor @ factor.T)[1], 0.0, atol=1e-15)
    np.testing.assert_allclose((factor @ factor.T)[0, 2], 1.0 / 4.0)


@pytest.mark.parametrize("seed", range(4))
def test_hankel_singular_values_are_the_roots_of_the_gramians_product(seed):
    s = random_system(seed)
    W_c = solve_continuous_lyapunov(s.A, -s.B @ s.B.T)
    W_o = solve_continuous_lyapunov(s.A.T, -s.C.T @ s.C)
    expected = np.sqrt(np.sort(np.linalg.eigvals(W_c @ W_o).real)[::-1])
    # The product's eigenvalues are exact to rounding of the largest, so that a root sigma is known to
    # eps sigma_1^2 / sigma only: half the digits are lost where sigma is small.
    rounding = 10.0 * np.finfo(float).eps * expected[0] ** 2 / expected
    assert np.all(np.abs(hankel_singular_values(s) - expected) <= rounding)


def test_hankel_singular_values_of_one_closed_loop_by_the_cross_gramian(loops):
    # For one input and one output the eigenvalues of the cross Gramian are the Hankel values up to sign:
    # a third equation, and one whose small values are not squared.
    loop, _ = loops["II", 2]
    s = loop.scaled(("table_acceleration",))
    cross = solve_sylvester(s.A, s.A, -s.B @ s.C)
    expected = np.sort(np.abs(np.linalg.eigvals(cross)))[::-1]
    np.testing.assert_allclose(hankel_singular_values(s)[:6], expected[:6], rtol=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_h_infinity_norm_equals_python_controls_bisection(seed):
    s = random_system(seed, inputs=2, outputs=2)  # python-control 0.10.2 takes square models only
    expected = control.system_norm(control.ss(s.A, s.B, s.C, s.D), p="inf", tol=1e-9)
    assert h_infinity_norm(s)[0] == pytest.approx(expected, rel=1e-6)


def test_h_infinity_norm_finds_a_resonance_between_grid_points():
    zeta, omega = 1e-6, 3.3333
    s = StateSpace(
        np.array([[0.0, 1.0], [-(omega**2), -2.0 * zeta * omega]]),
        np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 1)),
    )  # fmt: skip
    value, where = h_infinity_norm(s)
    assert value == pytest.approx(1.0 / (2.0 * zeta * omega**2 * np.sqrt(1.0 - zeta**2)), rel=1e-6)
    assert where == pytest.approx(omega, rel=1e-5)


@pytest.mark.parametrize("match", ["high", "low"])
@pytest.mark.parametrize("seed", range(3))
def test_error_within_the_bound_at_every_order(seed, match):
    s = random_system(seed)
    for order in range(1, s.order):
        found = balanced_truncation(s, order, match)
        error, _ = h_infinity_norm(s, found.system)
        assert error <= found.error_bound * (1.0 + 1e-9)
        # No model of this order can be nearer than the first value that was left out.
        assert error >= found.hankel_singular_values[order] * (1.0 - 1e-9)
        assert np.max(np.linalg.eigvals(found.system.A).real) < 0.0


@pytest.mark.parametrize("order", [1, 2, 4])
def test_the_bound_is_reached_by_symmetric_systems(order):
    # A = A' < 0 and C = B': cutting off errs by exactly twice the sum at frequency zero (Liu, Sreeram
    # and Teo, Systems & Control Letters 33, 1998).
    b = np.array([[1.0, 2.0, 0.5, 1.5, 3.0]]).T
    s = StateSpace(np.diag([-0.1, -1.0, -3.0, -20.0, -100.0]), b, b.T, np.zeros((1, 1)))
    found = balanced_truncation(s, order)
    assert h_infinity_norm(s, found.system)[0] == pytest.approx(found.error_bound, rel=1e-5)


def test_what_each_kind_of_reduction_keeps():
    s = random_system(7)
    high = balanced_truncation(s, 4, "high").system
    low = balanced_truncation(s, 4, "low").system
    np.testing.assert_array_equal(high.D, s.D)
    zero = np.array([0.0])
    np.testing.assert_allclose(low.frequency_response(zero), s.frequency_response(zero), rtol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_hankel_singular_values_do_not_depend_on_the_states(seed):
    s = random_system(seed)
    T = np.random.default_rng(seed + 100).normal(size=s.A.shape)
    inverse = np.linalg.inv(T)
    moved = StateSpace(T @ s.A @ inverse, T @ s.B, s.C @ inverse, s.D)
    np.testing.assert_allclose(hankel_singular_values(moved), hankel_singular_values(s), rtol=1e-8)


def test_full_order_reproduces_the_transfer_function():
    s = random_system(3)
    omega = np.logspace(-3, 3, 200)
    for match in ("high", "low"):
        same = balanced_truncation(s, s.order, match)
        assert same.error_bound == 0.0
        assert np.max(gain_curve(s, omega, same.system)) < 1e-10 * h_infinity_norm(s)[0]


def test_order_within():
    values = np.array([4.0, 2.0, 1.0, 0.5])
    assert [order_within(values, b) for b in (0.0, 0.99, 1.0, 3.0, 7.0, 100.0)] == [4, 4, 3, 2, 1, 1]


# --- closed loops with the paper's weights


@pytest.mark.parametrize("case", CASES)
def test_closed_loop_has_the_known_transfer_functions_and_norms(loops, case):
    loop, gain = loops[case]
    omega = np.logspace(-3, 6, 60)
    known = np.abs(tracking_response(loop.plant, gain, omega))
    sizes = loop.sizes[:2]
    for i, name in enumerate(ERRORS):
        mine = gain_curve(loop.scaled((name,)), omega) * sizes[i]
        np.testing.assert_allclose(mine, known[:, i], rtol=1e-5, atol=1e-10 * sizes[i])
    factor = gramian_factor(loop.system.A, loop.system.B)
    squares = np.sum((loop.system.C[:2] @ factor) ** 2, axis=1)
    norms = h2_lyapunov(loop.plant, gain)
    np.testing.assert_allclose(squares, [norms.acceleration, norms.base_shear], rtol=1e-6, atol=1e-10)


@pytest.mark.parametrize("case", CASES)
def test_closed_loop_error_within_the_bound_and_the_fast_poles_dropped(loops, case):
    loop, _ = loops[case]
    full = without_current(loop)
    norm, _ = h_infinity_norm(full)
    chosen = order_within(hankel_singular_values(full), 2e-3 * norm)
    for order in (2, 4, chosen):
        for match in ("high", "low"):
            found = balanced_truncation(full, order, match)
            error, _ = h_infinity_norm(full, found.system)
            assert error <= found.error_bound + ROUNDING * norm
            assert np.max(np.linalg.eigvals(found.system.A).real) < 0.0
    assert chosen < loop.system.order
    assert np.abs(loop.poles[0]) > 1e4
    assert np.max(np.abs(np.linalg.eigvals(found.system.A))) < 200.0


@pytest.mark.parametrize("case", CASES[:2])
def test_small_hankel_values_of_a_closed_loop_do_not_depend_on_the_states(loops, case):
    # Products of Gramians lose everything below 1e-8 of the largest; the factors do not.
    full = without_current(loops[case][0])
    values = hankel_singular_values(full)
    other = balanced_truncation(full, int(np.sum(values > 1e-7 * values[0]))).system
    again = hankel_singular_values(other)
    np.testing.assert_allclose(again, values[: len(again)], rtol=1e-5)


def test_the_current_cannot_be_reduced(loops):
    # The fast pair carries the current: its Hankel values stay near the largest.
    loop, _ = loops["II", 2]
    assert hankel_singular_values(loop.scaled())[6] > 0.05
    assert hankel_singular_values(without_current(loop))[7] < 1e-3


def test_errors():
    s = random_system(0)
    for order in (0, s.order + 1):
        with pytest.raises(ParameterError, match="order"):
            balanced_truncation(s, order)
    unstable = StateSpace(s.A + 10.0 * np.eye(s.order), s.B, s.C, s.D)
    with pytest.raises(NumericalError, match="stable"):
        hankel_singular_values(unstable)
    unseen = StateSpace(
        np.diag([-1.0, -2.0]), np.array([[1.0], [0.0]]), np.ones((1, 2)), np.zeros((1, 1))
    )
    with pytest.raises(NumericalError, match="order"):
        balanced_truncation(unseen, 2)
    plant = table_plant(2, 0.5)
    gain = np.zeros(plant.layout.order)
    gain[plant.layout.table_velocity] = -1e3
    with pytest.raises(NumericalError, match="not stable"):
        closed_loop(plant, gain)
    with pytest.raises(ParameterError, match="shape"):
        closed_loop(plant, gain[1:])
    gain[plant.layout.table_displacement] = 1.0
    with pytest.raises(ParameterError, match="position"):
        closed_loop(plant, gain)
