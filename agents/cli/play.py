"""The command ``shake play``: a controller at work, in a window or as a film."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape

from agents.cli.command_options import CommandOptions
from agents.cli.output_path import require_writable_file
from agents.progress import progress_bar
from agents.reporting.video import FILMS, write_video
from agents.scenario_options import ScenarioOptions
from shake_env import ShakeTableEnv
from shake_env.controller import Controller, decide
from shake_env.errors import ParameterError, ScenarioError, unknown
from shake_env.motion.targets import Motion, whole_periods
from shake_env.rendering.window import FRAME_RATE, NO_DISPLAY, Window
from shake_env.rollout import recorded_earthquakes
from shake_env.scenario.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class Play(CommandOptions):
    """Show a simulated test in a window, or save it as a video.

    Try:
      shake play
      shake play --scenario yielding --controller lqr --slow-motion 4
      shake play --controller ppo --record ridgecrest2019_clc_360 --save out/ppo.mp4
      shake play --stories 10 --seconds 6 --save ten.gif
    """

    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(default_factory=ScenarioOptions)
    controller: str | None = None
    """Name of a classical controller or of a policy that ships (ppo, apg, dagger, sac), or the path of a
    policy file or run directory (default: LQR, with an estimator where the scenario shows measured
    signals)."""
    record: str | None = None
    """Embedded record to repeat in place of the scenario's motion, scaled to the table's limits."""
    seed: int = 0
    """Seed of the episode."""
    seconds: float | None = None
    """Length to show [s] (default: the whole motion)."""
    slow_motion: float = 1.0
    """Seconds that one second of the test takes on the screen."""
    save: Path | None = None
    """File to write in place of a window: .mp4 or .gif."""

    def run(self, console: Console) -> dict[str, Any]:
        """Run the episode and show it."""
        for name, value in (("seconds", self.seconds), ("slow_motion", self.slow_motion)):
            if value is not None and not 0.0 < value < float("inf"):
                raise ParameterError(name, value, "must be above 0")
        if self.save is not None and self.save.suffix.lower() not in FILMS:
            raise ParameterError("save", str(self.save), f"must end in {' or '.join(FILMS)}")
        if self.save is not None:
            require_writable_file(self.save, "save")
        # pygame greets on standard output, where --json promises one object.
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        try:
            return self._run(console)
        except DependencyNotInstalled as missing:
            raise ScenarioError("watch", "drawing", str(missing)) from None

    def _run(self, console: Console) -> dict[str, Any]:
        from agents.policies.registry import get_controller
        from baselines.registry import reference_name

        scenario = self.scenario.build()
        if self.seconds is not None:
            whole_periods(self.seconds, scenario.control_period, "seconds")
        rate = FRAME_RATE if self.save is None else FILMS[self.save.suffix.lower()]
        episode = Episode(
            scenario,
            get_controller(self.controller or reference_name(scenario), scenario),
            seed=self.seed,
            motion=None if self.record is None else recorded(self.record, scenario),
            frame_rate=rate * self.slow_motion,
            seconds=self.seconds,
        )
        if self.save is None:
            frames = self._show(episode)
        else:
            with progress_bar() as progress:
                task = progress.add_task("film", total=1.0)
                frames = write_video(
                    self.save, episode.frames(lambda share: progress.update(task, completed=share))
                )
            console.print(f"wrote {escape(str(self.save))}")
        ended = "" if episode.broken is None else f", stopped by a limit: {episode.broken}"
        console.print(f"{episode.time:.2f} s, {frames} frames, mean cost {episode.mean_cost:.4g}{ended}")
        return {
            "seconds": episode.time,
            "frames": frames,
            "mean_cost": episode.mean_cost,
            "broken_limit": episode.broken,
            "saved": None if self.save is None else str(self.save),
        }

    def _show(self, episode: Episode) -> int:
        window = Window(f"shake play: {episode.scenario.name}", 1.0 / self.slow_motion)
        window.start()
        frames, last = 0, None
        for frame in episode.frames():
            if frame is not last:
                window.show(frame, episode.time)
                if not window.on_display:
                    window.close()
                    raise ScenarioError("display", None, f"{NO_DISPLAY}: give --save FILE.mp4 or .gif")
                frames, last = frames + 1, frame
            if window.closed:
                break
        window.close()
        return frames


class Episode:
    """One episode of a controller, as frames."""

    def __init__(
        self,
        scenario: Scenario,
        controller: Controller,
        *,
        seed: int,
        motion: Motion | None,
        frame_rate: float,
        seconds: float | None,
    ) -> None:
        self.scenario, self.controller, self.seed = scenario, controller, seed
        self.motion, self.frame_rate, self.seconds = motion, frame_rate, seconds
        self.time = self.cost = 0.0
        self.broken: str | None = None
        self.steps = 0

    @property
    def mean_cost(self) -> float:
        """Mean stage cost [-], that of a broken limit included."""
        return self.cost / max(self.steps, 1)

    def frames(
        self, on_progress: Callable[[float], None] = lambda share: None
    ) -> Iterator[NDArray[np.uint8]]:
        """Yield `frame_rate` frames for each second of the test, one again where nothing is new."""
        env = ShakeTableEnv(self.scenario, render_mode="rgb_array", frame_rate=self.frame_rate)
        options = None if self.motion is None else {"motion": self.motion}
        observation, _ = env.reset(seed=self.seed, options=options)
        length = env.episode_duration
        end = length if self.seconds is None else min(self.seconds, length)
        memory, shown, over = None, 0, False
        yield env.render()  # type: ignore[misc]  # an array in this mode
        while not over:
            action, memory = decide(self.controller, observation, memory, np.array([self.steps == 0]))
            observation, reward, terminated, truncated, info = env.step(action)
            self.steps += 1
            self.time = self.steps * self.scenario.control_period
            self.cost -= reward
            self.broken = info.get("broken_limit")
            over = terminated or truncated or self.time >= end - 1e-9
            due = int(self.time * self.frame_rate + 1e-6)
            on_progress(1.0 if over else self.time / end)
            for _ in range(max(due - shown, int(over))):
                yield env.render()  # type: ignore[misc]
            shown = max(due, shown)


def recorded(name: str, scenario: Scenario) -> Motion:
    """Return an embedded record, prepared for the scenario's table.

    Raises
    ------
    ScenarioError
        If there is none of that name.
    """
    motions = {quake.name: quake.motion for quake in recorded_earthquakes(scenario)}
    if name not in motions:
        raise unknown(ScenarioError, "record", name, motions)
    return motions[name]
