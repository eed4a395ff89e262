"""Lines and text on a Pillow image, and the colours of every picture.

Lines and bodies are drawn at twice the size and averaged; text at its own size, which keeps it crisp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from PIL import ImageDraw, ImageFont

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


def write(
    draw: ImageDraw.ImageDraw,
    x: float,
    y: float,
    text: str,
    *,
    size: int = 13,
    anchor: str = "lm",
    colour: str | int = BLACK,
) -> None:
    """Write text; a trailing ``^2`` becomes an exponent, which the font at hand has no glyph for."""
    font = _font(size)
    word = text.removesuffix("^2")
    raised = _font(round(0.7 * size)) if word != text else None
    if raised is not None and anchor[0] == "r":
        x -= raised.getlength("2")
    draw.text((x, y), word, font=font, fill=colour, anchor=anchor)
    if raised is not None:
        end = x if anchor[0] == "r" else x + font.getlength(word)
        draw.text((end, y - 0.33 * size), "2", font=raised, fill=colour, anchor="lm")
