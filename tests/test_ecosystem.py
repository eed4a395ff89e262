"""What other people's tools make of this package: Gymnasium's wrappers, SB3, python-control, pandas."""

from dataclasses import fields

import control
import gymnasium
import numpy as np
import pandas
import pytest
import torch
from gymnasium import wrappers
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

from agents.evaluation.comparison import compare
from agents.evaluation.fidelity import Fidelity
from agents.evaluation.results import COLUMNS, GroupSummary
from agents.learning.features import LinearFeatures, feature_matrix, feature_sizes
from agents.learning.wrappers import TrackingFeatures
from baselines.analysis.python_control import (
    OUTPUTS,
    ControlLaw,
    driven_to_control,
    from_control,
    state_names,
    to_control,
)
from baselines.lqr.sampled import lqr, sampled_lqr
from shake_env import make_scenario
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.discretization import DiscreteStateSpace
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.simulation.metrics import EpisodeMetrics

SHORT = {"duration": 0.5}  # 100 control periods


def make(**options):
    return gymnasium.make("shake_env:ShakeTable-v0", **SHORT, **options)


def played(env, steps, seed=0):
    """Observations and rewards under one sequence of actions, and how the last step ended."""
    observation, _ = env.reset(seed=seed)
    actions = np.random.default_rng(1).uniform(-0.2, 0.2, (steps, 1)).astype(np.float32)
    observations, rewards = [observation], []
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(action)
        observations.append(observation)
        rewards.append(reward)
    return np.asarray(observations), np.asarray(rewards), (terminated, truncated, info)


def test_time_limit_cuts_an_episode():
    *_, (terminated, truncated, _) = played(wrappers.TimeLimit(make(), 20), 20)
    assert truncated and not terminated


def test_record_episode_statistics_sums_the_rewards():
    _, rewards, (_, truncated, info) = played(wrappers.RecordEpisodeStatistics(make()), 100)
    assert truncated
    assert info["episode"]["l"] == 100
    assert info["episode"]["r"] == pytest.approx(rewards.sum(), rel=1e-6)


def test_normalize_observation_leaves_the_loop_alone():
    """It changes what is seen, not what happens: rewards are those of the bare environment."""
    seen, rewards, _ = played(wrappers.NormalizeObservation(make()), 100)
    bare, expected, _ = played(make(), 100)
    assert np.array_equal(rewards, expected)
    assert seen.shape == bare.shape and not np.allclose(seen[1:], bare[1:])


def test_frame_stack_holds_the_last_observations():
    seen, _, _ = played(wrappers.FrameStackObservation(make(), 3), 10)
    bare, _, _ = played(make(), 10)
    for k in range(3):
        assert np.array_equal(seen[2:, k], bare[k : len(bare) - 2 + k])


def test_flatten_observation_of_stacked_frames():
    env = wrappers.FlattenObservation(wrappers.FrameStackObservation(make(), 3))
    seen, _, _ = played(env, 5)
    assert seen.shape == (6, 3 * make().observation_space.shape[0])
    assert env.observation_space.contains(seen[-1])


def test_rescale_action_changes_the_unit_and_not_the_table():
    env = wrappers.RescaleAction(make(), np.float32(-5.0), np.float32(5.0))
    env.reset(seed=0)
    bare = make()
    bare.reset(seed=0)
    theirs = env.step(np.array([1.0], np.float32))
    ours = bare.step(np.array([0.2], np.float32))
    # The wrapper divides in float32: one rounding of the action.
    assert np.allclose(theirs[0], ours[0], atol=1e-6)
    assert theirs[4]["current"] == pytest.approx(ours[4]["current"], rel=1e-6)


def test_wrappers_of_a_batch():
    envs = gymnasium.make_vec(
        "shake_env:ShakeTable-v0", num_envs=3, vectorization_mode="vector_entry_point", **SHORT
    )
    envs = wrappers.vector.NormalizeObservation(wrappers.vector.RecordEpisodeStatistics(envs))
    envs.reset(seed=0)
    total = np.zeros(3)
    for _ in range(100):
        _, reward, _, truncated, info = envs.step(np.zeros((3, 1), np.float32))
        total += reward
    assert truncated.all()
    assert np.allclose(info["episode"]["r"], total, rtol=1e-5)  # the wrapper sums in float32


def test_sb3_checks_the_environment():
    for scenario in ("linear", "laboratory"):
        check_env(make(scenario=scenario).unwrapped)


def test_sb3_make_vec_env_trains():
    envs = make_vec_env("shake_env:ShakeTable-v0", n_envs=2, seed=0, env_kwargs=SHORT)
    model = PPO("MlpPolicy", envs, n_steps=64, batch_size=64, n_epochs=1, seed=0)
    before = model.policy.action_net.weight.detach().clone()
    model.learn(256)
    assert model.num_timesteps == 256
    assert not np.array_equal(before, model.policy.action_net.weight.detach())


