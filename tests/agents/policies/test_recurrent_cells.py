"""Memory units in numpy: convolutions are what their equation says, causal, and checked."""

from dataclasses import replace

import numpy as np
import pytest
from memory_units import KINDS, random_unit

from agents.policies.recurrent_cells import LONGEST, ConvolutionUnit, initial_state
from shake_env.errors import PolicyFileError


def outputs(unit, features):
    """Outputs (T, ..., units) of a unit that begins at rest, for features (T, ..., f)."""
    state, made = initial_state(unit, features.shape[1:-1]), []
    for each in features:
        output, state = unit(each, state)
        made.append(output)
    return np.stack(made)


def convolved(unit, features):
    """The same of a convolution by its equation, from the features of all periods, in double."""
    values = features.astype(float)
    for number, (weight, bias, d) in enumerate(
        zip(unit.weights, unit.biases, unit.dilations, strict=True)
    ):
        taps = weight.shape[1]
        made = np.empty((len(values), len(bias)))
        for t in range(len(values)):
            total = bias.astype(float)
            for k in range(taps):
                past = t - (taps - 1 - k) * d
                total = total + (weight[:, k] @ values[past] if past >= 0 else 0.0)
            made[t] = np.maximum(total, 0.0) + (values[t] if number else 0.0)
        values = made
    return values


def test_a_convolution_run_period_by_period_is_its_equation():
    unit = random_unit(ConvolutionUnit, 4, 6)
    features = np.random.default_rng(0).normal(size=(60, 4)).astype(np.float32)
    expected = convolved(unit, features)
    # Sums of at most 18 products of order 1 in single precision, three layers deep.
    np.testing.assert_allclose(outputs(unit, features), expected, rtol=1e-5, atol=1e-5)
    assert expected.std() > 0.5 and (expected[:, 0] > 0).any()


@pytest.mark.parametrize("kind", KINDS)
def test_a_later_input_changes_no_earlier_output(kind):
    unit = random_unit(kind, 4, 6)
    features = np.random.default_rng(0).normal(size=(40, 3, 4)).astype(np.float32)
    changed = features.copy()
    changed[25] += 1.0
    before, after = outputs(unit, features), outputs(unit, changed)
    np.testing.assert_array_equal(after[:25], before[:25])
    assert (after[25] != before[25]).any()


def test_a_convolution_forgets_what_it_does_not_see():
    unit = random_unit(ConvolutionUnit, 4, 6)
    assert unit.seen == 17
    features = np.random.default_rng(0).normal(size=(40, 4)).astype(np.float32)
    changed = features.copy()
    changed[10] += 5.0
    differs = (outputs(unit, features) != outputs(unit, changed)).any(axis=-1)
    assert np.flatnonzero(differs)[0] == 10 and np.flatnonzero(differs)[-1] == 10 + 16


@pytest.mark.parametrize("kind", KINDS)
def test_parts_make_the_unit_again(kind):
    unit = random_unit(kind, 4, 6)
    assert (unit.inputs, unit.units) == (4, 6) and "6 units" in unit.summary
    again = unit.with_parts({name: 2.0 * part for name, part in unit.parts.items()})
    for name, part in unit.parts.items():
        np.testing.assert_array_equal(again.parts[name], 2.0 * part)
    _, state = unit(np.zeros((2, 4), np.float32), initial_state(unit, (2,)))
    assert tuple(part.shape for part in state) == tuple((2, width) for width in unit.state_widths)


@pytest.mark.parametrize(
    ("changes", "wrong"),
    [
        ({"dilations": (1, 0, 4)}, "memory dilations.*whole numbers"),
        ({"dilations": (1, 2.0, 4)}, "memory dilations.*whole numbers"),
        ({"dilations": ()}, "memory dilations"),
        ({"dilations": (1, 2)}, "memory shape"),
        ({"dilations": (1, 2, LONGEST)}, f"at most {LONGEST}"),
        ({"biases": (np.zeros(6), np.zeros(6), np.zeros(5))}, "memory shape"),
        ({"weights": ()}, "memory shape"),
        ({"weights": (np.zeros((6, 1, 4)), *[np.zeros((6, 1, 6))] * 2)}, "memory shape"),
        ({"weights": (np.full((6, 3, 4), np.nan), *[np.zeros((6, 3, 6))] * 2)}, "nan or inf"),
    ],
    ids=str,
)
def test_a_convolution_that_does_not_fit_is_refused(changes, wrong):
    with pytest.raises(PolicyFileError, match=wrong):
        replace(random_unit(ConvolutionUnit, 4, 6), **changes)
