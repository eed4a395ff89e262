"""MATLAB's MAT-file, version 5: numbers, text and structures; other classes are left out.

`scipy.io.loadmat` ends the interpreter with a bus error on some damaged files, so that it is not used.
Here every size is checked against the bytes that are there. Format: MAT-File Format, The MathWorks.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from shake_env.errors import RecordError

_HEADER = 128  # bytes
_MATRIX, _COMPRESSED = 14, 15
_NUMBERS = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
_ENCODINGS = {2: "latin-1", 1: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16"}
_STRUCTURE, _CHARACTERS, _NUMERIC = 2, 4, range(6, 16)  # classes of arrays
_COMPLEX = 0x800
_DEPTH = 4  # of structures in structures
_FIELD_NAME = 64  # bytes at most


class Mat5:
    """The variables of a file.

    Parameters
    ----------
    name, data
        The file.
    largest
        Numbers that it may hold.

    Raises
    ------
    RecordError
        If the file is damaged, or holds more.
    """

    def __init__(self, name: str, data: bytes, largest: int) -> None:
        self._name, self._left = name, largest
        self._largest = largest
        self._order = {b"IM": "<", b"MI": ">"}.get(data[126:128], "")
        if not self._order:
            raise self._error("the header states no byte order")
        self.variables: dict[str, Any] = {}
        for kind, content in self._elements(data[_HEADER:]):
            if kind == _COMPRESSED:
                parts = list(self._elements(self._unpacked(content)))
            else:
                parts = [(kind, content)]
            for inner, matrix in parts:
                if inner == _MATRIX:
                    key, value = self._matrix(matrix, 0)
                    self.variables[key] = value

    def _error(self, what: str) -> RecordError:
        return RecordError(self._name, what, "the MAT-file is damaged")

    def _unpacked(self, content: bytes) -> bytes:
        packed = zlib.decompressobj()
        limit = 16 * self._largest
        try:
            unpacked = packed.decompress(content, limit)
        except zlib.error as error:
            raise self._error(str(error)) from None
        if packed.unconsumed_tail:
            raise RecordError(self._name, f"above {limit} bytes unpacked", "the file is too large")
        if not packed.eof:
            raise self._error("compressed data that end early")
        return unpacked

    def _elements(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Yield type and content of every element; those of four bytes or fewer lie in their tag."""
        at = 0
        while at + 8 <= len(data):
            kind, size = (int(n) for n in np.frombuffer(data, f"{self._order}u4", 2, at))
            begin = at + 8
            if kind >> 16:
                kind, size, begin = kind & 0xFFFF, kind >> 16, at + 4
                if size > 4:
                    raise self._error(f"{size} bytes in a small element")
            if begin + size > len(data):
                raise self._error(f"an element of {size} bytes where {len(data) - begin} are left")
            yield kind, data[begin : begin + size]
            at = at + 8 if begin == at + 4 else begin + size
            if kind != _COMPRESSED:
                at = -(-at // 8) * 8
        if data[at:].strip(b"\0"):
            raise self._error(f"{len(data) - at} bytes after the last element")

    def _numbers(self, kind: int, content: bytes) -> np.ndarray[Any, Any]:
        if kind not in _NUMBERS:
            raise self._error(f"numbers of type {kind}")
        dtype = np.dtype(self._order + _NUMBERS[kind])
        if len(content) % dtype.itemsize:
            raise self._error(f"{len(content)} bytes of numbers of {dtype.itemsize} bytes")
        return np.frombuffer(content, dtype)

    def _matrix(self, content: bytes, depth: int) -> tuple[str, Any]:
        """Return the name of an array and what it holds: numbers, text, a dictionary, or None."""
        if not content:
            return "", None
        parts = list(self._elements(content))
        if len(parts) < 3:
            raise self._error("an array without a header")
        flags = self._numbers(*parts[0])
        dims = tuple(int(n) for n in self._numbers(*parts[1]))
        name = parts[2][1].decode("latin-1").strip("\0")
        if len(flags) < 1 or len(dims) < 2 or min(dims) < 0:
            raise self._error(f"an array of sizes {dims}")
        elements, kind, rest = math.prod(dims), int(flags[0]) & 0xFF, parts[3:]
        if kind in _NUMERIC:
            if elements > self._left:
                remedy = f"at most {self._largest} numbers are read"
                raise RecordError(self._name, f"{name}, {elements} elements", remedy)
            self._left -= elements
            if int(flags[0]) & _COMPLEX or not rest:
                return name, None
            values = self._numbers(*rest[0])
            if len(values) != elements:
                raise self._error(f"{name}, {len(values)} numbers for sizes {dims}")
            return name, values.reshape(dims, order="F").astype(np.float64)
        if kind == _CHARACTERS and rest:
            return name, self._text(*rest[0])
        if kind == _STRUCTURE and elements == 1 and depth < _DEPTH:
            return name, self._structure(rest, depth)
        return name, None

    def _text(self, kind: int, content: bytes) -> str | None:
        encoding = _ENCODINGS.get(kind)
        if encoding == "utf-16":
            encoding = "utf-16-le" if self._order == "<" else "utf-16-be"
        return content[:400].decode(encoding, "replace").strip("\0") if encoding else None

    def _structure(self, parts: list[tuple[int, bytes]], depth: int) -> dict[str, Any]:
        """Return a structure's fields: the length of a name, all names, then a matrix for each."""
        if len(parts) < 2:
            raise self._error("a structure without fields")
        length = self._numbers(*parts[0])
        size = int(length[0]) if len(length) == 1 else 0
        names = parts[1][1]
        if not 1 <= size <= _FIELD_NAME or len(names) % size or len(names) // size != len(parts) - 2:
            raise self._error(f"a structure of {len(parts) - 2} fields with {len(names)} bytes of names")
        fields = {}
        for index, (kind, content) in enumerate(parts[2:]):
            if kind != _MATRIX:
                raise self._error(f"a field of type {kind}")
            key = names[index * size : (index + 1) * size].split(b"\0")[0].decode("latin-1")
            fields[key] = self._matrix(content, depth + 1)[1]
        return fields
