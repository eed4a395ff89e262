"""A plan beside the table: what is shown of it, corrected or not, put back, and as a controller."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from stable_baselines3 import PPO

pytest.importorskip("numba")

from agents.learning import (
    PairedVecEnv,
    PlanVectorWrapper,
    PlanWrapper,
    SB3Controller,
    ShakeTableVecEnv,
    TrainingWrapper,
    make_sb3_env,
)
from agents.learning.apg.window_rollout import WindowRollout
from agents.policies import PlanLaw, PlanOptions
from baselines.lqr.preview import preview_lqr
from baselines.planning.nmpc import NMPCSettings, NonlinearPredictiveControl
from baselines.planning.planned import plan_records
from baselines.registry import make_baseline
from shake_env import make_scenario
from shake_env.errors import ParameterError, ScenarioError, ShakeError
from shake_env.motion.targets import FilteredNoise, MotionSet, RecordedMotion
from shake_env.rollout import Earthquake, noise_earthquakes, rollout
from shake_env.scenario.limits import Limits
from shake_env.scenario.observation import Sensing

CORRECTED = PlanOptions(corrected=True)
SHORT = RecordedMotion(record="napa2014_68150_hne", amplitude=0.1, duration=0.8)
OTHER = replace(SHORT, record="ridgecrest2019_ccc_90", duration=0.6)


class Still:
    """A model that corrects nothing, and counts what it is shown."""

    def __init__(self, action=0.0):
        self.action, self.shown = action, []

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.shown.append(np.array(observation))
        return np.full((*observation.shape[:-1], 1), self.action, np.float32), state


@pytest.fixture(scope="module")
def laboratory():
    return make_scenario("laboratory", {"duration": 0.5})


@pytest.fixture(scope="module")
def law(laboratory):
    return PlanLaw.from_options(laboratory, CORRECTED)


def test_on_a_linear_table_without_limits_the_current_shown_is_preview_lqrs():
    scenario = replace(
        make_scenario("laboratory"),
        nonlinearity=make_scenario("linear").nonlinearity,
        delay=0.0,
        limits=Limits(),
        sensing=Sensing(preview=0.1),
        current_limit=1.0,
    )
    planner = NonlinearPredictiveControl(scenario, NMPCSettings(displacement_tolerance=0.05))
    design = preview_lqr(scenario.discrete, scenario.stage_cost, 0.1, None, 0.05)
    layout, rms = scenario.observation, np.sqrt(scenario.plant.target_variance)
    env = gymnasium.make("shake_env:ShakeTable-v0", scenario=scenario)
    env = PlanWrapper(env, PlanLaw(scenario, planner, ahead=(0, 3)))
    shown, _ = env.reset(seed=5)
    for _ in range(40):
        x = shown[: scenario.plant.layout.order] * scenario.plant.state_scale
        expected = -design.gain @ x + design.preview_gain @ (shown[layout.preview] * rms)
        # The current limit is 1 A; tolerances are those of `test_nmpc` and of single precision.
        assert shown[layout.size] == pytest.approx(expected, abs=1e-7, rel=1e-7)
        shown, *_ = env.step(np.zeros(1, np.float32))


def test_the_signals_shown_are_those_that_then_come_on_a_linear_table_without_noise():
    """A plan of a period is followed, and nothing that it does not know happens to the table."""
    scenario = replace(
        make_scenario("laboratory"),
        nonlinearity=make_scenario("linear").nonlinearity,
        delay=0.0,
        limits=Limits(),
        sensing=Sensing(preview=0.1),
    )
    planner = NonlinearPredictiveControl(scenario)
    law = PlanLaw(scenario, planner)
    env = PlanWrapper(gymnasium.make("shake_env:ShakeTable-v0", scenario=scenario), law)
    shown, _ = env.reset(seed=5)
    places = [
        law.names.index(f"planned {signal} 0 periods ahead [{unit}]") - law.shown
        for signal, unit in (("table acceleration", "m/s^2"), ("base shear", "N"))
    ]
    rms = np.sqrt(scenario.plant.target_variance)
    for _ in range(60):
        before = shown
        shown, _, _, _, info = env.step(np.zeros(1, np.float32))
        sizes = rms, scenario.specimen.mass * rms
        came = info["table_acceleration"] / sizes[0], info["base_shear"] / sizes[1]
        # The observation and the action are rounded to single precision.
        np.testing.assert_allclose(before[places], came, atol=2e-4)


@pytest.mark.parametrize("name", ["laboratory", "yielding", "field"])
def test_what_is_appended_is_what_nmpc_decides_and_expects(name):
    scenario = make_scenario(name, {"duration": 0.5})
    options = replace(CORRECTED, ahead=(0, 2, 11))
    env = PlanWrapper(gymnasium.make("shake_env:ShakeTable-v0", scenario=scenario), options)
    planner, state = make_baseline("nmpc", scenario), None
    assert len((*scenario.observation.names, *env.plan.names)) == env.observation_space.shape[0]
    assert env.plan.names[1] == "planned current 2 periods ahead [-]"
    shown, _ = env.reset(seed=3)
    for _ in range(60):
        own = shown[None, : scenario.observation.size]
        action, state = planner.predict(own, state, np.array([state is None]))
        expected = np.concatenate(planner.expected(state[0], (0, 2, 11)), axis=1)[0]
        plan = shown[scenario.observation.size :]
        np.testing.assert_array_equal(plan[0], action[0, 0])
        sizes = scenario.current_limit, (rms := np.sqrt(scenario.plant.target_variance))
        sizes = np.repeat([*sizes, scenario.specimen.mass * rms], 3)
        np.testing.assert_array_equal(plan, (expected / sizes).astype(np.float32))
        shown, *_ = env.step(np.zeros(1, np.float32))
    assert np.abs(plan).min() > 0.0


@pytest.mark.parametrize("name", ["laboratory", "yielding"])
def test_no_correction_costs_exactly_what_nmpc_costs(name):
    scenario = make_scenario(name, {"duration": 0.5})
    quakes = noise_earthquakes(scenario, 3, 3_000_000)
    own, _ = rollout(make_baseline("nmpc", scenario), scenario, quakes)
    model = Still()
    controller = SB3Controller(model, scenario, base_controller="nmpc", action_scale=0.02)
    corrected, _ = rollout(controller, scenario, quakes)
    assert [row.cost for row in corrected] == [row.cost for row in own]
    costs = []
    for quake in quakes:  # and the wrapper
        env = PlanWrapper(gymnasium.make("shake_env:ShakeTable-v0", scenario=scenario), CORRECTED)
        env.reset(seed=quake.seed)
        rewards, done = [], False
        while not done:
            _, reward, terminated, truncated, _ = env.step(np.zeros(1, np.float32))
            rewards.append(reward)
            done = terminated or truncated
        costs.append(-np.mean(rewards))
    np.testing.assert_allclose(costs, [row.cost for row in own], rtol=1e-6)  # rewards of single lanes


def test_a_correction_is_added_to_the_plan_and_the_planner_knows_what_was_given():
    """Where no last action is shown, the planner's filter depends on the memory of it."""
    scenario = make_scenario("yielding", {"duration": 0.5})
    env = PlanWrapper(gymnasium.make("shake_env:ShakeTable-v0", scenario=scenario), CORRECTED,
                      action_scale=0.1)  # fmt: skip
    planner = make_baseline("nmpc", scenario)
    shown, _ = env.reset(seed=3)
    state, limit, n = None, scenario.current_limit, scenario.observation.size
    for step in range(40):
        action, state = planner.predict(shown[None, :n], state, np.array([step == 0]))
        assert shown[n] == pytest.approx(action[0, 0], abs=1e-6)
        correction = np.float32(np.sin(step))
        shown, *_, info = env.step(np.array([correction]))
        given = np.clip(action[0, 0] + 0.1 * correction, -1.0, 1.0)
        assert info["current"] == pytest.approx(given * limit, abs=1e-6 * limit)
        state = (replace(state[0], current=np.array([given * limit])),)


