"""Many runs of a linear model in blocks, against scipy's sample by sample."""

import numpy as np
import pytest
from scipy.signal import dlsim

from baselines.analysis.batch_response import forced_response, mean_squares
from shake_env.errors import ParameterError
from shake_env.model.discretization import DiscreteStateSpace


def system(n=6, m=2, p=3):
    rng = np.random.default_rng(0)
    A = rng.normal(size=(n, n))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    return DiscreteStateSpace(
        A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), rng.normal(size=(p, m)), 0.01
    )


@pytest.mark.parametrize("block", [1, 7, 25, 1000])
def test_respond_is_dlsim(block):
    model, rng = system(), np.random.default_rng(1)
    inputs, initial = rng.normal(size=(103, 2, 4)), rng.normal(size=(6, 4))
    found = forced_response(model, inputs, initial, block)
    assert found.shape == (103, 3, 4)
    squares = mean_squares(model, inputs, initial, block)
    np.testing.assert_allclose(squares, np.mean(found**2, axis=0), rtol=1e-12)
    for run in range(4):
        matrices = (model.A, model.B, model.C, model.D, model.dt)
        _, expected, _ = dlsim(matrices, inputs[:, :, run], x0=initial[:, run])
        np.testing.assert_allclose(
            found[:, :, run], expected, rtol=0, atol=1e-12 * np.abs(expected).max()
        )


def test_states_that_reach_no_output_are_left_out():
    # Of a chain 3 -> 2 -> 1 -> output, with an integrator that all of them feed and that feeds nothing.
    felt = system(n=4)
    A = np.diag([0.9, 0.8, 0.7, 1.0]) + np.diag([0.5, 0.5, 0.0], k=1)
    A[3, :3] = 1.0
    C = np.array([[1.0, 0.0, 0.0, 0.0]] * 3)
    model = DiscreteStateSpace(A, felt.B, C, felt.D, felt.dt)
    rng = np.random.default_rng(2)
    inputs, initial = rng.normal(size=(50, 2, 1)), rng.normal(size=(4, 1))
    _, expected, _ = dlsim(
        (model.A, model.B, model.C, model.D, model.dt), inputs[..., 0], x0=initial[:, 0]
    )
    np.testing.assert_allclose(
        forced_response(model, inputs, initial)[..., 0], expected, rtol=0, atol=1e-13
    )
    moved = initial + np.array([[0.0], [0.0], [0.0], [1.0]])
    np.testing.assert_array_equal(
        forced_response(model, inputs, moved), forced_response(model, inputs, initial)
    )


def test_at_rest_by_default_and_shapes_are_checked():
    model, inputs = system(), np.zeros((5, 2, 3))
    assert not forced_response(model, inputs).any()
    for wrong in (inputs[:, :1], inputs[0]):
        with pytest.raises(ParameterError, match="inputs shape"):
            forced_response(model, wrong)
    with pytest.raises(ParameterError, match="initial shape"):
        forced_response(model, inputs, np.zeros((6, 2)))
    with pytest.raises(ParameterError, match="block"):
        forced_response(model, inputs, block=0)
