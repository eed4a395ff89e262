"""Corrections of a law behind an estimator: the same law in numpy, torch and a file, true gradients."""

import numpy as np
import pytest

from agents.learning.apg.algorithm import AnalyticPolicyGradient
from agents.learning.vec_env import ShakeTableVecEnv
from agents.policies.base_law import base_law
from agents.policies.estimated_law import EstimatedLaw
from agents.policies.policy_file import load_policy
from agents.training.algorithm_options import APGOptions, PPOOptions
from agents.training.config import TrainConfig
from agents.training.model_factory import new_model
from agents.training.policy_export import export_policy
from baselines.estimation.lqg import full_state
from baselines.registry import make_baseline
from baselines.searched_lqg import LQG_SEARCHED
from shake_env import make_scenario
from shake_env.errors import PolicyFileError, ScenarioError

torch = pytest.importorskip("torch")

DELAYED = {"fields": {"delay": 2.5, "sensing.preview": 0.1}}
CASES = [("laboratory", {}), ("unknown-specimen", {}), ("linear", DELAYED)]
LAWS = [(*case, "lqg-dac") for case in CASES] + [("laboratory", {}, LQG_SEARCHED)]


@pytest.mark.parametrize("kind", ["numpy", "torch"])
@pytest.mark.parametrize(("name", "overrides", "base"), LAWS, ids=str)
def test_the_matrices_are_the_controller(name, overrides, base, kind):
    scenario = make_scenario(name, overrides)
    controller = make_baseline(base, scenario)
    law = EstimatedLaw.from_name(base, scenario)
    like = torch.zeros(1, dtype=torch.float64) if kind == "torch" else np.zeros(1)
    law, to = law.to(like), torch.as_tensor if kind == "torch" else np.asarray
    rng = np.random.default_rng(0)
    memory, age, state = np.zeros((3, law.size)), np.zeros(3, dtype=int), None
    action = np.zeros((3, 1))
    for t in range(410):  # beyond the filter's warm-up
        seen = (0.1 * rng.normal(size=(3, scenario.observation.size))).astype(np.float32)
        begun = np.array([t == 0, t in (0, 5), False])
        if t == 0:
            begun[:] = True
        memory, age = np.where(begun[:, None], 0.0, memory), np.where(begun, 0, age)
        if scenario.sensing.last_action:
            given = np.where(begun, 0.0, action[:, 0])
            seen[:, scenario.observation.last_action] = given[:, None]
        action, state = controller.predict(seen, state, None if t == 0 else begun)
        known, shown = law.look(to(memory), to(seen.astype(float)), age)
        # What the controller hands its inner law is float32, and reading by reading it adds up.
        own = np.clip(np.asarray(shown)[:, -1], -1.0, 1.0)
        np.testing.assert_allclose(own, action[:, 0], atol=3e-6)
        memory = np.asarray(law.keep(known, to(action[:, 0].astype(float))))
        age = age + 1


def test_numpy_weighs_as_the_array_api_does_at_every_age():
    """Its products leave zeros out, and take the settled gain as one matrix."""
    scenario = make_scenario("laboratory")
    law, rng = EstimatedLaw.from_name("lqg-dac", scenario), np.random.default_rng(0)
    memory, seen = rng.normal(size=(9, law.size)), rng.normal(size=(9, law.observation_size))
    for age in (np.zeros(9, dtype=int), np.arange(9), np.arange(9) * 100, np.full(9, 500)):
        for ours, theirs in zip(law.look(memory, seen, age), law._weigh(memory, seen, age), strict=True):
            size = np.abs(theirs).max()
            np.testing.assert_allclose(ours / size, theirs / size, rtol=0, atol=1e-13)


