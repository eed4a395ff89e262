"""The command ``shake components``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rich.console import Console

from agents.cli.command_options import FolderOptions


@dataclass(frozen=True, kw_only=True)
class Components(FolderOptions):
    """Draw the yielding storey's loop, the friction loop and the valve's flow-pressure curve.

    Try:
      shake components
      shake components --output out/mine
      shake components --json > components.json
    """

    def run(self, console: Console) -> dict[str, Any]:
        """Put the parts on their bench, print, draw."""
        from agents.studies.components.bench import Bench
        from agents.studies.components.run import components, print_numbers

        folder = self.results_folder("components")
        found = components(Bench(), folder)
        print_numbers(found, console)
        if folder is not None:
            console.print(f"wrote {folder}")
        return found
