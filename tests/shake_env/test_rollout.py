"""Roll-outs: metrics against their definitions, broken limits, order, determinism."""

from dataclasses import astuple, replace

import numpy as np
import pytest

from baselines.lqr.sampled import lqr
from shake_env import (
    RECORD_NAMES,
    Controller,
    FilteredNoise,
    Limits,
    NoControl,
    RecordedMotion,
    make_scenario,
)
from shake_env.env import ShakeTableEnv
from shake_env.errors import ActionError, ParameterError
from shake_env.rollout import Earthquake, noise_earthquakes, recorded_earthquakes, rollout
from shake_env.vector_env import ShakeTableVectorEnv

QUAKES = [
    Earthquake("noise", FilteredNoise(duration=2.0), seed=1),
    Earthquake("napa", RecordedMotion(record="napa2014_68150_hne", duration=3.0)),
    Earthquake("weak", FilteredNoise(duration=1.0, amplitude=0.2), seed=2),
]


class Push:
    """A constant action that counts its calls in its memory."""

    def __init__(self, action):
        self.action = action

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        count = 0 if state is None else state[0]
        assert episode_start.all() == (count == 0) and deterministic
        action = np.full((*observation.shape[:-1], 1), self.action, dtype=np.float32)
        return action, (count + 1,)


def numbers(metrics):
    return np.array([astuple(m)[1:-1] for m in metrics], dtype=float)


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def test_metrics_are_those_of_the_trajectory():
    scenario = make_scenario()
    metrics, trajectories = rollout(lqr(scenario), scenario, QUAKES, record=range(3))
    for index, (quake, m) in enumerate(zip(QUAKES, metrics, strict=True)):
        t = trajectories[index]
        steps = round(quake.motion.duration / 5e-3)
        assert m.earthquake == quake.name and m.broken_limit is None
        assert t.time.shape == (5 * steps,) and t.state.shape == (steps, 8)
        assert t.time[[0, -1]] == pytest.approx([1e-3, quake.motion.duration], rel=1e-12)
        assert t.control_time == pytest.approx(t.time[4::5], rel=1e-12)
        error = t.table_acceleration - t.target_acceleration
        assert m.acceleration_rms_error == pytest.approx(rms(error) / rms(t.target_acceleration))
        assert m.acceleration_peak_error == pytest.approx(
            np.max(np.abs(error)) / np.max(np.abs(t.target_acceleration))
        )
        force = t.base_shear - t.reference_base_shear
        assert m.base_shear_rms_error == pytest.approx(rms(force) / rms(t.reference_base_shear))
        assert m.base_shear_peak_error == pytest.approx(
            np.max(np.abs(force)) / np.max(np.abs(t.reference_base_shear))
        )
        assert m.peak_current == np.max(np.abs(t.current))
        assert m.peak_displacement == np.max(np.abs(t.state[:, 1]))
        assert m.peak_velocity == np.max(np.abs(t.state[:, 2]))
        cost = (
            np.mean(error**2) / scenario.plant.target_variance
            + np.mean(force**2) / scenario.plant.reference_shear_variance
            + 0.01 * np.mean((t.current / 0.025) ** 2)
        )
        assert m.cost == pytest.approx(cost, rel=1e-12)
        assert 0.0 < m.acceleration_rms_error < 1.0


def test_the_trajectory_is_the_environments():
    quake = QUAKES[1]
    scenario = make_scenario()
    _, trajectories = rollout(Push(0.05), scenario, [quake], record=[0])
    env = ShakeTableEnv(scenario)
    env.reset(seed=0, options={"motion": quake.motion})
    t = trajectories[0]
    for i in range(len(t.control_time)):
        *_, truncated, info = env.step(np.array([0.05], np.float32))
        last = 5 * i + 4
        assert t.target_acceleration[last] == info["target_acceleration"]
        assert t.table_acceleration[last] == pytest.approx(info["table_acceleration"], rel=1e-10)
        assert t.reference_base_shear[last] == pytest.approx(info["reference_base_shear"], rel=1e-10)
        assert t.base_shear[last] == pytest.approx(info["base_shear"], rel=1e-10)
        assert t.current[i] == pytest.approx(info["current"], rel=1e-12)
    assert truncated


def test_no_control_leaves_all_of_the_target():
    scenario = make_scenario()
    metrics, trajectories = rollout(NoControl(), scenario, QUAKES, record=[0])
    for m in metrics:
        assert m.acceleration_rms_error == pytest.approx(1.0, rel=1e-12)
        assert m.base_shear_rms_error == pytest.approx(1.0, rel=1e-12)
        assert m.acceleration_peak_error == m.base_shear_peak_error == 1.0
        assert (m.peak_current, m.peak_velocity, m.peak_displacement) == (0.0, 0.0, 0.0)
    assert not np.any(trajectories[0].table_acceleration)


