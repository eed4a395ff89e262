"""Which code made a file."""

from __future__ import annotations

import subprocess
from functools import lru_cache
from pathlib import Path


@lru_cache(maxsize=1)
def code_version() -> str | None:
    """Return ``git describe`` of the code that runs, or None where it is no git checkout."""
    command = ["git", "describe", "--always", "--dirty", "--tags"]
    try:
        told = subprocess.run(
            command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True, timeout=10
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return told.stdout.strip() or None
