"""Learning through the plant: the same tables as the environment's, true gradients, SB3's manners."""

import numpy as np
import pytest
from gradient_models import model_on, policy_options
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy

from agents.learning.apg.actor_critic import state_value
from agents.learning.apg.algorithm import AnalyticPolicyGradient
from agents.learning.apg.torch_plant import PeriodMap, torch_model
from agents.learning.apg.window_rollout import WindowRollout
from agents.learning.memory_policies import GRUPolicy, TCNPolicy
from agents.learning.vec_env import ShakeTableVecEnv
from agents.policies.base_law import base_row
from agents.training.algorithm_options import APGOptions
from agents.training.config import TrainConfig
from agents.training.model_factory import DirectPolicy, new_model
from agents.training.run import train
from shake_env import make_scenario
from shake_env.errors import ParameterError
from shake_env.simulation.plant_batch import PlantBatch

torch = pytest.importorskip("torch")

FRICTION = {"fields": {"nonlinearity.friction.coulomb": 300.0}}
SPECIMENS = {"fields": {"uncertainty.mass_ratio": [0.1, 1.0], "delay": 2.5}}


@pytest.mark.parametrize(
    ("name", "overrides", "options"),
    [
        ("linear", {}, {}),
        ("linear", {}, {"terminal_value": False, "base": "lqr", "authority": 0.3}),
        ("linear", FRICTION, {"memory": GRUPolicy}),
        ("linear", SPECIMENS, {"memory": GRUPolicy}),
        ("linear", SPECIMENS, {"memory": TCNPolicy}),
        ("yielding", {}, {"gain": 0.0005}),
    ],
    ids=str,
)
def test_gradient_of_a_windows_cost_agrees_with_finite_differences(name, overrides, options):
    scenario = make_scenario(name, overrides)
    if "base" in options:
        options = {**options, "base": base_row(options["base"], scenario)}
    model = model_on(scenario, **options)
    model.policy.double()
    model.slow_policy.double()
    for _ in range(4):  # away from rest
        _, window, _ = model.window_loss()
        model.tables.sync_env(window)
    model._last_episode_starts[:] = False
    start, memory = model.env.get_state(), model.memory

    def loss():
        model.env.set_state(start)
        model.memory = memory
        return model.window_loss()[0]

    gradient = torch.cat([g.flatten() for g in torch.autograd.grad(loss(), model._actor)]).numpy()
    values = torch.nn.utils.parameters_to_vector(model._actor).detach()
    rng = np.random.default_rng(0)
    with torch.no_grad():
        for _ in range(6):
            direction = rng.standard_normal(len(gradient))
            step = 1e-8  # truncation falls with its square; rounding is 1e-16 of the cost over it
            sides = []
            for sign in (1.0, -1.0):
                moved = values + sign * step * torch.as_tensor(direction)
                torch.nn.utils.vector_to_parameters(moved, model._actor)
                sides.append(loss().item())
            numeric = (sides[0] - sides[1]) / (2.0 * step)
            # A random direction is nearly orthogonal to the gradient: its norm is the measure.
            assert abs(gradient @ direction - numeric) < 1e-5 * np.linalg.norm(gradient)


@pytest.mark.parametrize("memory", [None, GRUPolicy, TCNPolicy])
@pytest.mark.parametrize("name", ["linear", "laboratory", "unknown-specimen", "records"])
def test_a_window_is_what_the_environment_does_under_the_same_policy(name, memory):
    scenario = make_scenario(name, {"duration": 0.2} if name != "records" else {})
    model = model_on(scenario, lanes=4, memory=memory, gain=0.005)
    other = ShakeTableVecEnv(scenario, 4, reward_scale=0.01)
    other.set_state(model.env.get_state())
    observation, state = other.observation, None
    begun = np.ones(4, dtype=bool)
    for _ in range(3):
        _, window, _ = model.window_loss()
        rewards = window.rewards.detach().numpy()
        for t in range(12):
            action, state = model.predict(observation, state, begun)
            observation, expected, begun, _ = other.step(action)
            # Actions are float32, and the oil column turns their rounding into acceleration.
            np.testing.assert_allclose(rewards[t], expected, rtol=2e-4, atol=1e-8)
        shown, done, _ = model.tables.sync_env(window)
        np.testing.assert_allclose(shown, observation, rtol=1e-3, atol=1e-4)
        assert not done.any()
        model._last_episode_starts = done


def test_a_motion_that_ends_within_a_window_counts_to_its_end_and_the_next_one_begins():
    scenario = make_scenario("linear", {"duration": 0.1})  # 20 control periods
    model = model_on(scenario, lanes=3, memory=GRUPolicy)
    model.env.simulation.episode_steps[:] = (20, 12, 5)
    _, window, _ = model.window_loss()
    assert window.steps.tolist() == [12, 12, 5]
    assert (window.rewards[5:, 2] == 0.0).all() and (window.rewards[:5, 2] < 0.0).all()
    shown, done, infos = model.tables.sync_env(window)
    assert done.tolist() == [False, True, True]
    assert infos[2]["episode"] == {"r": pytest.approx(window.returns[2]), "l": 5}
    assert model.env.simulation.step_count.tolist() == [12, 0, 0]
    assert np.all(model.env.simulation.state[1:] == 0.0) and np.all(shown[1:] == 0.0)
    model._last_episode_starts = done
    model.memory = torch.ones_like(model.memory)
    assert model._begin()[:, 0].tolist() == [1.0, 0.0, 0.0]


