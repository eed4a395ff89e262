"""Segments that are run again: the same cost and gradient, and less kept on the way."""

import numpy as np
import pytest
from gradient_models import model_on

from agents.learning.apg.closed_loop import ClosedLoop
from agents.learning.apg.window_rollout import WindowRollout
from agents.learning.memory_policies import GRUPolicy
from agents.learning.vec_env import ShakeTableVecEnv
from agents.policies.base_law import base_law
from agents.training.algorithm_options import APGOptions
from agents.training.config import TrainConfig
from agents.training.model_factory import new_model
from shake_env import make_scenario
from shake_env.errors import ParameterError

torch = pytest.importorskip("torch")

SPECIMENS = {"fields": {"uncertainty.mass_ratio": [0.1, 1.0], "delay": 2.5}}


@pytest.fixture
def torch_alone(monkeypatch):
    """A window without segments in torch as well: its gradient is then the same to the last bit."""
    monkeypatch.setattr(WindowRollout, "loop", None)


def estimated(scenario):
    """A model that corrects a law behind an estimator."""
    chosen = APGOptions(
        base_controller="lqg-dac", residual_scale=0.3, rollout_horizon=12, terminal_value=True
    )
    config = TrainConfig(algorithm="apg", apg=chosen)
    base = base_law(chosen.base_controller, scenario)
    env = ShakeTableVecEnv(scenario, 3, base=base, authority=0.3, reward_scale=0.01)
    model = new_model(config, scenario, env)
    model._setup_learn(1)
    return model


def test_segments_are_run_again_where_a_whole_window_is_swept_in_numpy(monkeypatch):
    model = model_on(make_scenario("linear"), lanes=4, window=12, terminal_value=False)
    model.policy.double()
    start = model.env.get_state()

    def gradient(checkpoint):
        model.checkpoint = checkpoint
        model.env.set_state(start)
        return torch.autograd.grad(model.window_loss()[0], model._actor)

    whole = gradient(0)
    monkeypatch.setattr(ClosedLoop, "run", None)  # keeps every period of the window
    for one, two in zip(gradient(4), whole, strict=True):
        np.testing.assert_allclose(one.numpy(), two.numpy(), rtol=1e-9, atol=1e-12)


@pytest.mark.usefixtures("torch_alone")
@pytest.mark.parametrize("segment", [1, 5, 12])
@pytest.mark.parametrize(
    ("name", "overrides", "options"),
    [
        ("linear", {}, {}),
        ("linear", SPECIMENS, {"memory": GRUPolicy, "terminal_value": False}),
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
    start = model.env.get_state()

    def both(checkpoint):
        model.checkpoint = checkpoint
        model.env.set_state(start)
        model.memory = None
        loss, window, _ = model.window_loss()
        gradients = torch.autograd.grad(loss, model._actor, allow_unused=True)
        stands = [window.state.detach(), window.observation.detach()]
        return loss.item(), [*stands, *(g for g in gradients if g is not None)]

    (whole, expected), (parts, found) = both(0), both(segment)
    assert parts == whole
    for one, two in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one.numpy(), two.numpy())


@pytest.mark.usefixtures("torch_alone")
def test_what_a_gradient_keeps_falls_with_the_segment():
    model = model_on(make_scenario("linear"), lanes=16, window=64, terminal_value=False)
    start = model.env.get_state()

    def kept(checkpoint):
        """Bytes that the graph of a window holds on to when all of it has been followed."""
        model.checkpoint = checkpoint
        model.env.set_state(start)
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


@pytest.mark.usefixtures("torch_alone")
@pytest.mark.parametrize("memory", [0, 8])
def test_training_goes_the_same_way_in_segments(memory):
    scenario = make_scenario("laboratory", {"duration": 0.2})

    def learned(checkpoint):
        chosen = APGOptions(
            rollout_horizon=24,
            gru_hidden_size=memory,
            checkpoint_segment_length=checkpoint,
            terminal_value=True,
        )
        config = TrainConfig(algorithm="apg", apg=chosen)
        env = ShakeTableVecEnv(scenario, 2, base=base_law("lqg", scenario), reward_scale=0.01)
        model = new_model(config, scenario, env)
        assert model.checkpoint == checkpoint
        model.learn(3 * 24 * 2)
        return torch.nn.utils.parameters_to_vector(model.policy.parameters()).detach().numpy()

    np.testing.assert_array_equal(learned(5), learned(0))


def test_a_negative_segment_is_refused():
    with pytest.raises(ParameterError, match="checkpoint"):
        model_on(make_scenario("linear"), checkpoint=-1)
