"""The files of every room, as a list for the architecture page."""

from __future__ import annotations

from generators import ROOT
from generators.api import PACKAGES


def files_of_rooms() -> str:
    """Return a line a folder of the packages: its name, then those of its files without ``.py``."""
    lines = []
    for package in PACKAGES:
        for folder in [ROOT / package, *sorted(p for p in (ROOT / package).rglob("*") if p.is_dir())]:
            names = sorted(path.stem for path in folder.glob("*.py") if path.stem != "__init__")
            if names:
                lines.append(f"- `{folder.relative_to(ROOT).as_posix()}`: {', '.join(names)}\n")
    return "".join(lines)
