"""Segments that are run again: the same cost and gradient, and less kept on the way."""

import numpy as np
import pytest
from gradient_models import model_on

from agents.learning.apg.gradient_checkpointing import checkpointed
from agents.learning.apg.window_rollout import TorchTables
from agents.learning.vec_env import ShakeTableVecEnv
from agents.policies.base_law import base_law
from agents.training.algorithm_options import AnalyticOptions
from agents.training.config import TrainConfig
from agents.training.model_factory import new_model
from shake_env import make_scenario
from shake_env.errors import ParameterError

torch = pytest.importorskip("torch")

SPECIMENS = {"fields": {"uncertainty.mass_ratio": [0.1, 1.0], "delay": 2.5}}


@pytest.fixture(autouse=True)
def torch_alone(monkeypatch):
    """Segments are those of torch; the closed loop in numpy keeps no graph."""
    monkeypatch.setattr(TorchTables, "loop", None)


def estimated(scenario):
    """A model that corrects a law behind an estimator."""
    chosen = AnalyticOptions(base="lqg-accommodating", authority=0.3, window=12, terminal_value=True)
    config = TrainConfig(algorithm="analytic", analytic=chosen)
    base = base_law(chosen.base, scenario)
    env = ShakeTableVecEnv(scenario, 3, base=base, authority=0.3, reward_scale=0.01)
    model = new_model(config, scenario, env)
    model._setup_learn(1)
    return model


def test_a_segment_is_differentiated_along_its_inputs_and_its_parameters():
    weight = torch.tensor([[0.3, -0.2], [0.1, 0.4]], dtype=torch.float64, requires_grad=True)
    start = torch.tensor([1.0, 2.0], dtype=torch.float64, requires_grad=True)
    runs = []

    def run(x, flags, nothing):
        runs.append(torch.is_grad_enabled())
        return torch.tanh(weight @ x), flags & (x.sum() > 0.0), nothing

    def loss(through):
        x, flags, nothing = start, torch.tensor([True, False]), None
        for _ in range(3):
            x, flags, nothing = through(x, flags, nothing)
        assert nothing is None and not flags.requires_grad
        return (x**2).sum()

    expected = torch.autograd.grad(loss(run), (weight, start))
    runs.clear()
    total = loss(lambda *inputs: checkpointed(run, inputs, [weight]))
    assert runs == [False] * 3  # nothing is kept on the way
    found = torch.autograd.grad(total, (weight, start))
    assert runs == [False] * 3 + [True] * 3
    for one, two in zip(found, expected, strict=True):
        np.testing.assert_allclose(one.numpy(), two.numpy(), rtol=1e-14)


@pytest.mark.parametrize("segment", [1, 5, 12])
@pytest.mark.parametrize(
    ("name", "overrides", "options"),
    [
        ("linear", {}, {}),
        ("linear", SPECIMENS, {"memory": True, "terminal_value": False}),
        ("laboratory", {}, {}),
        ("yielding", {}, {"gain": 0.0005}),
    ],
    ids=str,
)
def test_a_window_in_segments_has_the_whole_windows_gradient(name, overrides, options, segment):
    scenario = make_scenario(name, overrides)
    model = estimated(scenario) if name == "laboratory" else model_on(scenario, **options)
    model.policy.double()
    model.slow_policy.double()
    start = model.env.snapshot()

    def both(checkpoint):
        model.checkpoint = checkpoint
        model.env.restore(start)
        model.memory = None
        loss, window, _ = model.window_loss()
        gradients = torch.autograd.grad(loss, model._actor, allow_unused=True)
        stands = [window.state.detach(), window.observation.detach()]
        return loss.item(), [*stands, *(g for g in gradients if g is not None)]

    (whole, expected), (parts, found) = both(0), both(segment)
    assert parts == pytest.approx(whole, rel=1e-14)
    assert len(found) == len(expected)
    for one, two in zip(found, expected, strict=True):
        # The same terms, summed in another order: rounding of the largest of them.
        scale = max(two.abs().max().item(), 1e-300)
        np.testing.assert_allclose(one.numpy() / scale, two.numpy() / scale, atol=1e-12)


def test_what_a_gradient_keeps_falls_with_the_segment():
    model = model_on(make_scenario("linear"), lanes=16, window=64, terminal_value=False)
    start = model.env.snapshot()

    def kept(checkpoint):
        """Bytes that the graph of a window holds on to when all of it has been followed."""
        model.checkpoint = checkpoint
        model.env.restore(start)
        held = {}

        def pack(tensor):
            storage = tensor.untyped_storage()
            held[storage.data_ptr()] = storage.nbytes()
            return tensor

        with torch.autograd.graph.saved_tensors_hooks(pack, lambda tensor: tensor):
            loss, _, _ = model.window_loss()
        assert loss.requires_grad
        return sum(held.values())

    # Eight segments of eight: one of them whole, seven starts, and rewards.
    assert kept(8) < 0.25 * kept(0)


@pytest.mark.parametrize("memory", [0, 8])
def test_training_goes_the_same_way_in_segments(memory):
    scenario = make_scenario("laboratory", {"duration": 0.2})

    def learned(checkpoint):
        chosen = AnalyticOptions(window=24, memory=memory, checkpoint=checkpoint, terminal_value=True)
        config = TrainConfig(algorithm="analytic", analytic=chosen)
        env = ShakeTableVecEnv(scenario, 2, base=base_law("lqg", scenario), reward_scale=0.01)
        model = new_model(config, scenario, env)
        assert model.checkpoint == checkpoint
        model.learn(3 * 24 * 2)
        return torch.nn.utils.parameters_to_vector(model.policy.parameters()).detach().numpy()

    whole, parts = learned(0), learned(5)
    # Adam divides single-precision gradients by their size: a step of 1e-3 is as uncertain as the sign
    # of entries that are rounding alone, and all others are the same.
    assert np.mean(np.abs(whole - parts) > 1e-6) < 0.02


def test_a_negative_segment_is_refused():
    with pytest.raises(ParameterError, match="checkpoint"):
        model_on(make_scenario("linear"), checkpoint=-1)
