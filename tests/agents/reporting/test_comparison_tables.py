"""What `shake compare` prints on a terminal: no line is wider, no column is explained that is absent."""

import fcntl
import io
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from dataclasses import fields

from agents.evaluation.results import Comparison, GroupSummary
from agents.reporting.comparison_tables import print_tables
from agents.reporting.terminal import OutputConsole, print_table
from baselines.registry import ParameterValues

NAMES = ("lqg", "lqg-accommodating", "inverse-feedback", "preview-lqr", "feedforward-lqr", "pid")
WIDTHS = (60, 70, 80, 100, 120)


def comparison(number, broken=0):
    """A comparison of so many controllers in two groups, with the widest figures there are."""
    numbers = {f.name: 123.4 for f in fields(GroupSummary)}
    summaries = [
        GroupSummary(
            **numbers
            | {"controller": name, "group": group, "earthquakes": 6, "tests": 1}
            | {"broken_limits": broken, "damage": float("nan"), "information": "record known"}
        )
        for group in ("records", "filtered noise")
        for name in NAMES[:number]
    ]
    tuned = ParameterValues(parameters={}, source="tuned", description="tuned on this scenario")
    values = dict.fromkeys(NAMES[:number], tuned)
    skipped, warnings = ["word " * 30], ["word " * 40]
    return Comparison(
        summaries, {}, {}, {}, "lqg", "", skipped, {"pid": 0.01}, [], values, warnings
    )  # fmt: skip


def main():
    """Print every comparison at every width of the terminal that standard output is."""
    for width in WIDTHS:
        fcntl.ioctl(1, termios.TIOCSWINSZ, struct.pack("HHHH", 24, width, 0, 0))
        for number in range(1, len(NAMES) + 1):
            print(f"at {width}", flush=True)
            print_tables(comparison(number), OutputConsole(width=None))


def test_no_line_is_wider_than_the_terminal():
    ours, theirs = pty.openpty()
    environment = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES")}
    environment["TERM"] = "xterm"
    process = subprocess.Popen(
        [sys.executable, __file__], stdout=theirs, stderr=subprocess.STDOUT, env=environment
    )
    os.close(theirs)
    text = b""
    while True:
        try:
            part = os.read(ours, 65_536)
        except OSError:  # the other end is closed
            break
        text += part
    os.close(ours)
    assert process.wait() == 0, text.decode()
    width, longest = 0, dict.fromkeys(WIDTHS, 0)
    for line in re.sub(r"\x1b\[[\d;?]*[a-zA-Z]", "", text.decode()).splitlines():
        if match := re.fullmatch(r"at (\d+)", line):
            width = int(match[1])
        else:
            longest[width] = max(longest[width], len(line))
            assert len(line) <= width, line
    assert all(0.6 * width < longest[width] for width in WIDTHS)


def test_what_the_words_explain_is_there():
    for broken in (0, 3):
        stream = io.StringIO()
        print_tables(comparison(2, broken), OutputConsole(file=stream, force_terminal=True, width=200))
        tables, _, words = stream.getvalue().partition("Cost:")
        assert ("Ended:" in words) == ("ended" in tables) == (broken > 0)


def test_figures_stand_at_the_right_of_their_columns():
    stream = io.StringIO()
    console = OutputConsole(file=stream, force_terminal=True, width=80)
    print_table(console, ("name", "a long\nheading"), [("lqr", "1.5")])
    assert any(line.rstrip() == "lqr      1.5" for line in stream.getvalue().splitlines())


if __name__ == "__main__":
    main()