def test_without_correction_the_plan_is_shown_and_the_action_acts_alone(laboratory):
    env = PlanWrapper(gymnasium.make("shake_env:ShakeTable-v0", scenario=laboratory), action_scale=0.5)
    alone = gymnasium.make("shake_env:ShakeTable-v0", scenario=laboratory)
    shown, _ = env.reset(seed=1)
    bare, _ = alone.reset(seed=1)
    for step in range(30):
        action = np.array([0.4 * np.cos(0.1 * step)], np.float32)
        np.testing.assert_array_equal(shown[: len(bare)], bare)
        shown, *_ = env.step(action)
        bare, *_ = alone.step(0.5 * action.astype(float))
    assert np.abs(shown[len(bare) :]).max() > 0.0


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_a_batch_is_what_each_table_is_alone(laboratory, law, mode):
    batch = gymnasium.make_vec("shake_env:ShakeTable-v0", num_envs=3, scenario=laboratory,
                               vectorization_mode="vector_entry_point",
                               autoreset_mode=gymnasium.vector.AutoresetMode(mode))  # fmt: skip
    batch = PlanVectorWrapper(batch, law, action_scale=0.1)
    alone = [
        PlanWrapper(
            gymnasium.make("shake_env:ShakeTable-v0", scenario=laboratory), law, action_scale=0.1
        )
        for _ in range(3)
    ]
    shown, _ = batch.reset(seed=7)
    single = np.stack([env.reset(seed=7 + i)[0] for i, env in enumerate(alone)])
    assert batch.observation_space.contains(shown)
    rng, over = np.random.default_rng(0), False
    for _ in range(130):
        # Products of a batch and of a single row may be summed in another order, the last bits differ.
        np.testing.assert_allclose(shown, single, atol=1e-5)
        actions = rng.uniform(-1.0, 1.0, (3, 1)).astype(np.float32)
        if over and mode == "Disabled":
            shown, _ = batch.reset(options={"reset_mask": np.ones(3, dtype=bool)})
            single, over = np.stack([env.reset()[0] for env in alone]), False
            continue
        shown, _, _, truncated, info = batch.step(actions)
        if over:  # the next step
            single, over = np.stack([env.reset()[0] for env in alone]), False
            continue
        single = np.stack([env.step(a)[0] for env, a in zip(alone, actions, strict=True)])
        over = truncated.all()
        if over and mode == "SameStep":
            np.testing.assert_allclose(np.stack(info["final_obs"]), single, atol=1e-5)
            single, over = np.stack([env.reset()[0] for env in alone]), False


