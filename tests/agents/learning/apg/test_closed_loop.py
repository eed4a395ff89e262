"""The reverse sweep of the closed loop: the gradient of torch, which takes the loop apart."""

import numpy as np
import pytest
from gradient_models import model_on

from agents.learning.apg.window_rollout import WindowRollout
from agents.policies.base_law import base_law
from shake_env import Sensing, Sensor, make_scenario

torch = pytest.importorskip("torch")

FLOORS = Sensing(
    sensors=(
        Sensor(signal="floor_accelerations", noise=0.01, lowpass_frequency=60.0),
        Sensor(signal="table_velocity", bias=0.01, resolution=1e-3),
        Sensor(signal="table_displacement", noise=1e-4),
    ),
    history=2,
    last_action=True,
    preview=0.02,
)
SPECIMENS = {"fields": {"uncertainty.mass_ratio": [0.1, 1.0], "delay": 2.5}}
CASES = {
    "linear": ("linear", {}, {}),
    "linear, base row": ("linear", {"limits": "laboratory"}, {"base": "lqr", "authority": 0.3}),
    "linear, a specimen each": ("linear", SPECIMENS, {}),
    "as printed": ("as-printed", {}, {}),
    "estimator": ("laboratory", {}, {"base": "lqg", "authority": 0.3, "terminal_value": False}),
    "estimator, a specimen each": ("unknown-specimen", {}, {"base": "lqg", "authority": 0.3}),
    "records": ("records", {}, {"gain": 0.02}),
    "field": ("field", {}, {"base": "lqg-dac", "authority": 0.3}),
    "yielding": ("yielding", {}, {"gain": 5e-4}),
    "floors and history": ("laboratory", {"sensing": FLOORS}, {}),
}


@pytest.mark.parametrize("case", CASES)
def test_the_sweep_is_the_gradient_of_torch(case, monkeypatch):
    name, overrides, options = CASES[case]
    scenario = make_scenario(name, overrides)
    if "base" in options:
        options = {**options, "base": base_law(options["base"], scenario)}
    model = model_on(scenario, **options)
    model.policy.double()
    model.slow_policy.double()
    for _ in range(2):  # away from rest
        model.tables.sync_env(model.window_loss()[1])
    model.env.simulation.episode_steps[1] = model.env.simulation.step_count[1] + 5  # ends in the window
    start = model.env.get_state()
    results = []
    for loop in (WindowRollout.loop, property(lambda self: None)):
        monkeypatch.setattr(WindowRollout, "loop", loop)
        model.env.set_state(start)
        loss, window, seen = model.window_loss()
        gradient = torch.cat([g.flatten() for g in torch.autograd.grad(loss, model._actor)]).numpy()
        shown, _, _ = model.tables.sync_env(window)
        results.append((loss.item(), gradient, shown, model.env.simulation.state, seen))
        assert (window.history is None) == (len(results) == 2)
    (loss, gradient, shown, state, seen), (expected, reference, observed, stood, features) = results
    assert np.linalg.norm(reference) > 0.0
    assert loss == pytest.approx(expected, rel=1e-10)
    # Sums in another order through an oil column that is stiff: five digits of sixteen.
    assert np.linalg.norm(gradient - reference) < 1e-9 * np.linalg.norm(reference)
    np.testing.assert_allclose(shown, observed, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(state, stood, rtol=1e-7, atol=1e-9 * np.abs(stood).max())
    assert len(seen) == len(features)
    for one, two in zip(seen, features, strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-7, atol=1e-7)


def test_a_gradient_without_parameters_is_taken_by_torch():
    model = model_on(make_scenario())
    weights = torch.zeros(14, dtype=torch.float64, requires_grad=True)
    window = model.tables.rollout(lambda shown, memory: (shown @ weights, None, None), 4)
    assert window.history is None
    (gradient,) = torch.autograd.grad(window.rewards.sum(), weights)
    assert torch.isfinite(gradient).all()
