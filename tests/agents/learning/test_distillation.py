"""On-policy distillation: labels of a teacher, fitted where the student drives."""

from dataclasses import replace

import numpy as np
import pytest

from agents.learning.distillation import Distillation
from agents.learning.memory_policies import GRUPolicy, TCNPolicy
from agents.learning.networks import DirectPolicy
from agents.learning.vec_env import ShakeTableVecEnv
from agents.policies.base_law import base_law
from agents.policies.policy_file import load_policy
from agents.scenario_options import ScenarioOptions
from agents.training.algorithm_options import DaggerOptions
from agents.training.config import TrainConfig
from agents.training.model_factory import new_model
from agents.training.run import train
from agents.training.tables import training_tables
from baselines.planning.ekf import model_error
from baselines.planning.model import PlanningModel
from baselines.registry import make_baseline
from shake_env import make_scenario
from shake_env.errors import ParameterError
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.scenario.uncertainty import Uncertainty


def model_of(kind, teacher="lqg-dac", duration=1.0, **options):
    scenario = make_scenario("laboratory", {"duration": duration})
    env = ShakeTableVecEnv(scenario, 3, base=base_law("lqg", scenario), authority=0.2)
    env.seed(0)
    given = {"seed": 0, "device": "cpu", "sequence_length": 40, "batch_size": 120, **options}
    return Distillation(kind, env, make_baseline(teacher, scenario), **given)


@pytest.mark.parametrize("kind", [DirectPolicy, GRUPolicy, TCNPolicy])
def test_labels_are_what_the_teacher_would_add_to_the_base_controller(kind):
    model = model_of(kind)
    labels = model.collect(by_teacher=True)
    assert labels.correction.shape == (200, 3) and labels.begun[0].all()
    assert len(labels.memory) == 200 // 40
    # Driven by its own labels the tables go where the teacher drives them.
    own = ShakeTableVecEnv(model.env.scenario, 3)
    own.seed(0)
    shown, state, begun = own.reset(), None, np.ones(3, dtype=bool)
    for t in range(200):
        np.testing.assert_allclose(labels.shown[t, :, : shown.shape[1]], shown, atol=2e-5)
        action, state = model.teacher.predict(shown, state, begun)
        shown, _, begun, _ = own.step(action)


@pytest.mark.parametrize("kind", [DirectPolicy, GRUPolicy, TCNPolicy])
def test_a_student_comes_near_its_teacher_where_it_drives_itself(kind):
    model = model_of(kind, learning_rate=2e-3, n_epochs=4)
    model.learn(3 * 200 * 3)
    first, last = model.rounds[0], model.rounds[-1]
    assert len(model.rounds) == 3
    mean = [0.0]
    memory, errors = model._rest(3), []
    torch = pytest.importorskip("torch")
    with torch.no_grad():
        for t in range(200):
            mean, memory = model._mean(
                torch.from_numpy(last.shown[t]), memory, torch.from_numpy(last.begun[t])
            )
            errors.append(mean.numpy() - last.correction[t])
    assert np.std(errors) < 0.5 * np.std(last.correction)
    assert not np.array_equal(first.shown[50], last.shown[50])


def test_a_convolution_is_fitted_to_what_it_does_at_the_table():
    """Sequences cut out of a round mean what the student means there, whatever stood before them."""
    torch = pytest.importorskip("torch")
    model = model_of(TCNPolicy, duration=0.65)  # 130 periods: the last sequence begins within an episode
    labels = model.collect(by_teacher=True)
    assert labels.begun[130].all() and len(labels.begun) == 160
    expected, memory = [], model._rest(3)
    with torch.no_grad():
        for t in range(160):
            mean, memory = model._mean(
                torch.from_numpy(labels.shown[t]), memory, torch.from_numpy(labels.begun[t])
            )
            expected.append(mean.numpy())
        model.rounds = [labels]
        found = [
            (label.numpy(), model._means(shown, memory, begun)[-40:].numpy())
            for shown, label, begun, memory in model._batches()
        ]
    wanted = dict(zip(labels.correction.ravel(), np.ravel(expected), strict=True))
    assert len(wanted) == 160 * 3  # a label names its place
    for label, mean in found:
        places = np.array([wanted[each] for each in label.ravel()])
        np.testing.assert_allclose(mean.ravel(), places, rtol=1e-4, atol=1e-6)
    assert sum(label.size for label, _ in found) == 160 * 3