def test_sb3_evaluate_policy_takes_any_controller():
    """It runs the same episodes as a plain loop over an environment of the same seed."""
    controller = lqr(make_scenario("linear", SHORT))
    env, plain = Monitor(make()), make()
    env.reset(seed=5)
    plain.reset(seed=5)
    returns, lengths = evaluate_policy(controller, env, 3, return_episode_rewards=True, warn=False)
    expected = []
    for _ in range(3):
        observation, _ = plain.reset()
        total, truncated = 0.0, False
        while not truncated:
            action, _ = controller.predict(observation)
            observation, reward, _, truncated, _ = plain.step(action)
            total += reward
        expected.append(total)
    assert lengths == [100, 100, 100]
    # SB3 keeps rewards in float32, and Monitor rounds the sum to six decimals.
    assert returns == pytest.approx(expected, rel=1e-5)


def test_tracking_features_are_what_training_sees():
    scenario = make_scenario("laboratory", SHORT)
    bare, env = make(scenario="laboratory"), TrackingFeatures(make(scenario="laboratory"))
    check_env(env)
    extractor = LinearFeatures(
        bare.observation_space, feature_matrix(scenario).tolist(), sizes=feature_sizes(scenario).tolist()
    )
    seen, _, _ = played(env, 20)
    states, _, _ = played(bare, 20)
    # The same product in another order of summation, in float32.
    expected = extractor(torch.from_numpy(states)).numpy()
    assert np.allclose(seen, expected, rtol=1e-4, atol=1e-4)


# python-control


def test_the_plant_goes_out_with_names():
    plant = make_scenario("linear", {"stories": 3}).plant
    system = to_control(plant)
    assert isinstance(system, control.StateSpace) and system.dt == 0
    assert np.array_equal(system.A, to_control(plant).A)
    assert system.input_labels == ["current", "white_noise"]
    assert tuple(system.output_labels) == OUTPUTS
    assert system.state_labels == state_names(plant)
    assert "ground_filter_x_w_dot" in system.state_labels
    assert "reference_floor_3_velocity" in system.state_labels
    omega = np.geomspace(0.5, 200.0, 7)
    ours = plant.coupled.frequency_response(omega)
    # Relative to the largest entry of an output: what the target reaches by no path is zero to rounding.
    size = np.abs(ours).max(axis=(0, 2), keepdims=True)
    assert np.allclose(np.moveaxis(system(1j * omega), -1, 0) / size, ours / size, atol=1e-9)


def test_connected_by_name_the_driven_plant_under_its_filter_is_the_whole():
    """python-control's own interconnection, by signal names, against the plant of eq. 13."""
    plant = make_scenario("linear").plant
    driven = driven_to_control(plant)
    w = plant.layout.filter_states
    A, B, C = plant.coupled.A[:w, :w], plant.coupled.B[:w, 1:], plant.coupled.C[2:3, :w]
    ground = control.ss(
        A, B, C, [[0.0]], inputs=["white_noise"], outputs=["target_acceleration"], name="ground"
    )
    outputs = ["table_acceleration", "base_shear", "target_acceleration", "reference_base_shear"]
    whole = control.interconnect([driven, ground], inputs=["current", "white_noise"], outputs=outputs)
    s = 1j * np.geomspace(0.5, 200.0, 5)
    ours = to_control(plant)(s)
    size = np.abs(ours).max(axis=(1, 2), keepdims=True)
    assert np.allclose(whole(s) / size, ours / size, atol=1e-9)


def test_continuous_and_discrete_come_back_as_they_went():
    scenario = make_scenario("linear")
    back = from_control(to_control(scenario.plant, scaled=False))
    for name in "ABCD":
        assert np.array_equal(getattr(back, name), getattr(scenario.plant.coupled, name))
    again = from_control(to_control(scenario.discrete, scaled=False))
    assert isinstance(again, DiscreteStateSpace) and again.dt == scenario.physics_step
    assert np.array_equal(again.A, scenario.discrete.model.A)


def test_the_discrete_plant_is_the_continuous_one_sampled_by_python_control():
    scenario = make_scenario("linear")
    sampled = control.c2d(to_control(scenario.plant)[:, "current"], scenario.physics_step, "zoh")
    ours = to_control(scenario.discrete)
    assert np.allclose(sampled.A, ours.A, atol=1e-12)
    assert np.allclose(sampled.B, ours.B, atol=1e-12 * np.abs(ours.B).max())


def test_a_gain_of_python_control_is_ours():
    """A weighed position makes the continuous problem well posed; python-control solves the same one."""
    scenario = make_scenario("linear", {"highpass_frequency": 0.5})
    system = to_control(scenario.plant)[:, "current"]
    errors = system.C[[0, 1]] - system.C[[2, 3]]
    place = scenario.plant.layout.table_displacement
    Q = errors.T @ np.diag([1.0, 1e-6]) @ errors
    Q[place, place] += 1e-2
    gain, _, poles = control.lqr(system.A, system.B, Q, np.array([[1e3]]))
    assert poles.real.max() < 0.0
    law = -np.ravel(gain) / scenario.plant.state_scale
    closed = scenario.plant.coupled.A + scenario.plant.coupled.B[:, :1] @ law[None, :]
    scale = scenario.plant.state_scale
    ours = np.linalg.eigvals(closed * scale / scale[:, None])
    assert np.allclose(np.sort(ours.real), np.sort(poles.real), rtol=1e-6)


