"""Frames to a file: H.264 in mp4 through ffmpeg, or an animated gif through Pillow."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from os import PathLike
from pathlib import Path

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from shake_env.errors import install_hint
from shake_env.files import replacing

Frames = Iterator[NDArray[np.uint8]]

# Frames a second by suffix. A gif's frames last whole hundredths of a second: 30 a second it cannot say.
FILMS = {".mp4": 30.0, ".gif": 25.0}
INSTALL = install_hint("agents")


def write_video(path: str | PathLike[str], frames: Frames) -> int:
    """Write frames (height, width, 3), at least one, at the rate of `FILMS`; return their number.

    Frames are written as they come, so that memory does not grow with the film.

    Raises
    ------
    DependencyNotInstalled
        If imageio-ffmpeg (mp4) or Pillow (gif) is missing.
    FileError
        If the file cannot be written.
    """
    path = Path(path)
    with replacing(path) as partial:
        return _gif(partial, frames) if path.suffix.lower() == ".gif" else _mp4(partial, frames)


def _mp4(path: Path, frames: Frames) -> int:
    try:
        from imageio_ffmpeg import write_frames
    except ImportError as missing:
        raise DependencyNotInstalled(f"{missing.name} is not installed: {INSTALL}") from missing
    first = next(frames)
    writer = write_frames(
        str(path),
        (first.shape[1], first.shape[0]),
        fps=FILMS[".mp4"],
        quality=7.0,
        macro_block_size=2,
        output_params=["-f", "mp4"],
    )
    writer.send(None)
    number = 0
    try:
        for frame in chain([first], frames):
            writer.send(np.ascontiguousarray(frame))
            number += 1
    finally:
        writer.close()
    return number


def _gif(path: Path, frames: Frames) -> int:
    try:
        from PIL import Image
    except ImportError as missing:
        raise DependencyNotInstalled(f"{missing.name} is not installed: {INSTALL}") from missing
    count = 0

    def images() -> Iterator[Image.Image]:
        nonlocal count
        for frame in frames:
            count += 1
            # Few colours and their blends: no dither, which would flicker and not compress.
            yield Image.fromarray(frame).quantize(64, dither=Image.Dither.NONE)

    pictures = images()
    next(pictures).save(
        path,
        format="GIF",
        save_all=True,
        append_images=pictures,
        duration=round(1e3 / FILMS[".gif"]),
        loop=0,
    )
    return count