def test_a_broken_limit_is_paid_for_and_ends_the_episode():
    scenario = make_scenario("linear", {"limits": "laboratory"})
    model = model_on(scenario, lanes=2)
    state = model.env.simulation.state
    state[1, 1] = 0.08  # m: beyond the stroke
    model.env.simulation.state = state
    with torch.no_grad():
        _, window, _ = model.window_loss()
    assert window.terminated.tolist() == [False, True] and window.steps.tolist() == [12, 1]
    steps = model.env.simulation.episode_steps[1]
    dearest = scenario.limits.cost_factor * scenario.stage_cost.motionless(scenario.plant)
    assert -window.returns[1] >= dearest * (steps - 1)
    _, done, infos = model.tables.sync_env(window)
    assert done.tolist() == [False, True] and infos[1]["broken_limit"] == "table_displacement"


def test_a_lost_table_leaves_the_gradient_finite():
    scenario = make_scenario()
    model = model_on(scenario, lanes=2)
    state = model.env.simulation.state
    state[1, 0] = 1e4 * scenario.plant.state_scale[2]
    model.env.simulation.state = state
    loss, window, _ = model.window_loss()
    gradients = torch.autograd.grad(loss, model._actor)
    assert window.terminated.tolist() == [False, True]
    assert all(torch.isfinite(g).all() for g in gradients)


def test_a_linear_fleet_is_stepped_by_one_map_a_table():
    scenario = make_scenario("linear", SPECIMENS)
    batch = PlantBatch(scenario, 5)
    batch.sample(range(5), [np.random.default_rng(i) for i in range(5)])
    like = torch.zeros(1, dtype=torch.float64)
    model = torch_model(batch.model, like)
    assert isinstance(model.dynamics, PeriodMap)
    rng = np.random.default_rng(0)
    state = rng.standard_normal((5, model.dynamics.states))
    current = rng.standard_normal(5)
    expected = batch.model.dynamics.control_step(state, current)
    found = model.dynamics.control_step(torch.as_tensor(state), torch.as_tensor(current))
    for name in ("state", "table_acceleration", "base_shear"):
        one, two = getattr(found, name).numpy(), getattr(expected, name)
        np.testing.assert_allclose(one, two, atol=1e-12 * np.abs(two).max())


def test_targets_of_the_critic_are_lambda_returns():
    model = model_on(make_scenario("linear", {"duration": 0.1}), lanes=2, td_lambda=0.8)
    model.env.simulation.episode_steps[:] = (20, 7)
    with torch.no_grad():
        _, window, seen = model.window_loss()
        values = state_value(model.slow_policy, torch.stack(seen)).numpy()
        targets = model._targets(window, torch.stack(seen)).numpy()
    rewards = window.rewards.numpy()
    for lane, end in ((0, 12), (1, 7)):
        for t in range(end):
            # (1 - lambda) sum of n-step returns, the longest with all of the weight that is left.
            found, weight = 0.0, 1.0
            for n in range(1, end - t + 1):
                power = model.gamma ** np.arange(n)
                outlook = power @ rewards[t : t + n, lane] + model.gamma**n * values[t + n, lane]
                share = weight if n == end - t else weight * (1.0 - 0.8)
                found += share * outlook
                weight *= 0.8
            assert targets[t, lane] == pytest.approx(found, rel=1e-4, abs=1e-7)


def test_states_between_windows_are_data():
    model = model_on(make_scenario(), memory=GRUPolicy)
    model.train()
    assert not model.memory.requires_grad
    assert isinstance(model.env.simulation.state, np.ndarray)


class Count(BaseCallback):
    """Counts what SB3 calls."""

    def __init__(self):
        super().__init__()
        self.calls = []

    def _on_rollout_start(self):
        self.calls.append("start")

    def _on_step(self):
        self.calls.append("step")
        return len(self.calls) < 5


def test_sb3s_manners(tmp_path):
    scenario = make_scenario("linear", {"duration": 1.0})
    env = ShakeTableVecEnv(scenario, 2)
    options = policy_options(scenario)
    model = AnalyticPolicyGradient(
        "MlpPolicy", env, window=8, policy_kwargs=options, seed=3, device="cpu"
    )
    count = Count()
    model.learn(10_000, callback=count)
    assert count.calls == ["start", "step"] * 3 or count.calls[:4] == ["start", "step"] * 2
    assert model.num_timesteps == 16 * count.calls.count("step")
    model.save(tmp_path / "model.zip")
    loaded = AnalyticPolicyGradient.load(tmp_path / "model.zip", device="cpu")
    seen = np.random.default_rng(0).normal(size=(7, 14)).astype(np.float32)
    np.testing.assert_array_equal(loaded.predict(seen)[0], model.predict(seen)[0])
    loaded.set_env(ShakeTableVecEnv(scenario, 2))
    loaded.learn(16)
    assert loaded.num_timesteps == 16
    mean, _ = evaluate_policy(model, env, n_eval_episodes=2, warn=False)
    assert np.isfinite(mean)