def test_a_system_without_its_step_is_refused():
    with pytest.raises(ParameterError, match="step in seconds"):
        from_control(control.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], True))


def static(scenario, gain, inputs, dt=None):
    dt = scenario.control_period if dt is None else dt
    return control.ss([], [], [], np.atleast_2d(gain), dt, inputs=inputs, outputs=["current"])


def test_a_static_law_is_lqr():
    scenario = make_scenario("linear", SHORT)
    gain = sampled_lqr(scenario.discrete, scenario.stage_cost).gain
    law = ControlLaw(scenario, static(scenario, -gain, state_names(scenario.plant)))
    quakes = noise_earthquakes(scenario, 3)
    ours, _ = rollout(lqr(scenario), scenario, quakes)
    theirs, _ = rollout(law, scenario, quakes)
    for a, b in zip(ours, theirs, strict=True):
        # Actions are float32; the two sums round in another order.
        assert b.cost == pytest.approx(a.cost, rel=1e-5)


def test_a_law_with_memory_runs_as_python_control_runs_it():
    scenario = make_scenario("laboratory", SHORT)
    system = control.ss(
        [[0.9]], [[0.2, -0.1]], [[0.5]], [[0.0, -0.03]], scenario.control_period,
        inputs=["table_displacement", "table_velocity"], outputs=["current"],
    )  # fmt: skip
    law, layout = ControlLaw(scenario, system), scenario.observation
    readings = np.random.default_rng(0).normal(0.0, 0.01, (40, layout.size)).astype(np.float32)
    memory, currents = None, []
    for t, observation in enumerate(readings):
        action, memory = law.predict(observation, memory, np.array([t == 0]))
        currents.append(action[0] * scenario.current_limit)
    places = [layout.readings.start + layout.reading_names.index(n) for n in system.input_labels]
    scale = layout.reading_scale[[layout.reading_names.index(n) for n in system.input_labels]]
    _, expected = control.forced_response(system, U=(readings[:, places] * scale).T)
    assert np.allclose(currents, np.ravel(expected), atol=1e-7 * scenario.current_limit)
    both, _ = law.predict(readings[:2], (np.ones((2, 1)),), np.array([True, False]))
    alone, _ = law.predict(readings[0], None, np.array([True]))
    assert both[0] == pytest.approx(alone) and not np.isclose(both[1], alone)


def test_a_law_that_does_not_fit_is_refused():
    scenario = make_scenario("laboratory", SHORT)
    with pytest.raises(ScenarioError, match="table_displacement"):
        ControlLaw(scenario, static(scenario, [1.0], ["table_displacment"]))
    with pytest.raises(ParameterError, match="control period"):
        ControlLaw(scenario, static(scenario, [1.0], ["table_velocity"], dt=0.001))
    with pytest.raises(ParameterError, match="one current"):
        two = control.ss([], [], [], [[1.0], [1.0]], scenario.control_period, inputs=["table_velocity"])
        ControlLaw(scenario, two)


# pandas


@pytest.fixture(scope="module")
def comparison():
    scenario = make_scenario("linear", SHORT)
    return compare(scenario, ("lqr", "none"), noise=3, records=False, seed=0)


def test_episodes_as_a_frame(comparison):
    frame = comparison.to_frame()
    assert isinstance(frame, pandas.DataFrame) and len(frame) == 6
    ours = [row.cost for row in comparison.episodes["lqr"]]
    assert frame[frame.controller == "lqr"].cost.tolist() == ours
    assert frame.attrs["units"]["peak_displacement"] == "m"


def test_summaries_as_a_frame_agree_with_its_episodes(comparison):
    summaries = comparison.to_frame("summaries").set_index("controller")
    means = comparison.to_frame().groupby("controller").cost.mean()
    assert means["none"] / means["lqr"] == pytest.approx(summaries.relative_cost["none"])


def test_traces_as_a_frame(comparison):
    frame = comparison.to_frame("traces")
    one = frame[frame.controller == "lqr"]
    assert np.array_equal(one.base_shear, comparison.traces["lqr"].base_shear)
    assert frame.attrs["units"]["base_shear"] == "N" and len(frame) == 2 * 500


def test_every_column_has_a_unit_and_a_meaning():
    named = {field.name for kind in (EpisodeMetrics, Fidelity, GroupSummary) for field in fields(kind)}
    assert named <= set(COLUMNS)
    assert all(column.meaning for column in COLUMNS.values())


def test_another_word_is_refused(comparison):
    with pytest.raises(ParameterError, match="episodes, summaries, traces"):
        comparison.to_frame("rows")
