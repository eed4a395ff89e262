"""The `info` of a batch: a dictionary whose arrays are made when they are asked for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from shake_env.kernels.layout import INFO
from shake_env.model.parameters import FloatArray

_ROWS = {name: row for row, name in enumerate(INFO)}
_MASKS = frozenset(f"_{name}" for name in INFO)


class BatchInfo(dict[str, Any]):
    """Rows of a report under their names, each with the mask of those tables that have it: all.

    It is a dictionary in every respect. A single key that is read makes its own array; whatever asks for
    more makes all of them.

    Parameters
    ----------
    report
        (15, N) rows of `layout.REPORT`.
    """

    __slots__ = ("_report",)

    def __init__(self, report: FloatArray) -> None:
        super().__init__()
        self._report: FloatArray | None = report

    def __missing__(self, key: str) -> Any:
        report = self._report
        if report is not None:
            if key in _ROWS:
                value: Any = report[_ROWS[key]]
                dict.__setitem__(self, key, value)
                return value
            if key in _MASKS:
                value = np.ones(report.shape[1], dtype=bool)
                dict.__setitem__(self, key, value)
                return value
        raise KeyError(key)

    def complete(self) -> None:
        """Make all entries, in order; entries that were set stay."""
        report, self._report = self._report, None
        if report is None:
            return
        given = dict(dict.items(self))
        dict.clear(self)
        masks = np.ones((len(INFO), report.shape[1]), dtype=bool)
        for name, row, mask in zip(INFO, report, masks, strict=False):
            dict.__setitem__(self, name, row)
            dict.__setitem__(self, f"_{name}", mask)
        dict.update(self, given)

    def __reduce__(self) -> tuple[Any, ...]:
        self.complete()
        return dict, (dict(dict.items(self)),)

    def __ror__(self, other: dict[str, Any]) -> dict[str, Any]:  # type: ignore[override]
        self.complete()
        return {**other, **self}


def _completed(name: str) -> Callable[..., Any]:
    """Return dict's method of this name, behind `complete`."""
    method = getattr(dict, name)

    def call(self: BatchInfo, *given: Any, **named: Any) -> Any:
        self.complete()
        return method(self, *given, **named)

    call.__name__, call.__doc__ = name, method.__doc__
    return call


for _name in (
    "__contains__", "__delitem__", "__eq__", "__ne__", "__iter__", "__len__", "__repr__", "__reversed__",
    "__or__", "__ior__", "clear", "copy", "get", "items", "keys", "pop", "popitem", "setdefault",
    "values",
):  # fmt: skip
    setattr(BatchInfo, _name, _completed(_name))