def test_lqr_tracks_better_than_nothing_on_every_earthquake():
    scenario = make_scenario("linear", {"duration": 10.0})
    records = [
        replace(q, motion=replace(q.motion, duration=15.0)) for q in recorded_earthquakes(scenario)
    ]
    quakes = [*noise_earthquakes(scenario, 4), *records]
    controlled, _ = rollout(lqr(scenario), scenario, quakes)
    idle, _ = rollout(NoControl(), scenario, quakes)
    for a, b in zip(controlled, idle, strict=True):
        assert a.cost < 0.5 * b.cost and a.base_shear_rms_error < 0.5


def test_a_broken_limit_is_named_and_paid_for():
    scenario = make_scenario("linear", {"limits": Limits(table_displacement=0.02)})
    quakes = [Earthquake("a", FilteredNoise(duration=2.0)), Earthquake("b", FilteredNoise(duration=1.0))]
    metrics, trajectories = rollout(Push(0.1), scenario, quakes, record=[0, 1])
    for index, (m, quake) in enumerate(zip(metrics, quakes, strict=True)):
        assert m.broken_limit == "table_displacement"
        t = trajectories[index]
        total = round(quake.motion.duration / 5e-3)
        ran = len(t.control_time)
        assert ran < total and abs(t.state[-1, 1]) > 0.02 >= np.max(np.abs(t.state[:-1, 1]))
        # Stage costs while it ran, five times the motionless 2 for what remained, over all steps.
        stage = (
            np.mean((t.table_acceleration - t.target_acceleration) ** 2) / scenario.plant.target_variance
            + np.mean((t.base_shear - t.reference_base_shear) ** 2)
            / scenario.plant.reference_shear_variance
            + 0.01 * np.mean((t.current / 0.025) ** 2)
        )
        assert m.cost == pytest.approx((ran * stage + 10.0 * (total - ran)) / total, rel=1e-9)
        # Peaks and errors count what ran.
        assert m.peak_displacement == abs(t.state[-1, 1])
        assert m.acceleration_rms_error == pytest.approx(
            rms(t.table_acceleration - t.target_acceleration) / rms(t.target_acceleration)
        )
    idle, _ = rollout(NoControl(), scenario, quakes)
    assert all(m.cost > i.cost for m, i in zip(metrics, idle, strict=True))


def test_an_unstable_controller_ends_in_numbers():
    # Warnings are errors: nothing overflows after a lane has diverged.
    scenario = make_scenario("linear", {"limits": Limits(state_limit=5.0)})
    controller = lqr(scenario)

    class Inverted:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return -controller.predict(observation)[0], None

    metrics, _ = rollout(Inverted(), scenario, [Earthquake("n", FilteredNoise(duration=20.0))])
    assert metrics[0].broken_limit == "diverged"
    assert np.all(np.isfinite(numbers(metrics)))


def test_the_same_call_gives_the_same_numbers():
    scenario = make_scenario()
    first, _ = rollout(lqr(scenario), scenario, QUAKES)
    again, _ = rollout(lqr(scenario), scenario, QUAKES)
    assert first == again


def test_order_and_company_do_not_matter():
    scenario = make_scenario()
    controller = lqr(scenario)
    together, _ = rollout(controller, scenario, QUAKES)
    backwards, _ = rollout(controller, scenario, QUAKES[::-1])
    # Feedback on float32 observations: a last digit may round the other way in another batch.
    assert numbers(backwards[::-1]) == pytest.approx(numbers(together), rel=1e-4)
    for quake, expected in zip(QUAKES, together, strict=True):
        alone, _ = rollout(controller, scenario, [quake])
        assert numbers(alone)[0] == pytest.approx(numbers([expected])[0], rel=1e-4)
    # Without feedback only the order of sums differs.
    open_loop = [numbers(rollout(Push(0.02), scenario, order)[0]) for order in (QUAKES, QUAKES[::-1])]
    assert open_loop[1][::-1] == pytest.approx(open_loop[0], rel=1e-9)


def test_every_controller_meets_the_same_earthquakes():
    scenario = make_scenario("linear", {"duration": 3.0})
    quakes = noise_earthquakes(scenario, 2, seed=5)
    assert [q.seed for q in quakes] == [5, 6] and len({q.name for q in quakes}) == 2
    targets = []
    for controller in (NoControl(), Push(0.1), lqr(scenario)):
        _, trajectories = rollout(controller, scenario, quakes, record=[0, 1])
        targets.append([trajectories[i].target_acceleration for i in (0, 1)])
    for other in targets[1:]:
        assert np.array_equal(other, targets[0])
    assert not np.array_equal(*targets[0])