def test_an_actor_without_a_gradient_goes_back_to_where_it_had_one():
    scenario = make_scenario("linear", {"duration": 4.0})
    model = model_on(scenario, window=800, learning_rate=1e-4)
    window = 3 * 800
    model.learn(2 * window)
    assert model.retreats == 0
    stood = torch.nn.utils.parameters_to_vector(model._actor).detach().clone()
    with torch.no_grad():  # a loop that rings, its gradient a tenth larger a period: 1e33 after 800
        model.policy.action_net.weight[:, 16:] -= 0.01
    model.learn(window, reset_num_timesteps=False)
    assert model.retreats == 1
    back = torch.nn.utils.parameters_to_vector(model._actor).detach()
    # The mean of where it was in two windows, Adam's steps of 1e-4 a weight apart.
    torch.testing.assert_close(back, stood, rtol=0.0, atol=3e-4)
    model.learn(window, reset_num_timesteps=False)
    assert model.retreats == 1
    assert not torch.equal(back, torch.nn.utils.parameters_to_vector(model._actor))


def test_a_seed_fixes_what_is_learned():
    scenario = make_scenario("linear", {"duration": 1.0})

    def learned(seed):
        model = AnalyticPolicyGradient(
            "MlpPolicy", ShakeTableVecEnv(scenario, 2), window=8, seed=seed, device="cpu",
            policy_kwargs=policy_options(scenario),
        )  # fmt: skip
        model.learn(64)
        return torch.nn.utils.parameters_to_vector(model.policy.parameters())

    first, again, other = learned(0), learned(0), learned(1)
    assert torch.equal(first, again) and not torch.equal(first, other)


def test_ppo_goes_on_from_its_parameters_and_the_other_way_round():
    scenario = make_scenario("linear", {"duration": 1.0})
    env = ShakeTableVecEnv(scenario, 4)
    options = policy_options(scenario)
    seen = np.random.default_rng(0).normal(size=(7, 14)).astype(np.float32)
    analytic = AnalyticPolicyGradient(DirectPolicy, env, window=8, policy_kwargs=options, device="cpu")
    ppo = PPO(DirectPolicy, env, n_steps=8, batch_size=16, policy_kwargs=options, device="cpu")
    for giver, taker in ((analytic, ppo), (ppo, analytic)):
        giver.learn(64)
        taker.policy.load_state_dict(giver.policy.state_dict())
        np.testing.assert_array_equal(
            giver.predict(seen, deterministic=True)[0], taker.predict(seen, deterministic=True)[0]
        )
        before = taker.policy.action_net.weight.detach().clone()
        taker.learn(64)
        assert not torch.equal(before, taker.policy.action_net.weight)


def test_another_environment_is_refused_with_the_remedy():
    env = make_vec_env("Pendulum-v1", n_envs=1)
    model = AnalyticPolicyGradient("MlpPolicy", env, device="cpu")
    with pytest.raises(ParameterError, match=r"env = 'DummyVecEnv': must be a ShakeTableVecEnv"):
        model.learn(100)
    with pytest.raises(ParameterError, match="plant_dtype"):
        AnalyticPolicyGradient("MlpPolicy", env, plant_dtype="half", device="cpu")


def test_single_precision_follows_double():
    scenario = make_scenario("laboratory")
    model = model_on(scenario)
    start = model.env.get_state()
    double = model.window_loss()[0].item()
    model.env.set_state(start)
    model._tables = WindowRollout(model.env, dtype=torch.float32)
    # Eps of 1e-7 a step through an oil column whose pressure is a difference of large flows.
    assert model.window_loss()[0].item() == pytest.approx(double, rel=1e-3)


def test_a_memory_policy_is_at_rest_for_what_gives_no_state():
    scenario = make_scenario("unknown-specimen")
    env = ShakeTableVecEnv(scenario, 3)
    policy = new_model(TrainConfig(algorithm="apg", apg=APGOptions(gru_hidden_size=8)), scenario, env)
    seen = np.random.default_rng(0).normal(size=(5, 110)).astype(np.float32)
    action, state = policy.predict(seen)
    with torch.no_grad():
        through = policy.policy(torch.as_tensor(seen), deterministic=True)[0].numpy()
    np.testing.assert_allclose(action, np.clip(through, -1.0, 1.0), atol=1e-6)
    started, _ = policy.predict(seen, state, np.ones(5, dtype=bool))
    np.testing.assert_allclose(started, action, atol=1e-6)
    later, _ = policy.predict(seen, state, np.zeros(5, dtype=bool))
    assert not np.allclose(later, action, atol=1e-6)


@pytest.mark.slow
def test_the_linear_task_is_learned_to_a_hundredth(tmp_path):
    assert train(TrainConfig(algorithm="apg"), tmp_path / "run").cost_ratio <= 1.01
