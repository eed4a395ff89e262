"""What is drawn: where things stand, that it follows the test and nothing else, and that films play."""

import copy
import importlib
import json
import os
import pickle
import subprocess
import sys
import time

import gymnasium
import numpy as np
import pygame
import pytest
from gymnasium.error import DependencyNotInstalled
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordVideo
from imageio_ffmpeg import count_frames_and_secs
from PIL import Image
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from agents.__main__ import main
from agents.reporting.video import FILMS, film
from baselines.registry import make_baseline
from shake_env import NoControl, ShakeTableEnv, ShakeTableVectorEnv, make_scenario
from shake_env.errors import ScenarioError
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


def run(steps, seed=3, controller=None, frame_rate=30.0, **overrides):
    env = ShakeTableEnv(render_mode="rgb_array", frame_rate=frame_rate, **overrides)
    controller = controller or make_baseline("lqr", env.scenario)
    observation, _ = env.reset(seed=seed)
    frames, memory = [env.render()], None
    for t in range(steps):
        action, memory = controller.predict(observation, memory, np.array([t == 0]))
        observation, _, terminated, truncated, _ = env.step(action)
        frames.append(env.render())
        if terminated or truncated:
            break
    return env, frames


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


@pytest.mark.parametrize("rate", [50.0, 200.0, 1000.0])
def test_record_video_plays_in_real_time(tmp_path, rate):
    env = gymnasium.make(
        "shake_env:ShakeTable-v0", render_mode="rgb_array", duration=0.5, control_rate=rate
    )
    env = RecordVideo(env, str(tmp_path / "video"), episode_trigger=lambda episode: True)
    env.reset(seed=0)
    steps, truncated = 0, False
    while not truncated:
        _, _, _, truncated, _ = env.step(np.zeros(1, np.float32))
        steps += 1
    env.close()
    (file,) = (tmp_path / "video").glob("*.mp4")
    frames, seconds = count_frames_and_secs(str(file))
    # A frame for each step, and the one at rest.
    assert abs(frames - (steps + 1)) <= 1
    assert seconds == pytest.approx(0.5, abs=2.0 / min(rate, 100.0))


def test_gymnasium_checker_has_no_complaint_of_rendering():
    env = gymnasium.make("shake_env:ShakeTable-v0", render_mode="rgb_array", duration=0.5)
    check_env(env.unwrapped)
    sb3_check_env(ShakeTableEnv(render_mode="rgb_array", duration=0.5))


def test_a_window_plays_in_real_time():
    env = ShakeTableEnv(render_mode="human", duration=1.0)
    assert env.metadata["render_fps"] == 200
    env.reset(seed=0)
    began = time.monotonic()
    for _ in range(100):
        env.step(np.zeros(1))
    # 0.5 s of the test, the last frame of it at 15/30 s; never faster.
    assert time.monotonic() - began > 0.45
    assert env.render() is None and not env._view.closed
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    for _ in range(10):
        env.step(np.zeros(1))
    assert env._view.closed
    for _ in range(10):
        env.step(np.zeros(1))  # goes on unseen
    env.close()


def test_what_cannot_be_shown_is_refused():
    with pytest.raises(ScenarioError, match="human, rgb_array"):
        ShakeTableEnv(render_mode="ansi")
    for rate in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ScenarioError, match="frame_rate"):
            ShakeTableEnv(render_mode="rgb_array", frame_rate=rate)
    with pytest.raises(ScenarioError, match="ShakeTableEnv"):
        ShakeTableVectorEnv(2, render_mode="rgb_array")
    with pytest.raises(ScenarioError, match="reset"):
        ShakeTableEnv(render_mode="rgb_array").render()


@pytest.mark.parametrize(("mode", "missing"), [("rgb_array", "PIL"), ("human", "pygame")])
def test_a_missing_package_is_named_with_its_remedy(monkeypatch, mode, missing):
    for name in [n for n in sys.modules if n.split(".")[0] == missing]:
        monkeypatch.delitem(sys.modules, name)
    for name in ("shake_env.rendering.painter", "shake_env.rendering.painter"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(DependencyNotInstalled, match=rf"{missing}.*'.\[render\]'"):
        ShakeTableEnv(render_mode=mode)
    importlib.import_module("shake_env.rendering.window")


def test_an_env_that_shows_nothing_imports_nothing_to_draw_with():
    code = (
        "import sys; from shake_env import ShakeTableEnv; ShakeTableEnv().reset(seed=0);"
        "print(sorted({'PIL', 'pygame', 'moviepy'} & set(sys.modules)))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


@pytest.mark.parametrize("suffix", sorted(FILMS))
def test_watch_saves_a_film_in_real_time(tmp_path, capsys, suffix):
    file = tmp_path / f"film{suffix}"
    arguments = ["play", "--seconds", "1", "--seed", "3", "--save", str(file), "--json"]
    assert main(arguments) == 0
    out = json.loads(capsys.readouterr().out)
    assert out["frames"] == FILMS[suffix] + 1 and out["seconds"] == pytest.approx(1.0)
    if suffix == ".gif":
        with Image.open(file) as image:
            assert (image.n_frames, image.info["duration"]) == (26, 40)
            image.seek(25)
            last = np.asarray(image.convert("RGB"))
    else:
        frames, seconds = count_frames_and_secs(str(file))
        assert frames == 31 and seconds == pytest.approx(31 / 30, abs=0.02)
        return
    _, frames = run(200, frame_rate=25.0)
    # 64 colours stand for all blends of a few.
    assert np.abs(last.astype(int) - frames[-1]).mean() < 2.0


def test_slow_motion_has_more_frames_and_not_more_time(tmp_path, capsys):
    file = tmp_path / "slow.gif"
    arguments = ["play", "--seconds", "0.1", "--slow-motion", "20", "--save", str(file), "--json"]
    assert main(arguments) == 0
    out = json.loads(capsys.readouterr().out)
    assert (out["frames"], out["seconds"]) == (51, pytest.approx(0.1))


def test_a_window_that_nobody_sees_is_warned_of(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    env = ShakeTableEnv(render_mode="human", duration=0.5)
    with pytest.warns(UserWarning, match="rgb_array"):
        env.reset(seed=0)
    env.step(np.zeros(1))
    env.close()


def test_watch_says_where_no_window_can_be_seen():
    kept = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    kept.pop("SDL_VIDEODRIVER", None)
    found = subprocess.run(
        [sys.executable, "-m", "agents", "play", "--seconds", "0.1"],
        capture_output=True, text=True, env=kept,
    )  # fmt: skip
    assert found.returncode == 2 and found.stdout == ""
    assert "--save" in found.stderr and "Traceback" not in found.stderr


@pytest.mark.parametrize(
    "arguments",
    [["--save", "a.webm"], ["--seconds", "0"], ["--controller", "lqrr"], ["--record", "kobe"]],
    ids=str,
)
def test_watch_refuses_what_it_does_not_know(arguments, capsys):
    assert main(["play", *arguments]) == 2
    assert arguments[1] in capsys.readouterr().err


def test_films_hold_no_more_than_a_frame(tmp_path):
    alive = []

    def frames():
        for shade in range(20):
            alive.append(shade)
            yield np.full((48, 64, 3), 10 * shade, np.uint8)

    assert film(tmp_path / "deep" / "a.mp4", frames()) == 20
    assert alive == list(range(20))