def test_an_informed_teacher_is_told_the_plant_of_each_table():
    """Also those that are drawn while the others go on."""
    config = TrainConfig(
        algorithm="dagger",
        dagger=DaggerOptions(teacher="nmpc-informed", n_envs=3),
        scenario=ScenarioOptions("field"),
        episode_duration=0.5,
    )
    env = training_tables(config, config.scenario.build())
    told = new_model(config, config.scenario.build(), env).teacher
    shown = env.reset()[:, : env.scenario.observation.size]
    _, state = told.predict(shown, None, np.ones(3, dtype=bool))
    first = state[0].tables.models[0].copy()
    begun = np.array([False, True, False])
    env.simulation.plant_batch.sample([1], [np.random.default_rng(5)])
    _, state = told.predict(shown, state, begun)
    for n, plant in enumerate(env.simulation.plant_batch.plants):
        own = PlanningModel.of(replace(plant, uncertainty=Uncertainty()), model_error(env.scenario, 0.1))
        np.testing.assert_array_equal(state[0].tables.models[0][n], own.arrays[0][0])
    assert not np.array_equal(state[0].tables.models[0][1], first[1])
    with pytest.raises(ParameterError, match="draws no plant"):
        other = replace(config, scenario=ScenarioOptions("laboratory"))
        new_model(other, other.scenario.build(), training_tables(other, other.scenario.build()))


def test_old_rounds_are_dropped():
    model = model_of(DirectPolicy, buffer_size=1000, duration=0.2)
    model.learn(120 * 12)
    assert 1000 <= sum(each.samples for each in model.rounds) < 1000 + 2 * 120


def test_a_teacher_knows_what_its_table_was_given():
    """Without last action in the observation, a plan's memory is told the student's command."""
    scenario = make_scenario("yielding", {"duration": 0.1})
    env = ShakeTableVecEnv(scenario, 2, authority=0.1)
    env.seed(0)
    assert not scenario.sensing.last_action
    told = []

    class Recorder:
        inner = make_baseline("nmpc", scenario)

        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            if state is not None:
                told.append(state[0].current / scenario.current_limit)
            return self.inner.predict(observation, state, episode_start)

    model = Distillation(DirectPolicy, env, Recorder(), seed=0, sequence_length=10, device="cpu")
    torch = pytest.importorskip("torch")
    model.policy.action_net.bias.data.fill_(0.5)
    with torch.no_grad():
        model.policy.action_net.weight.zero_()
    model.collect(by_teacher=False)
    np.testing.assert_allclose(told, 0.05, rtol=1e-6)


def test_it_needs_tables():
    with pytest.raises(ParameterError, match="must be a ShakeTableVecEnv"):
        Distillation(DirectPolicy, "Pendulum-v1", None)


CONFIG = TrainConfig(
    algorithm="dagger",
    scenario=ScenarioOptions("laboratory"),
    dagger=DaggerOptions(teacher="lqg-dac", base_controller="lqg", n_envs=4, batch_size=400),
    episode_duration=0.5,
    total_timesteps=1200,
    evaluations=2,
    evaluation_earthquakes=2,
    net_arch=(16,),
)


def test_a_run_writes_a_policy_that_drives_tables(tmp_path):
    train(CONFIG, tmp_path / "run")
    policy = load_policy(tmp_path / "run" / "policy.safetensors")
    assert policy.card["config"]["algorithm"] == "dagger"
    scenario = CONFIG.scenario.build()
    rows, _ = rollout(policy, scenario, noise_earthquakes(scenario, 2, 0))
    assert all(np.isfinite(row.cost) for row in rows)
