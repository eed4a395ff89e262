"""Many runs of a linear model in blocks, against scipy's sample by sample."""

import numpy as np
import pytest
from scipy.signal import dlsim

from baselines.linear_batch import mean_squares, respond
from shake_env.discretization import DiscreteStateSpace
from shake_env.errors import ParameterError


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
    found = respond(model, inputs, initial, block)
    assert found.shape == (103, 3, 4)
    squares = mean_squares(model, inputs, initial, block)
    np.testing.assert_allclose(squares, np.mean(found**2, axis=0), rtol=1e-12)
    for run in range(4):
        matrices = (model.A, model.B, model.C, model.D, model.dt)
        _, expected, _ = dlsim(matrices, inputs[:, :, run], x0=initial[:, run])
        np.testing.assert_allclose(
            found[:, :, run], expected, rtol=0, atol=1e-12 * np.abs(expected).max()
        )


def test_at_rest_by_default_and_shapes_are_checked():
    model, inputs = system(), np.zeros((5, 2, 3))
    assert not respond(model, inputs).any()
    for wrong in (inputs[:, :1], inputs[0]):
        with pytest.raises(ParameterError, match="inputs shape"):
            respond(model, wrong)
    with pytest.raises(ParameterError, match="initial shape"):
        respond(model, inputs, np.zeros((6, 2)))
    with pytest.raises(ParameterError, match="block"):
        respond(model, inputs, block=0)
