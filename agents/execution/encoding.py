"""Plain values with arrays as bytes and back, exactly; reading them runs no code."""

from __future__ import annotations

import io
import json
import zipfile
from typing import Any

import numpy as np

from shake_env.errors import FileError

VALUE = "value"  # member that holds the JSON text
_ARRAY = "array:"  # key of what stands in an array's place


def encoded(value: Any) -> bytes:
    """Return plain values (as JSON has them, keys of words) and arrays as the bytes of an npz file.

    Equal values are equal bytes.
    """
    arrays: dict[str, Any] = {}

    def plain(part: Any) -> Any:
        if isinstance(part, np.ndarray):
            if part.dtype.hasobject:
                raise TypeError("an array of objects is no array of numbers")
            arrays[f"a{len(arrays)}"] = part
            return {_ARRAY: f"a{len(arrays) - 1}"}
        if isinstance(part, dict):
            return {key: plain(each) for key, each in part.items()}
        if isinstance(part, list | tuple):
            return [plain(each) for each in part]
        return part.item() if isinstance(part, np.generic) else part

    text = json.dumps(plain(value))
    held = io.BytesIO()
    content = {VALUE: np.frombuffer(text.encode(), dtype=np.uint8), **arrays}
    np.savez(held, **content)  # noise does not compress
    return held.getvalue()


def decoded(content: bytes) -> Any:
    """Return the values that :func:`encoded` made the bytes of.

    Raises
    ------
    FileError
        If they are none.
    """
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        value = json.loads(arrays.pop(VALUE).tobytes().decode())
    except (ValueError, KeyError, EOFError, OSError, zipfile.BadZipFile) as error:
        raise FileError(
            "result of a unit", f"{len(content)} byte", f"is not complete ({error})"
        ) from error

    def whole(part: Any) -> Any:
        if isinstance(part, dict):
            if part.keys() == {_ARRAY}:
                return arrays[part[_ARRAY]]
            return {key: whole(each) for key, each in part.items()}
        return [whole(each) for each in part] if isinstance(part, list) else part

    return whole(value)
