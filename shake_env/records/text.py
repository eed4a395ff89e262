"""Numbers out of text files: parsed all at once, and explained by line when something does not fit."""

from __future__ import annotations

import math
import re
import warnings
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from shake_env.errors import RecordError
from shake_env.parameters import FloatArray

Positions = NDArray[np.int64]
# re.ASCII, for Python's own digits include other alphabets'.
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
WHOLE = re.compile(r"[+-]?\d+", re.ASCII)
_TOKEN = re.compile(r"[^\s,;]+")
_ROWS_AT_ONCE = 32_768


def number(text: str) -> float | None:
    """Return the finite number that `text` is, or None."""
    plain = text.strip()
    if not NUMBER.fullmatch(plain):
        return None
    value = float(plain)
    return value if math.isfinite(value) else None


class SourceText:
    """A file's bytes with an index of its lines, counted from 0 inside and from 1 in messages."""

    def __init__(self, name: str, data: bytes) -> None:
        self.name, self.data = name, data
        self._codes = np.frombuffer(data, dtype=np.uint8)
        breaks = np.flatnonzero(self._codes == ord("\n"))
        self.starts: Positions = np.concatenate([[0], breaks + 1])
        self.ends: Positions = np.concatenate([breaks, [len(data)]])
        self.terminated = data.endswith(b"\n")
        filled = len(data.rstrip())
        self.filled = int(np.searchsorted(self.starts, filled, side="left")) if filled else 0

    def __len__(self) -> int:
        """Return the number of lines up to the last one that is not blank."""
        return self.filled

    def line(self, index: int) -> str:
        """Return a line without its end; one past the file is empty."""
        if index >= len(self.starts):
            return ""
        line = self.data[self.starts[index] : self.ends[index]].rstrip(b"\r")
        try:
            return line.decode("utf-8")
        except UnicodeDecodeError:
            return line.decode("latin-1")

    def place(self, index: int) -> str:
        """Return file and line for a message."""
        return f"{self.name}, line {index + 1}"

    def error(self, index: int, remedy: str, value: object = None) -> RecordError:
        """Return an error at a line, whose text is the value unless another is given."""
        shown = self.line(index).strip()[:80] if value is None else value
        return RecordError(self.place(index), shown, remedy)

    def numbers(
        self,
        first: int,
        last: int,
        *,
        per_line: int | None = None,
        separator: str = "",
        whole: bool = False,
    ) -> FloatArray:
        """Return all numbers of lines `first` to `last` - 1, which blanks or `separator` part.

        Parameters
        ----------
        first, last
            Range of lines.
        per_line
            Numbers that every line must hold; None leaves the lines free.
        separator
            One character that parts the numbers of a line, blanks allowed about it.
        whole
            Whether only whole numbers are allowed.

        Raises
        ------
        RecordError
            If something is not a finite number, or a line holds another count of them.
        """
        if first >= last:
            return np.empty(0)
        begin, end = int(self.starts[first]), int(self.ends[last - 1])
        block = self.data[begin:end]
        allowed = b"0123456789+- \t\r\n" + separator.encode() + (b"" if whole else b".eE")
        if block.translate(None, allowed):
            self._explain(first, last, per_line, separator, whole)
        tokens = self._token_starts(begin, end, separator)
        values = _parsed(block.replace(separator.encode(), b" ") if separator else block)
        sound = values is not None and len(values) == len(tokens) and bool(np.isfinite(values).all())
        if values is None or not sound or not self._laid_out(tokens, first, last, per_line, separator):
            self._explain(first, last, per_line, separator, whole)
        self._check_end(first, last, bool(separator) or per_line is not None)
        return values

    def _token_starts(self, begin: int, end: int, separator: str) -> Positions:
        codes = self._codes[begin:end]
        blank = codes <= ord(" ")
        if separator:
            blank |= codes == ord(separator)
        starts = ~blank
        starts[1:] &= blank[:-1]
        return np.flatnonzero(starts) + begin

    def _laid_out(
        self, tokens: Positions, first: int, last: int, per_line: int | None, separator: str
    ) -> bool:
        if per_line is None:
            return True
        if len(tokens) != (last - first) * per_line:
            return False
        table = tokens.reshape(-1, per_line)
        if not (
            np.all(table[:, 0] >= self.starts[first:last])
            and np.all(table[:, -1] < self.ends[first:last])
        ):
            return False
        if not separator.strip():
            return True
        begin, end = int(self.starts[first]), int(self.ends[last - 1])
        marks = np.flatnonzero(self._codes[begin:end] == ord(separator)) + begin
        if len(marks) != (last - first) * (per_line - 1):
            return False
        if per_line == 1:
            return True
        between = marks.reshape(-1, per_line - 1)
        return bool(np.all(between > table[:, :-1]) and np.all(between < table[:, 1:]))

    def _explain(
        self, first: int, last: int, per_line: int | None, separator: str, whole: bool
    ) -> NoReturn:
        """Raise the error of the first line at fault."""
        pattern = WHOLE if whole else NUMBER
        for index in range(first, last):
            line = self.line(index)
            parts = line.split(separator) if separator.strip() else line.split()
            if per_line is not None and len(parts) != per_line:
                what = "is blank" if not line.strip() else f"holds {len(parts)} columns"
                raise self.error(index, f"{what}; expected {per_line} on every line")
            for part in map(str.strip, parts):
                if not pattern.fullmatch(part):
                    kind = "a whole number" if whole else "a number"
                    raise self.error(index, f"is not {kind}", part[:40])
                if not math.isfinite(float(part)):
                    raise self.error(index, "is not a finite number", part[:40])
        raise self.error(first, "the numbers from this line on cannot be read")

    def _check_end(self, first: int, last: int, one_column: bool) -> None:
        """Refuse a last number that may be cut off: no line end, and not as long as the others."""
        if self.terminated or last < self.filled or self.data[-1:].isspace():
            return
        lines = [list(_TOKEN.finditer(self.line(i))) for i in range(max(first, last - 9), last)]
        final = lines[-1][-1]
        fellows = [line[-1] for line in lines[:-1]] + ([] if one_column else lines[-1][:-1])
        if "." in final[0]:
            tail = len(final[0].partition(".")[2])
            whole = all("." in f[0] and len(f[0].partition(".")[2]) == tail for f in fellows)
        else:  # whole numbers, set flush right
            whole = len(lines) > 1 and final.end() in {token.end() for token in lines[-2]}
        if not (whole and fellows):
            remedy = "the file ends without a line end and may be cut off: add one if it is whole"
            raise self.error(last - 1, remedy, final[0][:40])

    def fields(self, first: int, count: int, per_line: int, width: int, form: str = "F") -> FloatArray:
        """Return `count` numbers from line `first` on, in Fortran's ``(per_line F width.d)``.

        Columns may touch. Every field holds one number, set flush right, and nothing stands beside or
        after the last one. The number has a decimal point (`form` "F"), a decimal point and perhaps an
        exponent ("E"), or is whole ("I").

        Raises
        ------
        RecordError
            If the file ends early, or a field holds anything else.
        """
        rows = -(-count // per_line)
        if first + rows > self.filled:
            held = max(self.filled - first, 0) * per_line
            raise self.error(
                first - 1, f"the file ends after at most {held} of the {count} points", count
            )
        values = np.empty(count)
        for begin in range(0, rows, _ROWS_AT_ONCE):
            end = min(begin + _ROWS_AT_ONCE, rows)
            wanted = min(count, end * per_line) - begin * per_line
            found = self._fields(first + begin, end - begin, wanted, per_line, width, form)
            values[begin * per_line : begin * per_line + wanted] = found
        return values

    def _fields(
        self, first: int, rows: int, count: int, per_line: int, width: int, form: str
    ) -> FloatArray:
        starts, ends = self.starts[first : first + rows], self.ends[first : first + rows]
        longest, used = int(np.max(ends - starts)), per_line * width
        if longest > 2 * used + 80:
            index = first + int(np.argmax(ends - starts))
            raise self.error(index, f"is longer than {per_line} columns of {width} characters")
        at = starts[:, None] + np.arange(max(longest, used))
        inside = at < ends[:, None]
        codes = np.where(inside, self._codes[np.minimum(at, len(self._codes) - 1)], ord(" "))
        codes = codes.astype(np.uint8)
        table = np.full((rows, per_line, width + 1), ord(" "), dtype=np.uint8)
        table[:, :, :width] = codes[:, :used].reshape(rows, per_line, width)
        chars = table.reshape(rows * per_line, width + 1)
        digit = (chars >= ord("0")) & (chars <= ord("9"))
        point = chars == ord(".")
        sign = (chars == ord("-")) | (chars == ord("+"))
        blank = chars <= ord(" ")
        exponent = (chars | 32 == ord("e")) & (form == "E")
        starting = ~blank[:, :-1]
        starting[:, 1:] &= blank[:, :-2]
        sound = np.all(digit | point | sign | blank | exponent, axis=1)
        sound &= point.sum(axis=1) == (form != "I")
        sound &= (starting.sum(axis=1) == 1) & ~blank[:, -2] & digit.any(axis=1)
        sound &= ~np.any(sign[:, 1:] & ~(blank | exponent)[:, :-1], axis=1)
        empty = np.all(blank, axis=1)
        tail = np.all(codes[:, used:] <= ord(" "), axis=1)
        if not (sound[:count].all() and empty[count:].all() and tail.all()):
            spoilt = np.flatnonzero(np.r_[~sound[:count], ~empty[count:]])
            field_row = int(spoilt[0]) // per_line if len(spoilt) else rows
            tail_row = int(np.argmin(tail)) if not tail.all() else rows
            if tail_row < field_row:
                text = codes[tail_row, used:].tobytes().decode("latin-1").strip()
                raise self.error(first + tail_row, f"stands past column {used}", text[:40])
            text = chars[spoilt[0], :-1].tobytes().decode("latin-1")
            at_field = f"in field {int(spoilt[0]) % per_line + 1} of {per_line}"
            what = "is no number" if spoilt[0] < count else f"is more than {count} points"
            raise self.error(first + field_row, f"{what}, {at_field}, {width} columns each", text)
        values = _parsed(table.reshape(-1)[: count * (width + 1)].tobytes())
        if values is None or len(values) != count:
            raise self.error(first, f"cannot be read in columns of {width} characters")
        return values


def _parsed(block: bytes) -> FloatArray | None:
    """Return the numbers in a block of text, or None where something is not a number."""
    if not block.strip():  # which fromstring would read as -1
        return np.empty(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # how numpy before 2.4 refuses
        try:
            values: FloatArray = np.fromstring(block, dtype=np.float64, sep=" ")
        except (ValueError, DeprecationWarning):
            return None
    return values
