"""Windows and films: they play in real time, and what cannot be shown is refused."""

import importlib
import json
import os
import subprocess
import sys
import time

import gymnasium
import numpy as np
import pygame
import pytest
from drawn_env import run
from gymnasium.error import DependencyNotInstalled
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordVideo
from imageio_ffmpeg import count_frames_and_secs
from PIL import Image
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from agents.__main__ import main
from agents.reporting.video import FILMS, write_video
from shake_env import ShakeTableEnv, ShakeTableVectorEnv
from shake_env.errors import ScenarioError


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


def test_a_window_that_nobody_sees_is_warned_of():
    # In a process of its own: without a display SDL loads Mesa's LLVM, and importing triton beside it,
    # as the CUDA builds of torch do, ends in a segmentation fault.
    code = (
        "import numpy as np, warnings\n"
        "from shake_env import ShakeTableEnv\n"
        "env = ShakeTableEnv(render_mode='human', duration=0.5)\n"
        "with warnings.catch_warnings(record=True) as warned:\n"
        "    warnings.simplefilter('always')\n"
        "    env.reset(seed=0)\n"
        "env.step(np.zeros(1))\n"
        "env.close()\n"
        "print([w.category.__name__ for w in warned if 'rgb_array' in str(w.message)])\n"
    )
    hidden = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
    env = {name: value for name, value in os.environ.items() if name not in hidden}
    shown = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=env
    )
    assert shown.stdout.splitlines()[-1] == "['UserWarning']"


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

    assert write_video(tmp_path / "deep" / "a.mp4", frames()) == 20
    assert alive == list(range(20))