def test_what_is_shown_is_what_a_full_state_law_would_be_given():
    scenario = make_scenario("laboratory")
    controller = make_baseline("lqg-dac", scenario)
    given = []

    class Listener:
        row = controller.law.row

        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            given.append(observation)
            return np.clip(observation @ self.row, -1.0, 1.0)[..., None].astype(np.float32), None

    law = EstimatedLaw.from_name("lqg-dac", scenario)
    controller.law = Listener()
    rng = np.random.default_rng(1)
    seen = rng.normal(size=(4, scenario.observation.size)).astype(np.float32)
    seen[:, scenario.observation.last_action] = 0.0
    controller.predict(seen)
    _, shown = law.look(np.zeros((4, law.size)), seen.astype(float), np.zeros(4, dtype=int))
    order = full_state(scenario).plant.layout.order
    np.testing.assert_allclose(shown[:, :order], given[0][:, :order], rtol=1e-5, atol=1e-5)


def corrected(
    scenario,
    *,
    lanes=3,
    memory=0,
    authority=0.3,
    base="lqg-dac",
    algorithm=None,
    tuned_on=None,
):
    law = base_law(base, scenario, tuned_on)
    env = ShakeTableVecEnv(scenario, lanes, base=law, authority=authority, reward_scale=0.01)
    config = TrainConfig(
        algorithm=algorithm or "apg",
        net_arch=(16,),
        apg=APGOptions(n_envs=lanes, rollout_horizon=12, gru_hidden_size=memory, actor_bias=True),
        ppo=PPOOptions(n_envs=lanes, n_steps=8, batch_size=lanes * 8, actor_bias=True),
    )
    model = new_model(config, scenario, env)
    env.seed(0)
    with torch.no_grad():
        generator = torch.Generator().manual_seed(0)
        weight = model.policy.action_net.weight
        weight.copy_(0.002 * torch.randn(weight.shape, generator=generator))
    return model, env


def test_without_a_correction_the_tables_are_the_controllers():
    scenario = make_scenario("laboratory", {"duration": 0.2})
    env = ShakeTableVecEnv(scenario, 3, base=base_law("lqg-dac", scenario), authority=0.3)
    plain = ShakeTableVecEnv(scenario, 3)
    controller = make_baseline("lqg-dac", scenario)
    for each in (env, plain):
        each.seed(0)
    env.reset()
    observation, state, begun = plain.reset(), None, np.ones(3, dtype=bool)
    for t in range(60):  # one and a half episodes
        shown, rewards, done, infos = env.step(np.zeros((3, 1), dtype=np.float32))
        action, state = controller.predict(observation, state, begun)
        observation, expected, begun, _ = plain.step(action)
        np.testing.assert_allclose(rewards, expected, rtol=1e-3, atol=1e-9)
        np.testing.assert_allclose(shown[:, : observation.shape[1]], observation, atol=1e-4)
        assert (done == begun).all() and done.all() == (t == 39)
        if done.all():
            assert infos[0]["terminal_observation"].shape == shown[0].shape


@pytest.mark.parametrize("memory", [0, 8])
@pytest.mark.parametrize("name", ["laboratory", "unknown-specimen"])
def test_a_window_and_a_file_are_what_the_environment_does(name, memory, tmp_path):
    # Not rounded: a reading on the edge between two steps of its resolution may fall to either side, and
    # how often one does depends on the seed.
    exact = {
        f"sensing.sensors.{sensor.signal}.resolution": 0.0
        for sensor in make_scenario(name).sensing.sensors
    }
    scenario = make_scenario(name, {"duration": 0.3, "fields": exact})
    # By the written rule the filter doubts its model more, and enlarges the rounding of float32.
    model, env = corrected(scenario, memory=memory, tuned_on=make_scenario(name))
    model._setup_learn(10_000)
    path = tmp_path / "policy.safetensors"
    export_policy(model, env, {}).save(path)
    policy = load_policy(path)
    assert policy.observation_size == scenario.observation.size
    other = ShakeTableVecEnv(scenario, 3, base=env.law, authority=0.3, reward_scale=0.01)
    other.set_state(env.get_state())
    shown, state, begun = other._look(), None, np.ones(3, dtype=bool)
    own = None
    for number in range(7):
        rewards = None
        if number < 5:  # windows that lie within the episode
            _, window, _ = model.window_loss()
            rewards = window.rewards.detach().numpy()
        for t in range(12):
            action, own = policy.predict(other.observation, own, begun)
            correction, state = model.predict(shown, state, begun)
            shown, expected, begun, _ = other.step(correction)
            np.testing.assert_allclose(action[:, 0], np.clip(other._action, -1.0, 1.0), atol=1e-6)
            if rewards is not None:
                # Actions are float32, and the oil column turns their rounding into acceleration.
                np.testing.assert_allclose(rewards[t], expected, rtol=5e-3, atol=1e-8)
        if number < 5:
            after, done, _ = model.tables.sync_env(window)
            np.testing.assert_allclose(after, shown, rtol=1e-3, atol=1e-3)
            assert (done == begun).all() and done.all() == (number == 4)
            model._last_episode_starts = done


