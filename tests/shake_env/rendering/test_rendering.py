"""What is drawn: where things stand, that it follows the test and nothing else."""

import copy
import pickle

import numpy as np
import pytest
from drawn_env import run
from PIL import Image

from baselines.registry import make_baseline
from shake_env import NoControl, ShakeTableEnv, make_scenario
from shake_env.rendering.painter import (
    BASE_REACH,
    BASE_TOP,
    BLUE,
    CENTRES,
    HEIGHT,
    ORANGE,
    STRIP_X,
    STRIPS,
    SWAY_REACH,
    WIDTH,
)
from shake_env.rendering.scene import DRIFT_CORNER, SceneRecorder, nice_ceiling, nice_floor
from shake_env.simulation.simulation import Simulation


def coloured(frame, colour, tolerance=40):
    """Mask (height, width) of the pixels near a colour."""
    rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
    return np.abs(frame.astype(int) - rgb).max(axis=-1) < tolerance


def recorded(steps, scenario, current=0.0, seed=0):
    """A recorder fed by a simulation, and the results it was fed."""
    simulation = Simulation(scenario, 1)
    simulation.start([0], [np.random.default_rng(seed)])
    recorder, results = SceneRecorder(scenario), []
    for _ in range(steps):
        result = simulation.step(np.array([current]))
        recorder.add(result)
        results.append((result.outcome.response.state[0].copy(), result.ground.ground[0].copy()))
    return recorder, results


@pytest.mark.parametrize("stories", [1, 2, 10])
def test_at_rest_the_reference_stands_as_the_specimen_does(stories):
    frame = run(0, stories=stories)[1][0]
    assert frame.shape == (HEIGHT, WIDTH, 3) and frame.dtype == np.uint8
    masks = []
    for centre, colour in zip(CENTRES, (BLUE, ORANGE), strict=True):
        x = slice(round(centre) - 60, round(centre) + 60)
        masks.append(coloured(frame[50 : round(BASE_TOP), x], colour))
    assert np.array_equal(*masks)
    # Floors fill a share of the picture that no stray line does.
    assert masks[0].sum() > 300 * stories


def test_floors_are_drawn_where_the_state_says():
    env, frames = run(400, stories=1)
    scene = env._view._recorder.scene()
    frame = env._view._painter.paint(scene)
    assert len(frames) == 401
    for i, colour in enumerate((BLUE, ORANGE)):
        rows, columns = np.nonzero(coloured(frame[50 : round(BASE_TOP) - 30], colour))
        assert len(rows)
        drawn = (columns.min() + columns.max() + 1) / 2.0
        expected = (
            CENTRES[i]
            + scene.base[i] * BASE_REACH / scene.scales[0]
            + scene.sway[i, 0] * SWAY_REACH / scene.scales[1]
        )
        # The floor is found to whole pixels, and its outline is half a pixel wide.
        assert drawn == pytest.approx(expected, abs=1.0)


@pytest.mark.parametrize("controller", [NoControl(), None], ids=["none", "lqr"])
def test_strips_show_the_target_and_what_was_achieved(controller):
    env, _ = run(230, controller=controller)
    scene = env._view._recorder.scene()
    frame = env._view._painter.paint(scene)
    # At each strip's right end the blue line stands at the present value.
    for (top, bottom), history, scale in zip(
        STRIPS, (scene.acceleration, scene.shear), scene.scales[2:], strict=True
    ):
        x = round(STRIP_X[1]) - 2
        strip = frame[round(top) : round(bottom), x - 1 : x + 1].astype(int)
        height = (top + bottom) / 2.0 - history[-4:] * (bottom - top) / (2.0 * scale) - round(top)
        blueness = strip[..., 2] - strip[..., 0]
        for column, ink in ((0, blueness), (1, -blueness)):
            rows = np.nonzero(ink.max(axis=1) > 60)[0]
            assert len(rows), "no line at the end of the strip"
            # Two pixels are 14 ms, three steps, over which the line runs; half its width is two more.
            assert rows.min() <= height[:, column].max() + 2.0
            assert rows.max() >= height[:, column].min() - 2.0
        if controller is not None:  # a table that stands still is told from its target
            apart = np.abs(history[:, 0] - history[:, 1]) * (bottom - top) / (2.0 * scale)
            assert apart.max() > 5.0  # not at every moment: the target passes through zero


def test_true_positions_where_the_stroke_is_limited():
    scenario = make_scenario("yielding", {})
    recorder, results = recorded(400, scenario, current=0.02)
    state, ground = results[-1]
    assert recorder.true_positions
    scene = recorder.scene()
    assert scene.base.tolist() == [state[1], ground[2]]
    assert scene.stroke == state[1] and abs(state[1]) > 1e-4
    n = scenario.specimen.stories
    assert np.array_equal(scene.sway[0], state[4 : 4 + n])


def test_without_limits_table_and_ground_lose_their_drift_alike():
    # A sine far above the corner passes the high-pass but for (corner / f)^2, with a phase near nothing.
    scenario = make_scenario("linear", {})
    recorder = SceneRecorder(scenario)
    step, frequency = scenario.physics_step, 30.0 * DRIFT_CORNER
    omega = 2.0 * np.pi * frequency
    acceleration = -(omega**2) * np.sin(omega * step * np.arange(1, 20_001))
    table = []
    for value in acceleration:
        recorder._without_drift(np.array([[value, value]]))
        table.append(recorder._base[:, 0].copy())
    table = np.array(table)
    assert np.array_equal(table[:, 0], table[:, 1])
    settled = table[10_000:, 0]  # 10 s: 13 time constants of the filter
    # 2 z / 30 of velocity is the filter's phase; half the step omega h / 2 the integration's.
    assert np.abs(settled).max() == pytest.approx(1.0, abs=1.4 / 30 + omega * step / 2)


