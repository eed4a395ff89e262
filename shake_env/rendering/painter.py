"""Draws a scene with Pillow: table, actuator, both specimens, and strips of what is tracked.

What the table does is blue, dark in grey print too; what it should do is orange, light and wide, and
lies under the blue, so that agreement shows as blue on orange.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from shake_env.model.parameters import FloatArray
from shake_env.rendering.scene import DRIFT_CORNER, SPAN, Scene, nice_floor
from shake_env.scenario.scenario import Scenario

WIDTH, HEIGHT = 640, 480  # [px]
CENTRES = (236.0, 502.0)  # [px] of table and ground at rest
BASE_TOP, FLOOR = 226.0, 250.0  # [px] top of table and ground, and the laboratory's floor
HALF = 44.0  # [px] half a storey's width
PLATE = 62.0  # [px] half the table's
BASE_REACH, SWAY_REACH = 44.0, 44.0  # [px] of a scale's half range
BUILDING = 160.0  # [px] largest height of a specimen
CYLINDER = (22.0, 120.0)  # [px]
RULERS, RULER_Y = (208.0, 424.0), 273.0  # [px] where they begin, and their height
STRIPS = ((318.0, 374.0), (404.0, 460.0))  # [px] top and bottom of each
STRIP_X = (56.0, 628.0)  # [px]


class Painter:
    """Draws the scenes of one scenario; what never moves is drawn once.

    Parameters
    ----------
    scenario
        What runs.
    true_positions
        Whether scenes hold table and ground where they are, drift included.
    """

    def __init__(self, scenario: Scenario, true_positions: bool) -> None:
        stories = scenario.specimen.stories
        self.title = f"{scenario.name}, {stories} {'storey' if stories == 1 else 'storeys'}"
        self.true_positions = true_positions
        self.yields = scenario.nonlinearity.yielding.active
        self.limit = scenario.limits.table_displacement if true_positions else None
        self.heights = BASE_TOP - np.arange(1, stories + 1) * min(78.0, BUILDING / stories)
        self._still = Image.new("RGB", (FINE * WIDTH, FINE * HEIGHT), WHITE)
        self._draw_still(Pen(ImageDraw.Draw(self._still)))
        self._words = Image.new("L", (WIDTH, HEIGHT), 0)  # how much of each pixel is ink
        self._write_still(ImageDraw.Draw(self._words))

    def paint(self, scene: Scene) -> NDArray[np.uint8]:
        """Return the picture (480, 640, 3) of a scene."""
        fine = self._still.copy()
        pen = Pen(ImageDraw.Draw(fine))
        base = scene.base * BASE_REACH / scene.scales[0]
        sway = scene.sway * SWAY_REACH / scene.scales[1]
        self._draw_table(pen, CENTRES[0] + base[0], scene.scales[0])
        self._draw_ground(pen, CENTRES[1] + base[1])
        for i, colour in enumerate((BLUE, ORANGE)):
            self._draw_specimen(pen, CENTRES[i] + base[i], sway[i], scene.yielded[i], colour)
        self._draw_rulers(pen, scene.scales)
        for (top, bottom), history, scale in zip(
            STRIPS, (scene.acceleration, scene.shear), scene.scales[2:], strict=True
        ):
            self._draw_history(pen, scene.ages, history / scale, top, bottom)
        picture = fine.reduce(FINE)
        picture.paste(BLACK, (0, 0), self._words)
        self._write(ImageDraw.Draw(picture), scene)
        frame: NDArray[np.uint8] = np.array(picture)
        return frame

    def _draw_still(self, pen: Pen) -> None:
        left, right = 8.0, 350.0
        pen.line([(left, FLOOR), (right, FLOOR)], BLACK)
        pen.hatch(left, right, FLOOR)
        pen.box(left, BASE_TOP - 30.0, CYLINDER[0], FLOOR, LIGHT)  # reaction wall
        pen.line([(0.0, 29.0), (WIDTH, 29.0)], LIGHT)
        for top, bottom in STRIPS:
            for second in range(round(SPAN) + 1):
                x = STRIP_X[1] - second * (STRIP_X[1] - STRIP_X[0]) / SPAN
                pen.line([(x, top), (x, bottom)], LIGHT)
            for y, colour in ((top, LIGHT), ((top + bottom) / 2.0, GREY), (bottom, LIGHT)):
                pen.line([(STRIP_X[0], y), (STRIP_X[1], y)], colour, 0.5 if colour == GREY else 1.0)
        y = STRIPS[0][0] - 12.0
        for x, colour, width in ((240.0, BLUE, 1.5), (322.0, ORANGE, 4.0)):
            pen.line([(x, y), (x + 24.0, y)], colour, width)

    def _draw_table(self, pen: Pen, x: float, scale: float) -> None:
        y, (begin, end) = BASE_TOP + 7.0, CYLINDER
        piston = (begin + end) / 2.0 + x - CENTRES[0]
        pen.box(begin, y - 9.0, end, y + 9.0, WHITE)
        pen.line([(piston, y), (x - PLATE, y)], DARK, 4.0)
        pen.box(piston - 3.0, y - 8.0, piston + 3.0, y + 8.0, DARK)
        for roller in (-44.0, 0.0, 44.0):
            # Rollers move half as far as what rolls on them.
            place = CENTRES[0] + roller + (x - CENTRES[0]) / 2.0
            pen.dot(place, (BASE_TOP + 14.0 + FLOOR) / 2.0, 4.5, WHITE, BLACK)
        pen.box(x - PLATE, BASE_TOP, x + PLATE, BASE_TOP + 14.0, LIGHT)
        if self.limit is not None:
            reach = self.limit * BASE_REACH / scale
            for side in (-1.0, 1.0):
                mark = CENTRES[0] + side * (reach + PLATE)
                pen.line([(mark, FLOOR - 9.0), (mark, FLOOR)], VERMILLION, 2.0)

    def _draw_ground(self, pen: Pen, x: float) -> None:
        pen.box(x - 2.0 * HALF, BASE_TOP, x + 2.0 * HALF, FLOOR + 8.0, LIGHT, None)
        pen.line([(x - 2.0 * HALF, BASE_TOP), (x + 2.0 * HALF, BASE_TOP)], BLACK)
        pen.hatch(x - 2.0 * HALF, x + 2.0 * HALF, BASE_TOP, FLOOR + 8.0 - BASE_TOP)

    def _draw_specimen(
        self, pen: Pen, x: float, sway: FloatArray, yielded: NDArray[np.bool_], colour: str
    ) -> None:
        thick = min(8.0, 0.4 * (BASE_TOP - float(self.heights[0])))
        # A storey's columns are clamped in both floors: the cubic with no slope at its ends.
        rise = np.linspace(0.0, 1.0, 9)
        bend = rise**2 * (3.0 - 2.0 * rise)
        below, foot = x, BASE_TOP
        for offset, y, over in zip(sway, self.heights, yielded, strict=True):
            above, head = x + float(offset), float(y) + thick
            for side in (-HALF + 6.0, HALF - 6.0):
                xs = below + side + (above - below) * bend
                ys = foot + (head - foot) * rise
                line = list(zip(xs.tolist(), ys.tolist(), strict=True))
                pen.line(line, VERMILLION if over else BLACK, 3.0 if over else 2.0)
                if over:
                    pen.dot(below + side, foot, 3.0, VERMILLION, BLACK)
            below, foot = above, float(y)
            pen.box(above - HALF, foot, above + HALF, foot + thick, colour)

    def _draw_rulers(self, pen: Pen, scales: Sequence[float]) -> None:
        for x, (_, width) in zip(RULERS, rulers(scales), strict=True):
            end, y = x + width, RULER_Y
            pen.line([(x, y), (end, y)], BLACK, 1.5)
            for tip in (x, end):
                pen.line([(tip, y - 4.0), (tip, y + 4.0)], BLACK, 1.5)

    def _draw_history(
        self, pen: Pen, ages: FloatArray, history: FloatArray, top: float, bottom: float
    ) -> None:
        if len(history) < 2:
            return
        xs = (STRIP_X[1] - (STRIP_X[1] - STRIP_X[0]) * ages / SPAN).tolist()
        ys = (top + bottom) / 2.0 - history * (bottom - top) / 2.0
        for column, colour, width in ((1, ORANGE, 4.0), (0, BLUE, 1.5)):
            pen.line(list(zip(xs, ys[:, column].tolist(), strict=True)), colour, width)

    def _write_still(self, draw: ImageDraw.ImageDraw) -> None:
        def put(x: float, y: float, text: str, size: int = 13, anchor: str = "lm") -> None:
            draw_text(draw, x, y, text, size=size, anchor=anchor, colour=255)

        put(10.0, 15.0, self.title, 15)
        put(CENTRES[0], 42.0, "on the table", anchor="mm")
        put(CENTRES[1], 42.0, "reference: on real ground", anchor="mm")
        if self.yields:
            put(10.0, 42.0, "red, dotted: storey", 12)
            put(10.0, 57.0, "has yielded", 12)
        if not self.true_positions:
            put(10.0, RULER_Y, f"drift below {DRIFT_CORNER:g} Hz not drawn", 12)
        for (top, bottom), name in zip(STRIPS, ("acceleration, m/s^2", "base shear, kN"), strict=True):
            put(STRIP_X[0], top - 12.0, name)
            put(STRIP_X[0] - 6.0, (top + bottom) / 2.0, "0", 12, "rm")
        for x, word in ((270.0, "table"), (352.0, "target")):
            put(x, STRIPS[0][0] - 12.0, word)
        for second in range(round(SPAN) + 1):
            x = STRIP_X[1] - second * (STRIP_X[1] - STRIP_X[0]) / SPAN
            word, anchor = ("now", "rm") if second == 0 else (f"-{second} s", "mm")
            put(x, STRIPS[1][1] + 13.0, word, 12, anchor)

    def _write(self, draw: ImageDraw.ImageDraw, scene: Scene) -> None:
        draw_text(draw, WIDTH - 10.0, 15.0, f"{scene.time:.2f} s", size=15, anchor="rm")
        if scene.broken is not None:
            reason = "stopped: " + scene.broken.replace("_", " ")
            draw_text(draw, WIDTH / 2.0, 15.0, reason, size=15, anchor="mm", colour=VERMILLION)
        x = CYLINDER[0] + 4.0
        draw_text(draw, x, BASE_TOP - 34.0, f"valve {1e3 * scene.current:+.0f} mA", size=12)
        draw_text(draw, x, BASE_TOP - 18.0, f"stroke {1e3 * scene.stroke:+.0f} mm", size=12)
        for x, (word, width) in zip(RULERS, rulers(scene.scales), strict=True):
            draw_text(draw, x + width + 8.0, RULER_Y, word, size=12)
        for i, (top, bottom) in enumerate(STRIPS):
            scale, error = scene.scales[2 + i] / (1.0, 1e3)[i], scene.errors[i]
            known = "-" if math.isnan(error) else f"{100.0 * min(error, 99.99):.0f} %"
            draw_text(draw, STRIP_X[1], top - 12.0, f"rms error {known}", anchor="rm")
            for value, y in ((scale, top), (-scale, bottom)):
                draw_text(draw, STRIP_X[0] - 6.0, y, f"{value:g}", size=12, anchor="rm")


def rulers(scales: Sequence[float]) -> list[tuple[str, float]]:
    """Return what the rulers of base and sway say, and their widths [px]."""
    marks = []
    kinds = (("base motion", BASE_REACH), ("storey sway", SWAY_REACH))
    for (what, reach), scale in zip(kinds, scales, strict=False):
        value = nice_floor(scale)
        marks.append((f"{length_in_words(value)} of {what}", reach * value / scale))
    return marks


def length_in_words(value: float) -> str:
    """Return a length [m] in the words of a picture's ruler."""
    return f"{1e3 * value:g} mm" if value < 1.0 else f"{value:g} m"