def vectorised(kind, scenario, law, lanes):
    if kind == "sb3":
        env = ShakeTableVecEnv(scenario, lanes, base=law, authority=0.1)
        env.seed(11)
        return env, env.reset(), lambda actions: env.step(actions)[:2]
    env = gymnasium.make_vec("shake_env:ShakeTable-v0", num_envs=lanes, scenario=scenario,
                             vectorization_mode="vector_entry_point")  # fmt: skip
    env = PlanVectorWrapper(env, law, action_scale=0.1)
    return env, env.reset(seed=11)[0], lambda actions: env.step(actions)[:2]


@pytest.mark.parametrize("kind", ["sb3", "gymnasium"])
@pytest.mark.parametrize("name", ["laboratory", "yielding"])
def test_put_back_it_goes_on_to_the_bit_through_an_episodes_end(kind, name):
    scenario = make_scenario(name, {"duration": 0.5})
    law = PlanLaw.from_options(scenario, CORRECTED)
    env, _, step = vectorised(kind, scenario, law, 4)
    rng = np.random.default_rng(1)
    for _ in range(37):
        step(rng.uniform(-1.0, 1.0, (4, 1)).astype(np.float32))
    kept = env.get_state()
    actions = rng.uniform(-1.0, 1.0, (90, 4, 1)).astype(np.float32)
    first = [step(a) for a in actions]
    env.set_state(kept)
    other, _, onward = vectorised(kind, scenario, law, 4)
    other.set_state(kept)
    for a, (shown, reward) in zip(actions, first, strict=True):
        for again in (step(a), onward(a)):
            np.testing.assert_array_equal(again[0], shown)
            np.testing.assert_array_equal(again[1], reward)


