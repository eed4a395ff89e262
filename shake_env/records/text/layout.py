"""How numbers stand in lines of text, and the parsing of a block of such lines."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shake_env.model.parameters import FloatArray

_TOUCHING = re.compile(rb"(?<=[0-9.])(?=[+-])")


@dataclass(frozen=True)
class Layout:
    """How numbers stand in lines."""

    per_line: int | None = None  # numbers that every line must hold; None leaves the lines free
    separator: str = ""  # one character that parts the numbers, blanks allowed about it; "": blanks
    whole: bool = False  # only whole numbers are allowed
    touching: bool = False  # a sign that follows a digit begins the next number
    decimal_comma: bool = False  # a comma stands for the decimal point
    trailing: bool = False  # a separator ends every line

    def text(self, block: bytes) -> bytes:
        """Return a block with decimal points, and with blanks between numbers that touch."""
        if self.decimal_comma:
            block = block.replace(b",", b".")
        return _TOUCHING.sub(b" ", block) if self.touching else block

    def parts(self, line: str) -> list[str]:
        """Return the texts between the separators of a line, blanks taken off."""
        if self.decimal_comma:
            line = line.replace(",", ".")
        if not self.separator:
            return line.split()
        parts = [part.strip() for part in line.split(self.separator)]
        return parts[:-1] if self.trailing and not parts[-1] else parts

    def token_starts(self, block: bytes) -> NDArray[np.int64]:
        """Return where numbers begin in a block."""
        codes = np.frombuffer(block, dtype=np.uint8)
        blank = codes <= ord(" ")
        if self.separator:
            blank |= codes == ord(self.separator)
        starts = ~blank
        starts[1:] &= blank[:-1]
        return np.flatnonzero(starts)

    def parse(self, block: bytes, lines: int) -> FloatArray | None:
        """Return the numbers of a block of whole lines, or None where one does not fit."""
        block = self.text(block)
        allowed = b"0123456789+- \t\r\n" + self.separator.encode() + (b"" if self.whole else b".eE")
        if block.translate(None, allowed):
            return None
        tokens = self.token_starts(block)
        values = parse_block(block.replace(self.separator.encode(), b" ") if self.separator else block)
        if values is None or len(values) != len(tokens) or not np.isfinite(values).all():
            return None
        return values if self._laid_out(block, tokens, lines) else None

    def _laid_out(self, block: bytes, tokens: NDArray[np.int64], lines: int) -> bool:
        if self.per_line is None:
            return True
        if len(tokens) != lines * self.per_line:
            return False
        codes = np.frombuffer(block, dtype=np.uint8)
        starts = np.concatenate([[0], np.flatnonzero(codes == ord("\n")) + 1])[:lines]
        ends = np.concatenate([starts[1:], [len(codes)]])
        table = tokens.reshape(-1, self.per_line)
        if not (np.all(table[:, 0] >= starts) and np.all(table[:, -1] < ends)):
            return False
        if not self.separator:
            return True
        marks = np.flatnonzero(codes == ord(self.separator))
        per_line = self.per_line - 1 + self.trailing
        if len(marks) != lines * per_line:
            return False
        if per_line == 0:
            return True
        between = marks.reshape(-1, per_line)
        limits = np.column_stack([table[:, 1:], ends])[:, :per_line]
        return bool(np.all(between > table[:, :per_line]) and np.all(between < limits))


def parse_block(block: bytes) -> FloatArray | None:
    """Return the numbers in a block of a record's text, or None where something is not a number."""
    if not block.strip():  # which fromstring would read as -1
        return np.empty(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # how numpy before 2.4 refuses
        try:
            values: FloatArray = np.fromstring(block, dtype=np.float64, sep=" ")
        except (ValueError, DeprecationWarning):
            return None
    return values
