"""Standard output of the command line: remarks and tables, for a terminal of any width or for a pipe."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from agents.progress import display

GAP = 1  # blanks between the columns of a terminal's table: rich's own divider
PIPE_GAP = "  "  # between those of a pipe's table: cells may hold single blanks


class OutputConsole(Console):
    """Standard output. In a pipe a line is never wrapped; on a terminal words are.

    The spinner on standard error makes way while something is printed.
    """

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as `rich.console.Console.print` does."""
        if not self.is_terminal:
            options.setdefault("soft_wrap", True)
        with display.suspended():
            super().print(*objects, **options)

    def on_broken_pipe(self) -> None:
        """Let the caller end, where rich would end the program with 1, which says that a run failed."""
        raise BrokenPipeError


def print_table(
    console: Console,
    headings: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    title: str = "",
    names: int = 1,
    left: Sequence[int] = (),
    fold: int | None = None,
    bold: Sequence[bool] = (),
) -> None:
    """Print a table in which no name is cut or broken.

    A terminal that is too narrow for all columns gets them in blocks below each other, each with the
    names. A pipe gets one line a row, aligned by blanks, whatever its width.

    Parameters
    ----------
    headings
        A line break in one is kept on a terminal, and is a blank in a pipe.
    rows
        Cells as plain text, no markup.
    title
        Printed above.
    names
        Number of leading columns that name a row; they are left-aligned and stand in every block.
    left
        Further columns that are left-aligned; all others are right-aligned.
    fold
        Column of long text that a terminal may wrap within the width that is left.
    bold
        For each row, whether it is emphasised on a terminal.
    """
    if title:
        console.print(Text(title, style="italic"))
    if not console.is_terminal:
        _print_plain(console, headings, rows, {*range(names), *left})
        return
    widths = [
        max(cell_len(line) for cell in (heading, *(row[i] for row in rows)) for line in cell.split("\n"))
        for i, heading in enumerate(headings)
    ]
    for block in _blocks(widths, names, fold, console.width):
        table = Table(box=SIMPLE_HEAD, padding=0, show_edge=False, pad_edge=False)
        for i in block:
            table.add_column(
                Text(headings[i]),
                justify="left" if i < names or i in left else "right",
                no_wrap=i != fold,
                overflow="fold" if i == fold else "crop",  # "ignore" would leave figures at the left
                min_width=None if i == fold else widths[i],
            )
        for number, row in enumerate(rows):
            style = "bold" if number < len(bold) and bold[number] else ""
            table.add_row(*(Text(row[i]) for i in block), style=style)
        needed = sum(min(20, widths[i]) if i == fold else widths[i] for i in block) + GAP * len(block)
        console.print(table, width=max(console.width, needed), crop=False)
        console.print()


def _blocks(widths: Sequence[int], names: int, fold: int | None, width: int) -> list[list[int]]:
    """Return the columns of each block: names first, then as many others as fit, at least one."""
    least = [min(20, each) if i == fold else each for i, each in enumerate(widths)]
    own = sum(each + GAP for each in least[:names])
    blocks: list[list[int]] = []
    room = -1
    for i in range(names, len(widths)):
        if least[i] + GAP > room:
            blocks.append([*range(names)])
            room = width - own
        blocks[-1].append(i)
        room -= least[i] + GAP
    return blocks or [[*range(names)]]


def _print_plain(
    console: Console, headings: Sequence[str], rows: Sequence[Sequence[str]], left: set[int]
) -> None:
    lines = [[" ".join(cell.split()) for cell in row] for row in (headings, *rows)]
    widths = [max(cell_len(cell) for cell in column) for column in zip(*lines, strict=True)]
    for line in lines:
        padded = [
            cell + (width - cell_len(cell)) * " " if i in left else (width - cell_len(cell)) * " " + cell
            for i, (cell, width) in enumerate(zip(line, widths, strict=True))
        ]
        console.print(Text(PIPE_GAP.join(padded).rstrip()))


def print_markdown(console: Console, text: str) -> None:
    """Print Markdown: as it stands in a pipe, its tables as `print_table` does on a terminal."""
    if not console.is_terminal:
        console.print(Text(text))
        return
    table: list[list[str]] = []
    for line in [*text.splitlines(), ""]:
        if line.startswith("|"):
            table.append([cell.strip() for cell in line.strip().strip("|").split("|")])
            continue
        if table:
            print_table(console, table[0], table[2:])  # a rule stands below the headings
            table = []
        if line:
            console.print(Text(line))