def test_shadows_with_the_same_correction_earn_nothing(laboratory, law):
    env = PairedVecEnv(ShakeTableVecEnv(laboratory, 6, base=law, authority=0.02), interval=16)
    env.seed(4)
    env.follow(Still(0.5))
    env.reset()
    for _ in range(130):
        _, reward, _, _ = env.step(np.full((3, 1), 0.5, np.float32))
        # In units of a reward of 1e-3; table and shadow are rows of one product.
        np.testing.assert_allclose(reward, 0.0, atol=1e-9)
    _, reward, _, _ = env.step(np.full((3, 1), -0.5, np.float32))
    assert (reward != 0.0).all()


def test_ppo_corrects_a_plan_paired_and_its_model_is_a_controller(laboratory):
    correction = {"base_controller": "nmpc", "action_scale": 0.02}
    tables = make_sb3_env("laboratory", 4, duration=0.5, **correction)
    env = PairedVecEnv(tables, interval=16)
    model = PPO("MlpPolicy", env, n_steps=16, batch_size=16, n_epochs=1, seed=0, device="cpu")
    env.follow(model)
    model.learn(64)
    shown = []
    model.predict, predict = lambda *a, **k: shown.append(a[0]) or predict(*a, **k), model.predict
    quakes = noise_earthquakes(laboratory, 2, 11)
    rows, _ = rollout(SB3Controller(model, laboratory, **correction), laboratory, quakes)
    own, _ = rollout(make_baseline("nmpc", laboratory), laboratory, quakes)
    assert all(row.broken_limit is None for row in rows)
    assert [row.cost for row in rows] != [row.cost for row in own]
    assert max(np.abs(x).max() for x in shown) < 20.0  # features of the order of 1
    with pytest.raises(ScenarioError, match="observation of the model"):
        SB3Controller(model, laboratory)


def test_a_controller_sees_what_the_tables_showed_in_training(laboratory):
    """The same corrections on the same earthquakes: features and costs agree."""
    quakes = noise_earthquakes(laboratory, 2, 11)
    model = Still(0.5)
    controller = SB3Controller(model, laboratory, base_controller="nmpc", action_scale=0.1)
    rows, _ = rollout(controller, laboratory, quakes)
    env = make_sb3_env("laboratory", 2, duration=0.5, base_controller="nmpc", action_scale=0.1)
    env.seed(11)
    shown, returns = env.reset(), np.zeros(2)
    lane = TrainingWrapper(PlanWrapper(gymnasium.make("shake_env:ShakeTable-v0", scenario=laboratory),
                                       CORRECTED), action_scale=0.1)  # fmt: skip
    single, _ = lane.reset(seed=11)
    for seen in model.shown:
        np.testing.assert_allclose(shown, seen, atol=1e-3)  # single precision over small sizes
        np.testing.assert_allclose(single, seen[0], atol=1e-3)
        shown, _, done, infos = env.step(np.full((2, 1), 0.5, np.float32))
        single, *_ = lane.step(np.array([0.5], np.float32))
    assert done.all()
    returns = [info["episode"]["r"] for info in infos]
    np.testing.assert_allclose(-np.array(returns) / 100, [row.cost for row in rows], rtol=1e-4)


def test_a_model_of_raw_observations_is_a_controller_too(laboratory):
    model = Still()
    controller = SB3Controller(model, laboratory, base_controller=CORRECTED, features=False)
    rollout(controller, laboratory, noise_earthquakes(laboratory, 1, 3))
    env = PlanWrapper(gymnasium.make("shake_env:ShakeTable-v0", scenario=laboratory), CORRECTED)
    shown, _ = env.reset(seed=3)
    for seen in model.shown:
        np.testing.assert_array_equal(seen[0], shown)
        shown, *_ = env.step(np.zeros(1, np.float32))


@pytest.fixture(scope="module")
def recorded():
    motions = MotionSet(motions=(SHORT, OTHER))
    return make_scenario("laboratory", {"motion": motions})


