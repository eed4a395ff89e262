"""The command ``shake components``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console


@dataclass(frozen=True, kw_only=True)
class Components:
    """Draw the yielding storey's loop, the friction loop and the valve's flow-pressure curve.

    Try:
      shake components
      shake components --output out/mine
      shake components --json > components.json
    """

    output: Path | None = None
    """Folder for figures (PNG, SVG) and key numbers (default: out/components; with --json: none)."""
    json: bool = False
    """Print one JSON object on standard output and nothing else there."""

    def run(self, console: Console) -> dict[str, Any]:
        """Put the parts on their bench, print, draw."""
        from agents.components import Bench
        from agents.components_output import components, print_numbers

        folder = self.output or (None if self.json else Path("out/components"))
        found = components(Bench(), folder)
        print_numbers(found, console)
        if folder is not None:
            console.print(f"wrote {folder}")
        return found
