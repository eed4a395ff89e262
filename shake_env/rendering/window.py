"""What `ShakeTableEnv` shows: frames as arrays, or a window that plays in real time.

Pillow draws and pygame shows; both belong to the extra ``render`` and are imported when a picture is
asked for, so that an environment that shows nothing needs neither.
"""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import logger
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from shake_env.errors import ScenarioError, install_hint, unknown
from shake_env.model.parameters import is_number
from shake_env.motion.targets import Motion
from shake_env.rendering.scene import SceneRecorder
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.engine import StepResult

if TYPE_CHECKING:
    from shake_env.rendering.painter import Painter

RENDER_MODES = ["human", "rgb_array"]
FRAME_RATE = 30.0  # [Hz] frames a second of simulated time
UNSEEN = ("dummy", "offscreen")  # SDL's drivers without a display
NO_DISPLAY = "no window can be seen here"
REMEDY = "use render_mode='rgb_array', or shake play --save FILE"
INSTALL = install_hint("render")


class EnvRenderer:
    """The picture of one environment.

    A new frame is drawn `frame_rate` times a second of the test's own time; in between, the last one
    stands. Whoever takes a frame at every step and plays the steps at the control rate (as Gymnasium's
    ``RecordVideo`` does) so sees real time, and pays for `frame_rate` drawings a second only.

    Parameters
    ----------
    scenario
        What runs.
    mode
        ``"rgb_array"`` or ``"human"``.
    frame_rate
        Frames a second of simulated time.

    Raises
    ------
    ScenarioError
        If the mode is unknown or the rate not above zero.
    DependencyNotInstalled
        If Pillow, or for a window pygame, is missing.
    """

    def __init__(self, scenario: Scenario, mode: str, frame_rate: float = FRAME_RATE) -> None:
        if mode not in RENDER_MODES:
            raise unknown(ScenarioError, "render_mode", str(mode), RENDER_MODES)
        if not (is_number(frame_rate) and 0.0 < frame_rate < float("inf")):
            raise ScenarioError("frame_rate", frame_rate, "must be above 0 frames a second")
        self.mode, self.frame_rate = mode, float(frame_rate)
        self._recorder = SceneRecorder(scenario)
        self._painter = _painter(scenario, self._recorder.true_positions)
        self._window = Window(f"shake: {scenario.name}") if mode == "human" else None
        self._frame: NDArray[np.uint8] | None = None
        self._number = -1  # of the frame that stands, counted from the start of the episode
        self._started = False

    @property
    def closed(self) -> bool:
        """Whether the viewer has closed the window."""
        return self._window is not None and self._window.closed

    def start(self, motion: Motion | None) -> None:
        """Begin an episode at rest, under the scenario's motion or another one."""
        self._recorder.start(motion)
        self._frame, self._started = None, True
        if self._window is not None:
            self._window.start()
            self._show(self._window)

    def record(self, result: StepResult) -> None:
        """Take in a control period, and show it where there is a window."""
        self._recorder.add(result)
        if result.terminated[0] or result.truncated[0]:
            self._frame = None  # the last moment is drawn, whatever its time
        if self._window is not None:
            self._show(self._window)

    def frame(self) -> NDArray[np.uint8]:
        """Return the frame (480, 640, 3) that stands; it is handed out again, so not to be written to.

        Raises
        ------
        ScenarioError
            If no episode has been started.
        """
        if not self._started:
            raise ScenarioError("render()", "no episode has been started", "call reset() first")
        number = self._due()
        if self._frame is None or number != self._number:
            self._frame, self._number = self._painter.paint(self._recorder.scene()), number
            self._frame.flags.writeable = False
        return self._frame

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()

    def _due(self) -> int:
        # A period that ends on a frame's time, but for rounding, belongs to that frame.
        return int(self._recorder.time * self.frame_rate + 1e-6)

    def _show(self, window: Window) -> None:
        if not window.closed and (self._frame is None or self._due() != self._number):
            first = not window.is_open
            window.show(self.frame(), self._recorder.time)
            if first and not window.on_display:
                logger.warn(f"{NO_DISPLAY}: {REMEDY}")


class Window:
    """A window that shows frames when their time has come.

    Parameters
    ----------
    title
        Of the window.
    speed
        Simulated seconds a second.

    Raises
    ------
    DependencyNotInstalled
        If pygame is missing.
    """

    def __init__(self, title: str, speed: float = 1.0) -> None:
        self.title, self.speed = title, speed
        self.closed = False
        self.on_display = True  # whether the window is on a display
        self._pygame = _pygame()
        self._surface: Any = None
        self._origin = 0.0  # [s] of the clock at the start of the episode

    def __getstate__(self) -> dict[str, Any]:
        # Neither a module nor a window can be copied; a copy opens its own.
        return self.__dict__ | {"_pygame": None, "_surface": None}

    @property
    def is_open(self) -> bool:
        """Whether there is a window already."""
        return self._surface is not None

    def start(self) -> None:
        """Let the clock of an episode run from now."""
        self._origin = time.monotonic()

    def show(self, frame: NDArray[np.uint8], moment: float) -> None:
        """Show a frame (height, width, 3) `moment` seconds after the start.

        Raises
        ------
        ScenarioError
            If no window can be opened at all.
        """
        if self._surface is None:
            self._open(frame.shape[1], frame.shape[0])
        early = self._origin + moment / self.speed - time.monotonic()
        if early > 0.0:
            time.sleep(early)
        else:
            self._origin -= early  # too slow for real time: go on from here, not in a rush
        size = (frame.shape[1], frame.shape[0])
        self._surface.blit(self._pygame.image.frombuffer(frame.tobytes(), size, "RGB"), (0, 0))
        self._pygame.display.flip()
        if any(event.type == self._pygame.QUIT for event in self._pygame.event.get()):
            self.close()

    def close(self) -> None:
        """Close the window for good."""
        if self._surface is not None:
            self._pygame.display.quit()
            self._surface = None
        self.closed = True

    def _open(self, width: int, height: int) -> None:
        self._pygame = _pygame()
        try:
            self._pygame.display.init()
            self._surface = self._pygame.display.set_mode((width, height))
        except self._pygame.error as error:
            raise ScenarioError("display", str(error), f"{NO_DISPLAY}: {REMEDY}") from None
        # Without a display SDL draws off the screen, which a user may also have asked for.
        self.on_display = (
            self._pygame.display.get_driver() not in UNSEEN or "SDL_VIDEODRIVER" in os.environ
        )
        self._pygame.display.set_caption(self.title)


def make_view(
    scenario: Scenario, mode: str | None, frame_rate: float = FRAME_RATE
) -> EnvRenderer | None:
    """Return the view of an environment; None where nothing is to be shown."""
    return None if mode is None else EnvRenderer(scenario, mode, frame_rate)


def metadata(scenario: Scenario) -> dict[str, Any]:
    """Return Gymnasium's metadata: at ``render_fps`` a frame for every step plays in real time."""
    rate = 1.0 / scenario.control_period
    whole = round(rate)
    return {
        "render_modes": RENDER_MODES,
        "render_fps": whole if abs(rate - whole) < 1e-9 * rate else rate,
    }


def _painter(scenario: Scenario, true_positions: bool) -> Painter:
    try:
        from shake_env.rendering.painter import Painter
    except ImportError as missing:
        raise DependencyNotInstalled(f"{missing.name} is not installed: {INSTALL}") from missing
    return Painter(scenario, true_positions)


def _pygame() -> Any:
    try:
        import pygame
    except ImportError as missing:
        raise DependencyNotInstalled(f"{missing.name} is not installed: {INSTALL}") from missing
    return pygame
