"""The compiled modules, where numba is installed and they are not switched off."""

from __future__ import annotations

import importlib
import logging
import os
import time
import warnings
from functools import lru_cache
from typing import Any

logger = logging.getLogger(__name__)

COMPILED = os.environ.get("SHAKE_ENV_COMPILED", "1") != "0"  # whether numba is used where it is there


def compiled_module(name: str) -> Any:
    """Return a numba module by its dotted name, or None where it is switched off or numba is not there.

    Imported on first use: numba is an extra, and takes half a second. Where it is installed and cannot
    be used, a RuntimeWarning says why.
    """
    return _load(name) if COMPILED else None


@lru_cache
def _load(name: str) -> Any:
    try:
        _log_compilation()
        began = time.perf_counter()
        module = importlib.import_module(name)
        logger.debug("shake_env.%s: loaded in %.1f s", name, time.perf_counter() - began)
        return module
    except ModuleNotFoundError:
        return None
    except (ImportError, RuntimeError) as problem:  # another numpy than it bears, no folder for its work
        warnings.warn(
            f"tables step uncompiled, several times slower: {problem}. Correct that (NUMBA_CACHE_DIR "
            "names a writable folder), or set SHAKE_ENV_COMPILED=0",
            RuntimeWarning,
            stacklevel=3,
        )
        return None


@lru_cache
def _log_compilation() -> None:
    """Have the first compilation of this process logged as it begins; what numba has kept is none."""
    event: Any = importlib.import_module("numba.core.event")

    class FirstCompilation(event.Listener):  # type: ignore[misc]
        def on_start(self, event: Any) -> None:
            if not self.logged:
                self.logged = True
                logger.info(
                    "compiling the simulation for this machine: up to a minute, once; "
                    "later runs load it from disk"
                )

        def on_end(self, event: Any) -> None:
            pass

        logged = False

    event.register("numba:compile", FirstCompilation())
