"""Which code made a file."""

from __future__ import annotations

import os
import platform
import subprocess
from functools import lru_cache
from pathlib import Path

PACKAGES = ("shake_env", "baselines", "agents")


@lru_cache(maxsize=1)
def code_version() -> str | None:
    """Return ``git describe`` of the code that runs, or None where it is no git checkout.

    "-dirty" follows where the packages differ from that commit; results that were written since do not
    count.
    """
    try:
        commit = _git("describe", "--always", "--tags")
        changed = _git("status", "--porcelain", "--", *PACKAGES)
    except (OSError, subprocess.SubprocessError):
        return None
    return f"{commit}-dirty" if commit and changed else commit or None


def _git(*arguments: str) -> str:
    process = subprocess.run(
        ["git", *arguments],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        check=True,
        timeout=10,
    )
    return process.stdout.strip()


def machine() -> str:
    """Return the kind of this machine's processor and the number of its cores, for a result's file."""
    return f"{platform.machine()}, {os.cpu_count()} cores"
