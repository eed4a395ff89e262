"""Numbers out of text files: parsed in blocks, and explained by line when something does not fit.

Every pattern is linear in the length of its text: a repeated part is possessive or is followed by
something that it cannot hold (`tests/shake_env/records/test_hostile_records.py` checks that).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import replace
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from shake_env.errors import RecordError
from shake_env.model.parameters import FloatArray
from shake_env.records.text.layout import Layout, parse_block

Positions = NDArray[np.int64]
# re.ASCII, for Python's own digits include other alphabets'.
NUMBER = re.compile(r"[+-]?+(?:\d++(?:\.\d*+)?+|\.\d++)(?:[eE][+-]?+\d++)?+", re.ASCII)
WHOLE = re.compile(r"[+-]?+\d++", re.ASCII)
LONGEST_LINE = 65_536  # bytes
_TOKEN = re.compile(r"[^\s,;]++")
_TOKEN_WITH_COMMA = re.compile(r"[^\s;]++")
_BLOCK = 65_536  # bytes parsed at once
_ROWS_AT_ONCE = 256
_INDEXED = 64  # lines: one of so many has its position stored


def parse_number(text: str) -> float | None:
    """Return the finite number that a record's `text` is, or None."""
    plain = text.strip()
    if not NUMBER.fullmatch(plain):
        return None
    value = float(plain)
    return value if math.isfinite(value) else None


