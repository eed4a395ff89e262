"""Policies with a memory: whole sequences at once are what decisions one by one are."""

import numpy as np
import pytest

from agents.learning.memory_policies import GRUPolicy, TCNPolicy
from agents.policies.recurrent_cells import DILATIONS, ConvolutionUnit
from shake_env import make_scenario

torch = pytest.importorskip("torch")
KINDS = (GRUPolicy, TCNPolicy)


def policy_of(kind, units=6):
    from gymnasium import spaces

    size = make_scenario("laboratory").observation.size
    torch.manual_seed(0)
    return kind(
        spaces.Box(-1.0, 1.0, (size,)), spaces.Box(-1.0, 1.0, (1,)), lambda _: 1e-3, units=units,
        net_arch=[8],
    )  # fmt: skip


def shown_to(policy, periods, lanes):
    size = policy.observation_space.shape[0]
    return torch.from_numpy(
        np.random.default_rng(1).normal(size=(periods, lanes, size)).astype(np.float32)
    )


@pytest.mark.parametrize("kind", KINDS)
def test_a_sequence_at_once_is_its_periods_one_by_one(kind):
    policy = policy_of(kind)
    shown = shown_to(policy, 90, 4)
    begun = torch.zeros(90, 4, dtype=torch.bool)
    begun[0, 1] = begun[30, 2] = begun[33, 2] = begun[89, 3] = True
    generator = torch.Generator().manual_seed(2)
    memory = first = torch.rand(policy.rest(4).shape, generator=generator)
    expected = []
    with torch.no_grad():
        for each, start in zip(shown, begun, strict=True):
            seen, memory = policy.recall(each, torch.where(start[:, None], 0.0, memory))
            expected.append(seen)
        found = policy.recall_sequence(shown, first, begun)
    # Sums of some hundred products in single precision, in another order.
    torch.testing.assert_close(found, torch.stack(expected), rtol=1e-5, atol=1e-5)
    assert found[..., -6:].std() > 0.1


def test_the_network_is_the_unit_in_numpy():
    policy = policy_of(TCNPolicy)
    parts = {name: part.detach().numpy() for name, part in policy.memory_parts().items()}
    unit = ConvolutionUnit.read(lambda name, axes: parts[name], DILATIONS)
    assert unit.seen == policy.lead + 1
    assert policy.memory_width == sum(unit.state_widths)
    shown = shown_to(policy, 60, 3)
    memory = policy.rest(3)
    state = tuple(np.zeros((3, width), np.float32) for width in unit.state_widths)
    with torch.no_grad():
        for each in shown:
            seen, memory = policy.recall(each, memory)
            output, state = unit(each.numpy(), state)
            np.testing.assert_allclose(output, seen[:, -6:].numpy(), rtol=1e-5, atol=1e-5)
            np.testing.assert_allclose(memory.numpy(), np.hstack(state), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_of_a_sequence_reach_every_weight(kind):
    policy = policy_of(kind)
    begun = torch.zeros(60, 2, dtype=torch.bool)
    policy.recall_sequence(shown_to(policy, 60, 2), policy.rest(2), begun).square().mean().backward()
    unit = policy.gru if kind is GRUPolicy else policy.convolutions
    assert all(parameter.grad.abs().max() > 0.0 for parameter in unit.parameters())
