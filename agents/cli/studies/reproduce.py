"""The command ``shake reproduce``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from agents.cli.command_options import FolderOptions
from agents.cli.output_path import output_folder
from agents.progress import display


@dataclass(frozen=True, kw_only=True)
class Reproduce(FolderOptions):
    """Write the tables and figures of Gavin and Hoagg (2009): published, as printed, corrected.

    Try:
      shake reproduce
      shake reproduce --output out/paper
    """

    def run(self, console: Console) -> dict[str, Any]:
        """Reproduce, and say what is being done."""
        from agents.studies.reproduction.run import reproduce

        folder = output_folder(self.output, Path("out/reproduction"), force=self.force)
        reproduction: dict[str, Any] = reproduce(folder, progress=display.note)
        console.print(f"wrote {folder}")
        return reproduction