def test_planned_plays_each_episodes_record(recorded):
    quakes = [Earthquake(m.source.name, m, 5 + i) for i, m in enumerate(recorded.motion.scaled)]
    plans = plan_records(recorded, quakes)
    options = replace(CORRECTED, planner="planned")
    law = PlanLaw.from_options(recorded, options)
    env = ShakeTableVecEnv(recorded, 4, base=law, authority=0.1)
    env.seed(0)
    shown, n, seen = env.reset(), recorded.observation.size, set()
    for _ in range(3):
        names = [m.source.name for m in env.simulation.motions]
        seen |= set(names)
        age = env.simulation.step_count.copy()
        for lane, name in enumerate(names):
            plan = next(p for p in plans if p.name == name)
            expected = plan.current[age[lane] + np.array([1, 2, 4, 8])] / recorded.current_limit
            np.testing.assert_allclose(shown[lane, n + 1 : n + 5], expected, rtol=1e-5)
            now = shown[lane, n + 10] * recorded.specimen.mass * np.sqrt(recorded.plant.target_variance)
            assert now == pytest.approx(plan.response[age[lane], -1], rel=1e-5)
        for _ in range(121):  # into the next episode of each
            shown, *_ = env.step(np.zeros((4, 1), np.float32))
    assert seen == {plan.name for plan in plans}
    own, _ = rollout(make_baseline("planned", recorded, earthquakes=quakes), recorded, quakes)
    controller = SB3Controller(Still(), recorded, base_controller="planned", earthquakes=quakes)
    rows, _ = rollout(controller, recorded, quakes)
    assert [row.cost for row in rows] == [row.cost for row in own]


def test_what_has_no_plan_is_refused_with_its_remedy(laboratory, law, recorded, monkeypatch):
    make = gymnasium.make
    with pytest.raises(ParameterError, match=r"nmpc-adaptive.*known: nmpc, planned"):
        PlanOptions(planner="nmpc-adaptive")
    for ahead in ((), (1, 2), (0, 2, 2), (0.0, 1.5), 3):
        with pytest.raises(ParameterError, match=r"ahead.*begin with 0 and increase"):
            PlanOptions(ahead=ahead)
    with pytest.raises(ParameterError, match=r"ahead.*12.*below the 12 control periods"):
        PlanWrapper(make("shake_env:ShakeTable-v0", scenario=laboratory), PlanOptions(ahead=(0, 12)))
    with pytest.raises(ScenarioError, match=r"motion.*recorded motions \(record=NAME\), or take nmpc"):
        PlanWrapper(make("shake_env:ShakeTable-laboratory-v0"), PlanOptions(planner="planned"))
    with pytest.raises(ScenarioError, match="ask for that"):
        PlanWrapper(make("shake_env:ShakeTable-linear-v0"))
    with pytest.raises(ScenarioError, match=r"equations.*need the corrected equations"):
        make_sb3_env("as-printed", 2, base_controller="nmpc", limits="laboratory")
    with pytest.raises(ParameterError, match="ShakeTable environment"):
        PlanWrapper(make("CartPole-v1"))
    with pytest.raises(ParameterError, match="vector_entry_point"):
        PlanVectorWrapper(gymnasium.make_vec("CartPole-v1", num_envs=2))
    with pytest.raises(ScenarioError, match="has no gradient"):
        WindowRollout(ShakeTableVecEnv(laboratory, 2, base=law))
    planned = PlanOptions(planner="planned")
    env = PlanWrapper(make("shake_env:ShakeTable-v0", scenario=recorded), planned)
    with pytest.raises(ScenarioError, match="has no plan"):
        env.reset(seed=0, options={"motion": FilteredNoise(duration=0.5)})
    two = [Earthquake(m.source.name, m) for m in recorded.motion.scaled]
    controller = SB3Controller(Still(), recorded, base_controller=planned, earthquakes=two)
    with pytest.raises(ParameterError, match="there are plans for 2"):
        controller.predict(np.zeros((3, recorded.observation.size), np.float32))
    monkeypatch.setattr("baselines.planning.model.compiled_module", lambda name: None)
    with pytest.raises(ShakeError, match="numba"):
        PlanWrapper(make("shake_env:ShakeTable-v0", scenario=laboratory))