FINE = 2  # the factor of the fine drawing


# Okabe and Ito's.
BLUE, ORANGE, VERMILLION = "#0072B2", "#E69F00", "#D55E00"


BLACK, DARK, GREY, LIGHT, WHITE = "#000000", "#444444", "#7F7F7F", "#DDDDDD", "#FFFFFF"


Points = Sequence[tuple[float, float]]


@lru_cache(maxsize=8)
def _font(size: int) -> Any:
    return ImageFont.load_default(size)


@dataclass(frozen=True)
class Pen:
    """Draws in pixels of the finished picture on a canvas `FINE` times as large."""

    draw: ImageDraw.ImageDraw

    def line(self, points: Points, colour: str, width: float = 1.0) -> None:
        """Draw a line through points."""
        fine = [(FINE * x, FINE * y) for x, y in points]
        self.draw.line(fine, fill=colour, width=round(FINE * width))

    def box(
        self, x0: float, y0: float, x1: float, y1: float, fill: str | None, edge: str | None = BLACK
    ) -> None:
        """Draw a rectangle."""
        corners = (FINE * x0, FINE * y0, FINE * x1, FINE * y1)
        self.draw.rectangle(corners, fill=fill, outline=edge, width=FINE)

    def dot(self, x: float, y: float, radius: float, fill: str, edge: str | None = None) -> None:
        """Draw a disc."""
        corners = (FINE * (x - radius), FINE * (y - radius), FINE * (x + radius), FINE * (y + radius))
        self.draw.ellipse(corners, fill=fill, outline=edge, width=FINE)

    def hatch(self, x0: float, x1: float, y: float, depth: float = 8.0) -> None:
        """Draw the strokes under a surface that stands still."""
        for x in np.arange(x0 + depth, x1 + 0.1, 8.0):
            self.line([(x, y), (x - depth, y + depth)], GREY, 0.5)


def draw_text(
    draw: ImageDraw.ImageDraw,
    x: float,
    y: float,
    text: str,
    *,
    size: int = 13,
    anchor: str = "lm",
    colour: str | int = BLACK,
) -> None:
    """Write text on a picture; a trailing ``^2`` becomes an exponent, which the font lacks."""
    font = _font(size)
    word = text.removesuffix("^2")
    raised = _font(round(0.7 * size)) if word != text else None
    if raised is not None and anchor[0] == "r":
        x -= raised.getlength("2")
    draw.text((x, y), word, font=font, fill=colour, anchor=anchor)
    if raised is not None:
        end = x if anchor[0] == "r" else x + font.getlength(word)
        draw.text((end, y - 0.33 * size), "2", font=raised, fill=colour, anchor="lm")