def test_frames_show_the_moment_and_nothing_else():
    _, often = run(120, frame_rate=200.0)
    _, again = run(120, frame_rate=200.0)
    env, _ = run(0)
    assert all(np.array_equal(a, b) for a, b in zip(often, again, strict=True))
    assert all(not np.array_equal(a, b) for a, b in zip(often[1:], often[:-1], strict=True))
    other = run(120, seed=4, frame_rate=200.0)[1][-1]
    assert not np.array_equal(often[-1], other)
    # Drawn once at the end: as if every step had been.
    controller = make_baseline("lqr", env.scenario)
    observation, _ = env.reset(seed=3)
    for _ in range(120):
        observation, *_ = env.step(controller.predict(observation)[0])
    assert np.array_equal(env.render(), often[-1])


def test_a_reset_wipes_what_was():
    env, frames = run(100)
    env.reset(seed=3)
    assert np.array_equal(env.render(), frames[0])


def test_between_frames_the_last_one_stands():
    _, frames = run(200)
    new = [t for t in range(1, 201) if frames[t] is not frames[t - 1]]
    # One second: 30 frames, each at the first step at or after its time.
    assert new == [int(np.ceil(200 * k / 30 - 1e-6)) for k in range(1, 31)]
    assert not frames[0].flags.writeable


def test_drawing_leaves_the_episode_alone():
    env, plain = ShakeTableEnv(render_mode="rgb_array"), ShakeTableEnv()
    env.reset(seed=5)
    plain.reset(seed=5)
    for t in range(80):
        action = np.array([0.1 * np.sin(t)], np.float32)
        a, b = env.step(action), plain.step(action)
        env.render()
        assert np.array_equal(a[0], b[0]) and a[1:4] == b[1:4] and a[4] == b[4]
    assert plain.render() is None


def test_two_environments_do_not_share_a_picture():
    first, second = (ShakeTableEnv(render_mode="rgb_array") for _ in range(2))
    first.reset(seed=0)
    second.reset(seed=0)
    for t in range(50):
        first.step(np.array([0.1 * np.sin(t)]))
    rest = second.render()
    assert np.array_equal(rest, run(0)[1][0]) and not np.array_equal(rest, first.render())


@pytest.mark.parametrize("through", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))])
def test_a_copied_env_draws_on(through):
    env, _ = run(50)
    twin = through(env)
    for _ in range(10):
        env.step(np.array([0.05]))
        twin.step(np.array([0.05]))
    assert np.array_equal(env.render(), twin.render())


def test_yielded_storeys_are_marked_once_their_drift_has_passed():
    scenario = make_scenario("yielding", {})
    recorder, results = recorded(1400, scenario)
    n = scenario.specimen.stories
    drifts = np.array([np.diff(state[4 : 4 + n], prepend=0.0) for state, _ in results])
    passed = np.abs(drifts).max(axis=0) > scenario.nonlinearity.yielding.yield_drift
    scene = recorder.scene()
    assert np.array_equal(scene.yielded[0], passed)
    assert scene.yielded[1].any()  # the earthquake is strong enough for the reference


def test_the_last_frame_names_the_broken_limit():
    env = ShakeTableEnv("yielding", render_mode="rgb_array")
    env.reset(seed=0)
    terminated = truncated = False
    while not (terminated or truncated):
        before = env.render()
        _, _, terminated, truncated, info = env.step(np.array([1.0]))
    assert info["broken_limit"] == env._view._recorder.scene().broken
    assert not np.array_equal(env.render()[:28], before[:28])


def test_a_diverging_table_can_be_drawn():
    env = ShakeTableEnv(render_mode="rgb_array", mass_ratio=20.0)
    env.reset(seed=0)
    for t in range(500):
        _, _, terminated, _, _ = env.step(np.array([(-1.0) ** t]))
        if terminated:
            break
    assert env.render().shape == (HEIGHT, WIDTH, 3)
    recorder = env._view._recorder
    recorder._base[:] = 1e6
    recorder._scales[0] = nice_ceiling(1e6)
    assert env._view._painter.paint(recorder.scene()).shape == (HEIGHT, WIDTH, 3)


def test_scales_are_round_and_hold_what_is_shown():
    for value in np.geomspace(1e-6, 1e6, 97):
        above, below = nice_ceiling(value), nice_floor(value)
        assert 0.999999 * value <= above <= 1.6 * value
        assert value / 2.51 <= below <= 1.000001 * value
    env, _ = run(600)
    scene = env._view._recorder.scene()
    shown = (scene.base, scene.sway, scene.acceleration, scene.shear)
    for values, scale in zip(shown, scene.scales, strict=True):
        assert np.abs(values).max() <= scale


def test_colours_differ_in_grey_print():
    # Luminance of sRGB by Rec. 601, as Pillow converts; a quarter of the range is plain to see.
    levels = [
        Image.new("RGB", (1, 1), colour).convert("L").getpixel((0, 0)) for colour in (BLUE, ORANGE)
    ]
    assert abs(levels[0] - levels[1]) > 255 * 0.25
    assert levels[1] < 255 * 0.7