def test_seeded_noise_does_not_depend_on_how_many_earthquakes_there_are():
    scenario = make_scenario("linear", {"duration": 1.0})
    _, few = rollout(NoControl(), scenario, noise_earthquakes(scenario, 1), record=[0])
    _, many = rollout(NoControl(), scenario, noise_earthquakes(scenario, 5), record=[0])
    assert few[0].target_acceleration == pytest.approx(many[0].target_acceleration, rel=1e-12, abs=1e-13)


def test_recorded_earthquakes_are_the_six():
    scenario = make_scenario("linear", {"amplitude": 0.4})
    quakes = recorded_earthquakes(scenario)
    assert len(quakes) == 6 and all(q.motion.amplitude == 0.4 for q in quakes)


def test_zero_amplitude_divides_by_nothing():
    scenario = make_scenario()
    quake = Earthquake("silence", FilteredNoise(duration=1.0, amplitude=0.0))
    metrics, _ = rollout(NoControl(), scenario, [quake])
    assert not np.any(numbers(metrics))


def test_progress_is_told():
    shares = []
    scenario = make_scenario()
    rollout(NoControl(), scenario, QUAKES[:1], on_step=shares.append)
    assert shares == sorted(shares) and shares[-1] == 1.0 and 0.0 < shares[0] < 1.0


def test_controllers_are_controllers():
    assert isinstance(NoControl(), Controller) and isinstance(lqr(make_scenario()), Controller)
    assert not isinstance(object(), Controller)
    action, memory = NoControl().predict(np.zeros((4, 14), np.float32))
    assert action.shape == (4, 1) and action.dtype == np.float32 and memory is None
    assert NoControl().predict(np.zeros(14, np.float32))[0].shape == (1,)


def test_no_earthquakes_raise():
    with pytest.raises(ParameterError, match=r"earthquakes = \[\]: give at least one"):
        rollout(NoControl(), make_scenario(), [])


def test_a_controller_that_answers_nonsense_raises():
    with pytest.raises(ActionError, match="finite"):
        rollout(Push(np.nan), make_scenario(), QUAKES[:1])


def test_recorded_earthquakes_are_prepared_as_the_scenarios_own_record():
    plain = recorded_earthquakes(make_scenario("linear", {"amplitude": 0.5}))
    assert [quake.name for quake in plain] == list(RECORD_NAMES)
    assert {quake.motion.amplitude for quake in plain} == {0.5}
    options = {"record": RECORD_NAMES[2], "time_compression": 2.0, "duration": 4.0}
    pressed = recorded_earthquakes(make_scenario("linear", options))
    assert [quake.motion.record for quake in pressed] == list(RECORD_NAMES)
    assert {(quake.motion.time_compression, quake.motion.duration) for quake in pressed} == {(2.0, 4.0)}


@pytest.mark.parametrize("name", ["linear", "laboratory", "unknown-specimen", "records"])
def test_a_seeded_reset_gives_the_protocols_earthquake(name):
    """Single and vector: motion, drawn plant, offsets and noise are those of the roll-out."""
    seed, steps = 4_000_007, 40
    scenario = make_scenario(name)
    quakes = [Earthquake(f"noise {s}", scenario.motion, s) for s in (seed, seed + 1)]
    runs = rollout(Push(0.1), scenario, quakes, record=[0, 1])[1]
    many = ShakeTableVectorEnv(2, scenario)
    shown = [many.reset(seed=seed)[0]]
    many_info = [many.step(np.full((2, 1), 0.1, np.float32)) for _ in range(steps)]
    for lane in range(2):
        env = ShakeTableEnv(scenario)
        first, _ = env.reset(seed=seed + lane)
        np.testing.assert_array_equal(shown[0][lane], first)
        for t in range(steps):
            observation, reward, *_, info = env.step(np.array([0.1], np.float32))
            np.testing.assert_allclose(many_info[t][0][lane], observation, rtol=1e-5, atol=1e-5)
            assert many_info[t][1][lane] == pytest.approx(reward, rel=1e-6)
            for field in ("target_acceleration", "table_acceleration", "base_shear"):
                ours = getattr(runs[lane], field)[5 * (t + 1) - 1]
                assert info[field] == pytest.approx(ours, rel=1e-6, abs=1e-9)
        # The next episode is another one, and the same after every reset with this seed.
        push = np.array([0.1], np.float32)
        again = []
        for own in (None, seed + lane, None):
            env.reset(seed=own)
            again.append(env.step(push)[0])
        np.testing.assert_allclose(again[1], many_info[0][0][lane], rtol=1e-5, atol=1e-5)
        assert not np.allclose(again[0], again[1], rtol=1e-3)
        if not lane and name == "linear":
            env.reset(seed=seed)
            env.reset()
            np.testing.assert_array_equal(env.step(push)[0], again[2])
