"""Tables on a terminal and in a pipe: names whole, no figure lost."""

import io
import re

import pytest

from agents.reporting.comparison_tables import COLUMNS
from agents.reporting.terminal import OutputConsole, print_markdown, print_table

HEADINGS = (
    "controller",
    *(heading.format(reference="LQG", drive="current\nmA") for heading, _ in COLUMNS),
)
NAMES = ("lqr", "lqg-dac", "a-run-with-a-long-name-of-its-own")
ROWS = [[name, "1.234 [1.111, 1.333]", *(["12.3"] * (len(HEADINGS) - 2))] for name in NAMES]


def printed(width, terminal=True, **options):
    stream = io.StringIO()
    console = OutputConsole(file=stream, force_terminal=terminal, width=width, color_system=None)
    print_table(console, HEADINGS, ROWS, **options)
    return re.sub(r"\x1b\[[\d;?]*[a-zA-Z]", "", stream.getvalue())


@pytest.mark.parametrize("width", [50, 80, 100, 200])
def test_names_are_whole_at_every_width_and_no_figure_is_lost(width):
    text = printed(width, title="records, 6 earthquakes")
    lines = text.splitlines()
    assert max(len(line.rstrip()) for line in lines) <= max(width, 55)  # of one name and its cost
    blocks = sum(line.startswith(f"{NAMES[0]} ") for line in lines)
    for name in NAMES:
        rows = [line for line in lines if line.split()[:1] == [name]]
        assert len(rows) == blocks
        assert sum(row.count("12.3") for row in rows) == len(HEADINGS) - 2
    assert (blocks == 1) == (width == 200)
    for word in " ".join(HEADINGS).split():
        assert word in text


def test_a_pipe_gets_one_unwrapped_line_a_row():
    lines = printed(80, terminal=False).splitlines()
    assert len(lines) == 1 + len(ROWS)
    assert [line.split()[0] for line in lines] == ["controller", *NAMES]
    assert [re.split(r"  +", line.strip()) for line in lines[1:]] == ROWS
    stream = io.StringIO()
    OutputConsole(file=stream, force_terminal=False, width=80).print("word " * 60)
    assert stream.getvalue().count("\n") == 1


def test_markdown_is_a_table_on_a_terminal_and_itself_in_a_pipe():
    text = "| controller | cost |\n|---|---|\n| lqg-dac | 1.0 |\n\nOne sentence.\n"
    for terminal in (False, True):
        stream = io.StringIO()
        console = OutputConsole(file=stream, force_terminal=terminal, width=40, color_system=None)
        print_markdown(console, text)
        shown = stream.getvalue()
        assert "lqg-dac" in shown and "One sentence." in shown
        assert ("|---|" in shown) != terminal
