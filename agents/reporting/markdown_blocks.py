"""Pages of the documentation with places that commands write: what stands between two comments."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path

from shake_env.errors import ParameterError
from shake_env.files import no_file, write_text


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table as Markdown, a line a row, with a line break at its end."""
    lines = ["|" + "".join(f" {c} |" if c else " |" for c in cells) for cells in (head, *rows)]
    lines.insert(1, "|" + "---|" * len(head))
    return "\n".join(lines) + "\n"


def has_place(page: str | PathLike[str], place: str) -> bool:
    """Return whether a page has a beginning ``<!-- PLACE -->``; False where there is no page."""
    page = Path(page)
    return page.is_file() and _begin(place) in page.read_text(encoding="utf-8")


def put_block(page: str | PathLike[str], place: str, text: str, end: str | None = None) -> None:
    """Write a text into a page's place; see `with_block`.

    Raises
    ------
    ParameterError
        If there is no such page, or it lacks one of the comments.
    """
    write_text(Path(page), with_block(page, place, text, end))


def with_block(page: str | PathLike[str], place: str, text: str, end: str | None = None) -> str:
    r"""Return a page with another text between ``<!-- PLACE -->`` and ``<!-- end END -->``.

    Parameters
    ----------
    page, place
        The file, and the name of its place, of which it has one.
    text
        What stands there from now on, whole lines; empty lines are put around it.
    end
        Name in the closing comment; None: as in the first.

    Raises
    ------
    ParameterError
        If there is no such page, or it lacks one of the comments.
    """
    page = Path(page)
    begin, close = _begin(place), f"<!-- end {end or place} -->"
    if not page.is_file():
        raise ParameterError("page", str(page), no_file(page))
    before, marker, rest = page.read_text(encoding="utf-8").partition(begin)
    _, closed, after = rest.partition(close)
    if not (marker and closed):
        raise ParameterError("page", str(page), f"put the lines {begin.strip()} and {close} in it")
    body = f"\n{text.strip()}\n\n" if text.strip() else ""
    return before + begin + body + close + after


def _begin(place: str) -> str:
    return f"<!-- {place} -->\n"
