"""Options that every command has, and its behaviour on an interruption."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro
from rich.console import Console

from agents.cli.output_path import output_folder

if TYPE_CHECKING:
    from baselines.tuned_values import TunedValues

Flag = tyro.conf.FlagCreatePairsOff[bool]  # an option without a --no-option


@dataclass(frozen=True, kw_only=True)
class CommandOptions(ABC):
    """A command, and the options that every one has."""

    json: Flag = False
    """Print one JSON object on standard output and nothing else there."""
    quiet: Flag = False
    """Print errors only, and the object of --json: no tables, no progress, no remarks."""
    verbose: Flag = False
    """Print on standard error, too, what takes time, and where in the code an error was raised."""

    @abstractmethod
    def run(self, console: Console) -> dict[str, Any]:
        """Do what is asked, print it on a console, and return it as plain JSON values."""

    def check_words(self, words: Sequence[str]) -> None:
        """Raise a ShakeError if the words of the options contradict what the command finds."""
        return

    @property
    def after_interruption(self) -> str | None:
        """How to go on after an interruption; None: by the same command, from the start."""
        return None

    def exit_code(self, result: dict[str, Any]) -> int:
        """Return the exit code of a command that ended with this result."""
        return 0


def tuned_values(file: Path | None) -> TunedValues | None:
    """Return the values of a file that ``--tuned`` names; None where none is named."""
    if file is None:
        return None
    from baselines.tuned_values import read_tuned  # not needed for help

    return read_tuned(file)


@dataclass(frozen=True, kw_only=True)
class FolderOptions(CommandOptions):
    """Options of a command that writes a folder of results."""

    output: Path | None = None
    """Folder for the results (default: the next free one of out/NAME, out/NAME-2, ...; with --json:
    none)."""
    force: Flag = False
    """Write into the folder of --output although there are files in it; those of the same name are
    replaced."""

    def results_folder(self, name: str) -> Path | None:
        """Make the folder for the results, and return it; None where nothing is to be written.

        Raises
        ------
        ParameterError
            If it cannot be written to, or holds files and `force` is not set.
        """
        if self.output is None and self.json:
            return None
        return output_folder(self.output, Path("out") / name, force=self.force)


def print_notes(result: dict[str, Any], console: Console) -> None:
    """Print where the parameter values of a result come from, and its warnings."""
    from agents.evaluation.controller_set import describe_values

    for note in (describe_values(result.get("values", {})), *result.get("warnings", ())):
        if note:
            console.print(note, highlight=False, soft_wrap=True)
