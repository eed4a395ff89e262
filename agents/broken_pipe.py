"""The end of a command whose output nobody reads any more, as in ``shake motion FILE | head``."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

CLOSED = 141  # exit code of a program that SIGPIPE ends: 128 + 13


def end_quietly(command: Callable[[], int]) -> int:
    """Run `command` and return its exit code; 141 without a message if standard output was closed."""
    try:
        code = command()
        sys.stdout.flush()
    except BrokenPipeError:
        # What is left in the buffer goes nowhere, so that the interpreter does not write it at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return CLOSED
    return code
