"""The encoding of a text file: UTF-8 from here on, with line feeds at the ends of lines."""

from __future__ import annotations

from shake_env.errors import RecordError

_UTF_8_MARK = b"\xef\xbb\xbf"
_UTF_16_MARKS = {b"\xff\xfe": "utf-16-le", b"\xfe\xff": "utf-16-be"}
_BEGINNING = 1024  # bytes by which UTF-16 without a mark is known


def plain_text(name: str, data: bytes) -> bytes:
    """Return a text file in UTF-8 without a byte order mark; a binary one as it is.

    Raises
    ------
    RecordError
        If a file that is marked as UTF-16 is none.
    """
    if data.startswith(_UTF_8_MARK):
        data = data[len(_UTF_8_MARK) :]
    encoding = _UTF_16_MARKS.get(data[:2]) or _unmarked(data[:_BEGINNING])
    if encoding is not None:
        try:
            data = data.decode(encoding).removeprefix("\ufeff").encode()
        except UnicodeError as error:
            raise RecordError(name, str(error)[:80], f"is not {encoding}: the file is damaged") from None
    if b"\r" in data[:65_536] and b"\n" not in data and b"\0" not in data[:65_536]:
        data = data.replace(b"\r", b"\n")  # as old Macintosh programs end lines
    return data


def _unmarked(beginning: bytes) -> str | None:
    """Return the UTF-16 in which a text of Latin letters is written without a mark, or None."""
    whole = beginning[: len(beginning) // 2 * 2]
    first, second = whole[::2], whole[1::2]
    for letters, zeros, encoding in ((first, second, "utf-16-le"), (second, first, "utf-16-be")):
        if (
            len(letters) >= 8
            and not zeros.strip(b"\0")
            and all(9 <= code < 127 or code >= 160 for code in letters)
        ):
            return encoding
    return None
