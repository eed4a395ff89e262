"""The command ``shake plot-components``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rich.console import Console

from agents.cli.command_options import FolderOptions


@dataclass(frozen=True, kw_only=True)
class PlotComponents(FolderOptions):
    """Draw the yielding storey's loop, the friction loop and the valve's flow-pressure curve.

    Try:
      shake plot-components
      shake plot-components --output out/mine
      shake plot-components --json > components.json
    """

    def run(self, console: Console) -> dict[str, Any]:
        """Simulate the components, print, draw."""
        from agents.studies.components.bench import ComponentSetup
        from agents.studies.components.run import components, print_numbers

        folder = self.results_folder("components")
        numbers = components(ComponentSetup(), folder)
        print_numbers(numbers, console)
        if folder is not None:
            console.print(f"wrote {folder}")
        return numbers