class SourceText:
    """A file's bytes with an index of its lines, counted from 0 inside and from 1 in messages.

    The bytes 1A at its end, with which DOS fills a file, are left out. The index is sparse, so that the
    memory that reading takes stays a small multiple of the file.

    Raises
    ------
    RecordError
        If a line is longer than `LONGEST_LINE`.
    """

    def __init__(self, name: str, data: bytes) -> None:
        self.name, self.data = name, data.rstrip(b"\x1a")
        self._codes = np.frombuffer(self.data, dtype=np.uint8)
        self._index = self._indexed()
        self.terminated = self.data.endswith(b"\n")
        filled = len(self.data.rstrip())
        self.filled = self.data.count(b"\n", 0, filled) + 1 if filled else 0

    def _indexed(self) -> Positions:
        """Return where every line whose number is a multiple of `_INDEXED` begins."""
        offsets = [np.zeros(1, dtype=np.int64)]
        lines, last = 1, 0  # lines begun, where the last one begins
        for begin in range(0, len(self._codes), _BLOCK):
            starts = np.flatnonzero(self._codes[begin : begin + _BLOCK] == ord("\n")) + begin + 1
            lengths = np.diff(starts, prepend=last)
            if len(starts) and int(np.max(lengths)) > LONGEST_LINE:
                self._refuse_length(lines + int(np.argmax(lengths)), int(np.max(lengths)))
            offsets.append(starts[(lines + np.arange(len(starts))) % _INDEXED == 0])
            lines, last = lines + len(starts), int(starts[-1]) if len(starts) else last
        if len(self._codes) - last > LONGEST_LINE:
            self._refuse_length(lines, len(self._codes) - last)
        self._lines = lines
        return np.concatenate(offsets)

    def _refuse_length(self, line: int, length: int) -> NoReturn:
        remedy = f"a line may have {LONGEST_LINE} bytes: put the numbers on lines of their own"
        raise RecordError(f"{self.name}, line {line}", f"{length} bytes", remedy)

    def __len__(self) -> int:
        """Return the number of lines up to the last one that is not blank."""
        return self.filled

    def bounds(self, first: int, last: int) -> Positions:
        """Return where lines `first` to `last` - 1 begin, and where the last of them ends."""
        block, after = first // _INDEXED, last // _INDEXED + 1
        begin = int(self._index[block])
        end = int(self._index[after]) if after < len(self._index) else len(self._codes)
        starts = np.flatnonzero(self._codes[begin:end] == ord("\n")) + begin + 1
        starts = np.concatenate([[begin], starts, [len(self._codes)]])
        return starts[first - block * _INDEXED :][: last - first + 1]

    def line(self, index: int) -> str:
        """Return a line without its end; one past the file is empty."""
        if index >= self._lines:
            return ""
        begin, end = self.bounds(index, index + 1)
        line = self.data[begin:end].rstrip(b"\r\n")
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
        return RecordError(
            self.place(index), shown[:200] if isinstance(shown, str) else shown, remedy[:400]
        )

    def numbers(
        self,
        first: int,
        last: int,
        *,
        per_line: int | None = None,
        separator: str = "",
        whole: bool = False,
        touching: bool = False,
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
        touching
            Whether a sign that follows a digit begins the next number, as in columns that touch.

        Raises
        ------
        RecordError
            If something is not a finite number, or a line holds another count of them.
        """
        layout = Layout(per_line, separator, whole=whole, touching=touching)
        if per_line is None:
            count = sum(
                len(layout.token_starts(layout.text(b))) for _, _, b in self._blocks(first, last)
            )
        else:
            count = max(last - first, 0) * per_line
        values, filled = np.empty(count), 0
        for part in self._parsed_blocks(first, last, layout):
            values[filled : filled + len(part)] = part
            filled += len(part)
        self._check_end(first, last, layout)
        return values

    def columns(self, first: int, last: int, layout: Layout) -> list[FloatArray]:
        """Return the columns of lines `first` to `last` - 1, each (lines,) and its own array.

        Raises
        ------
        RecordError
            If something is not a finite number, or a line holds another count of them.
        """
        width = layout.per_line
        assert width is not None
        columns = [np.empty(max(last - first, 0)) for _ in range(width)]
        filled = 0
        for part in self._parsed_blocks(first, last, layout):
            rows = len(part) // width
            for column, values in enumerate(columns):
                values[filled : filled + rows] = part[column::width]
            filled += rows
        self._check_end(first, last, layout)
        return columns

    def series(self, first: int, last: int, layout: Layout) -> FloatArray:
        """Return the numbers of lines `first` to `last` - 1, the last of which may be shorter.

        Raises
        ------
        RecordError
            As :meth:`columns` does.
        """
        final = len(layout.parts(self.line(last - 1)))
        width = layout.per_line or final
        values, filled = np.empty((last - first - 1) * width + final), 0
        for begin, end, ending in (
            (first, last - 1, layout), (last - 1, last, replace(layout, per_line=final)),
        ):  # fmt: skip
            for part in self._parsed_blocks(begin, end, ending):
                values[filled : filled + len(part)] = part
                filled += len(part)
        self._check_end(first, last, layout)
        return values

    def _blocks(self, first: int, last: int) -> Iterator[tuple[int, int, bytes]]:
        """Yield blocks of whole lines: the first line's number, that behind the last, the bytes."""
        if first >= last:
            return
        begin, end = int(self.bounds(first, first + 1)[0]), int(self.bounds(last - 1, last)[-1])
        while begin < end:
            cut = self.data.find(b"\n", begin + _BLOCK, end) + 1 or end
            block = self.data[begin:cut]
            after = first + block.count(b"\n") + (not block.endswith(b"\n"))
            yield first, after, block
            first, begin = after, cut

    def _parsed_blocks(self, first: int, last: int, layout: Layout) -> Iterator[FloatArray]:
        for begin, end, raw in self._blocks(first, last):
            values = layout.parse(raw, end - begin)
            if values is None:
                self._explain(begin, last, layout)
            yield values

    def _explain(self, first: int, last: int, layout: Layout) -> NoReturn:
        """Raise the error of the first line at fault."""
        pattern = WHOLE if layout.whole else NUMBER
        for index in range(first, last):
            line = self.line(index)
            if layout.touching:
                line = layout.text(line.encode()).decode()
            parts = layout.parts(line)
            if layout.per_line is not None and len(parts) != layout.per_line:
                what = "is blank" if not line.strip() else f"holds {len(parts)} columns"
                raise self.error(index, f"{what}; expected {layout.per_line} on every line")
            for part in parts:
                if not pattern.fullmatch(part):
                    kind = "a whole number" if layout.whole else "a number"
                    raise self.error(index, f"is not {kind}", part[:40])
                if not math.isfinite(float(part)):
                    raise self.error(index, "is not a finite number", part[:40])
        raise self.error(first, "the numbers from this line on cannot be read")

    def _check_end(self, first: int, last: int, layout: Layout) -> None:
        """Refuse a last number that may be cut off: no line end, and not as long as the others."""
        if first >= last or self.terminated or last < self.filled or self.data[-1:].isspace():
            return
        one_column = bool(layout.separator) or layout.per_line is not None
        token = _TOKEN_WITH_COMMA if layout.decimal_comma else _TOKEN
        lines = [list(token.finditer(self.line(i))) for i in range(max(first, last - 9), last)]
        final = lines[-1][-1]
        others = [line[-1] for line in lines[:-1]] + ([] if one_column else lines[-1][:-1])
        point = "," if layout.decimal_comma else "."
        if point in final[0]:
            printed = [other[0].replace(point, ".") for other in others]
            whole = bool(others) and _as_long(final[0].replace(point, "."), printed)
        else:  # whole numbers, set flush right
            whole = len(lines) > 1 and final.end() in {other.end() for other in lines[-2]}
        if not whole or not others:
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
            block = self._fields(first + begin, end - begin, wanted, per_line, width, form)
            values[begin * per_line : begin * per_line + wanted] = block
        return values

    def _fields(
        self, first: int, rows: int, count: int, per_line: int, width: int, form: str
    ) -> FloatArray:
        starts, ends = (bounds := self.bounds(first, first + rows))[:-1], bounds[1:]
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
        values = parse_block(table.reshape(-1)[: count * (width + 1)].tobytes())
        if values is None or len(values) != count:
            raise self.error(first, f"cannot be read in columns of {width} characters")
        return values


def _as_long(final: str, others: list[str]) -> bool:
    """Return whether a last number is whole, judged by how the others are printed."""
    mantissa, exponent = _printed(final)
    printed = [_printed(other) for other in others]
    digits = {len(m.partition(".")[2]) for m, _ in printed}
    exponents = {len(e) for _, e in printed}
    if exponent:  # a mantissa that an exponent follows is whole
        return exponents != {0} and len(exponent) >= max(exponents)
    decimals = len(mantissa.partition(".")[2])
    if exponents != {0} or not all("." in m for m, _ in printed):
        return False
    if len(digits) == 1:
        return digits == {decimals}
    # Numbers without their last zeros: one of full length is whole, and beyond 12 digits a cut is small.
    return _significant(mantissa) >= min(max(_significant(m) for m, _ in printed), 12)


def _significant(mantissa: str) -> int:
    return len(mantissa.lstrip("+-").replace(".", "").lstrip("0"))


def _printed(text: str) -> tuple[str, str]:
    """Return mantissa and exponent as printed."""
    mantissa, _, exponent = text.lower().partition("e")
    return mantissa, exponent.lstrip("+-")
