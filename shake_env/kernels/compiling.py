"""Compiled functions that numba keeps on disk, for the sources that they are made of."""

from __future__ import annotations

import logging
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit

logger = logging.getLogger(__name__)


def stamp() -> int:
    """Return a number that changes with the sources of this folder.

    numba looks only at the file of a function to tell whether what it keeps on disk is out of date. A
    closure over this number makes every source part of the question.
    """
    folder = Path(__file__).parent
    sources = [*sorted(folder.glob("*.py")), folder.parent / "model" / "random_numbers.py"]
    return zlib.crc32(b"".join(path.read_bytes() for path in sources))


def cached(signature: Any, function: Callable[..., Any]) -> Any:
    """Return a function compiled for a signature, kept on disk where a folder can be written.

    numba tries the package's own folder, then one in the user's home. Where neither can be written, what
    is compiled stays in memory, and one line says so.
    """
    options: dict[str, Any] = {"error_model": "numpy", "nogil": True}
    try:
        return njit(signature, cache=True, **options)(function)
    except RuntimeError:
        logger.warning(
            "no folder for compiled functions can be written: they are compiled in every process "
            "(NUMBA_CACHE_DIR names another folder)"
        )
        return njit(signature, **options)(function)