def test_the_gradient_goes_through_the_estimator():
    # No sensors: readings are rounded, whose steps a difference sees and a gradient does not.
    friction = {"nonlinearity.friction.coulomb": 300.0}
    scenario = make_scenario("linear", {"fields": {**DELAYED["fields"], **friction}})
    model, env = corrected(scenario)
    model._setup_learn(10_000)
    model.policy.double()
    for _ in range(3):
        _, window, _ = model.window_loss()
        model.tables.sync_env(window)
    start = env.get_state()

    def loss():
        env.set_state(start)
        return model.window_loss()[0]

    gradient = torch.cat([g.flatten() for g in torch.autograd.grad(loss(), model._actor)]).numpy()
    values = torch.nn.utils.parameters_to_vector(model._actor).detach()
    rng = np.random.default_rng(0)
    with torch.no_grad():
        for _ in range(4):
            direction = rng.standard_normal(len(gradient))
            sides = []
            for sign in (1.0, -1.0):
                torch.nn.utils.vector_to_parameters(
                    values + sign * 1e-8 * torch.as_tensor(direction), model._actor
                )
                sides.append(loss().item())
            numeric = (sides[0] - sides[1]) / 2e-8
            # A random direction is nearly orthogonal to the gradient: its norm is the measure.
            assert abs(gradient @ direction - numeric) < 1e-5 * np.linalg.norm(gradient)


def test_ppo_corrects_it_too(tmp_path):
    scenario = make_scenario("laboratory", {"duration": 0.2})
    model, env = corrected(scenario, algorithm="ppo")
    model.learn(96)
    export_policy(model, env, {}).save(tmp_path / "policy.safetensors")
    policy = load_policy(tmp_path / "policy.safetensors")
    env.reset()
    action, _ = policy.predict(env.observation)
    correction, _ = model.predict(env._shown, deterministic=True)
    expected = np.clip(env._shown @ env.base + 0.3 * correction[:, 0], -1.0, 1.0)
    np.testing.assert_allclose(action[:, 0], expected, atol=1e-6)


def test_a_preview_law_is_a_row():
    scenario = make_scenario("yielding")
    row = base_law("preview-lqr", scenario)
    seen = np.random.default_rng(0).normal(size=(5, scenario.observation.size)).astype(np.float32)
    action, _ = make_baseline("preview-lqr", scenario).predict(0.1 * seen)
    np.testing.assert_allclose(np.clip(0.1 * seen @ row, -1.0, 1.0), action[:, 0], atol=1e-6)


def test_what_is_no_linear_law_is_refused():
    with pytest.raises(ScenarioError, match="tvc"):
        EstimatedLaw.from_name("tvc", make_scenario("laboratory"))


@pytest.mark.parametrize("part", ["advance", "gains", "show", "begins"])
def test_a_file_whose_law_does_not_fit_is_refused(part, tmp_path):
    scenario = make_scenario("laboratory")
    model, env = corrected(scenario)
    array = getattr(env.law, part)
    object.__setattr__(env.law, part, array[:, :-1] if array.ndim == 2 else array[..., :-1])
    export = tmp_path / "policy.safetensors"
    with pytest.raises(PolicyFileError):
        export_policy(model, env, {}).save(export)
        load_policy(export)


def test_the_algorithm_is_still_sb3s():
    model, _ = corrected(make_scenario("laboratory", {"duration": 0.5}))
    assert isinstance(model, AnalyticPolicyGradient)
    before = model.policy.action_net.weight.detach().clone()
    model.learn(100)
    assert not torch.equal(before, model.policy.action_net.weight)
