"""The command line ``shake``: a typed command each, made by tyro from dataclasses."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import shake_env
from agents.cli.command_options import CommandOptions
from agents.cli.commands import COMPLETION, HELP, command_help, parse, print_completion
from agents.cli.output_path import without_empty_folders
from agents.earlier_names import present_words
from agents.progress import display
from agents.reporting.terminal import OutputConsole
from shake_env.errors import ShakeError, install_hint
from shake_env.renamed import RenamedWarning

MISTAKE, INTERRUPTED, BROKEN_PIPE = 2, 130, 141  # exit codes


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return 0, 1 if runs failed, 2 for a mistake in what was asked, 130 interrupted."""
    words = [*(sys.argv[1:] if arguments is None else arguments)]
    try:
        if (text := own_text(words)) is not None:
            print(text, flush=True)
            return 0 if words else MISTAKE
        if words[0] in COMPLETION:
            print_completion(words)
        with renamings_as_lines():
            return run_words(words)
    except BrokenPipeError:  # whoever reads has enough, such as head
        _drop_output()
        return BROKEN_PIPE
    except OSError as error:  # a command's own are reported below
        report(f"standard output: {error.strerror or error}", None)
        _drop_output()
        return MISTAKE


def _drop_output() -> None:
    """Let what is still to be printed go nowhere, so that the interpreter's end does not fail on it."""
    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextlib.contextmanager
def renamings_as_lines() -> Iterator[None]:
    """Print the warning about each old name as one line on standard error, once."""
    printed: set[str] = set()
    with warnings.catch_warnings():
        warnings.simplefilter("always", RenamedWarning)
        usual = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *place: Any, **where: Any) -> None:
            if not issubclass(category, RenamedWarning):
                usual(message, category, *place, **where)
            elif str(message) not in printed:
                printed.add(str(message))
                print(f"shake: {message}", file=sys.stderr)

        warnings.showwarning = show
        yield


def own_text(words: Sequence[str]) -> str | None:
    """Return what ``shake`` prints without a command (help, version); None: a command follows."""
    if not words or words[0] in HELP:
        return command_help()
    return f"shake-env {shake_env.__version__}" if words[0] == "--version" else None


def run_words(words: Sequence[str]) -> int:
    """Run the command of a line, and return the exit code; errors become one line each."""
    command: CommandOptions | None = None
    try:
        words = present_words(words)
        command = parse(words)
        return run(command, f"shake {next(word for word in words if not word.startswith('-'))}")
    except ShakeError as error:
        report(str(error), command)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] in ("shake_env", "baselines", "agents"):
            raise
        report(f"{error.name} is not installed: {install_hint('agents')}", command)
    except BrokenPipeError:
        raise
    except OSError as error:
        # What this program writes to a file is named where it is written (`shake_env.files`).
        place = error.filename or "standard output, or a file of a library"
        report(f"{place}: {error.strerror or error}", command)
        _drop_output()
    except KeyboardInterrupt:
        print("shake: interrupted", file=sys.stderr)
        if command is not None and command.after_interruption is not None:
            print(command.after_interruption, file=sys.stderr)
        return INTERRUPTED
    return MISTAKE


def run(command: CommandOptions, title: str) -> int:
    """Run a command with progress on the terminal, and print its result."""
    silent = command.json or command.quiet
    # A pipe has no width: the columns of a table, which rich would shrink, are as wide as they are.
    console = OutputConsole(quiet=silent, width=None if sys.stdout.isatty() else 10_000)
    display.begin(title, quiet=command.quiet, verbose=command.verbose)
    try:
        with without_empty_folders():
            result = command.run(console)
    finally:
        display.end()
    if command.json:
        print(json.dumps(result))
    sys.stdout.flush()
    return command.exit_code(result)


def report(text: str, command: CommandOptions | None) -> None:
    """Print an error of a command as one line, and where it was raised if that was asked for."""
    if command is not None and command.verbose:
        traceback.print_exc()
    print(f"shake: {text}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
