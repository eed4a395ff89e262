"""The files of every room with what each is about, for the architecture page."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from generators import ROOT
from generators.api import PACKAGES


def files_of_rooms() -> str:
    """Return a list of each folder of the packages: its files, with the subject of each."""
    blocks = []
    for package in PACKAGES:
        for folder in [ROOT / package, *sorted(p for p in (ROOT / package).rglob("*") if p.is_dir())]:
            files = sorted(path for path in folder.glob("*.py") if path.stem != "__init__")
            if files:
                lines = [f"- `{file.name}`: {_subject(file)}\n" for file in files]
                blocks.append(f"**`{folder.relative_to(ROOT).as_posix()}`**\n\n{''.join(lines)}")
    return "\n".join(blocks)


def _subject(file: Path) -> str:
    """Return the first paragraph of a module's docstring in one line, as Markdown."""
    docstring = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    text = " ".join(docstring.split("\n\n")[0].split())
    return re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text).replace("``", "`")
