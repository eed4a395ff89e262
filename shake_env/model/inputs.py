"""What a caller hands to an environment: actions, seeds and options, checked."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.errors import ActionError, ParameterError, ScenarioError


def checked_action(action: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return `action` as float64 of `shape`.

    Raises
    ------
    ActionError
        If it has another shape, or is not all finite real numbers.
    """
    array = _real(action)
    if array.shape != shape:
        raise ActionError("action shape", array.shape, f"must be {shape}")
    if not np.isfinite(array).all():
        raise ActionError(
            "action", action, "must be finite: current as a fraction of the limit, -1 to 1"
        )
    return array


def batch_action(action: Any, shape: tuple[int, int]) -> NDArray[np.floating[Any]]:
    """Return actions of shape (N, 1) as (N,), of any floating-point type.

    Raises
    ------
    ActionError
        As `checked_action`.
    """
    if type(action) is np.ndarray and action.shape == shape and action.dtype.kind == "f":
        flat = action[:, 0]
        if math.isfinite(flat.dot(flat)):  # a sum that is not finite may be too large: looked at below
            return flat
    return checked_action(action, shape)[:, 0]


def _real(action: Any) -> NDArray[np.float64]:
    """Return `action` as float64 of any shape."""
    if type(action) is np.ndarray and action.dtype.kind in "fiub" and action.dtype.itemsize <= 8:
        return action.astype(np.float64, copy=False)
    remedy = "must be an array of real numbers"
    entries = action if isinstance(action, list | tuple) else (action,)
    if any(isinstance(entry, np.ma.MaskedArray) for entry in entries):
        raise ActionError("action", action, f"{remedy}: fill the masked entries, action.filled(0.0)")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a number beyond float64 becomes inf, which is refused
            array = np.asarray(action)
            if array.dtype.kind == "O" and not all(isinstance(each, Real) for each in array.flat):
                raise TypeError("an entry is no real number")
            if array.dtype.kind not in "fiubO":
                raise TypeError(f"its numbers are of type {array.dtype}")
            return array.astype(np.float64)
    except Exception as error:  # whatever the __array__ of an object of another library raises
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ActionError("action", action, f"{remedy}: {reason}") from None


def checked_seed(seed: Any, field: str = "seed") -> int | None:
    """Return a seed as a whole number of at least 0, or None.

    Raises
    ------
    ParameterError
        If it is neither.
    """
    if seed is None:
        return None
    whole = isinstance(seed, int | np.integer) and not isinstance(seed, bool)
    if not whole or seed < 0:
        raise ParameterError(field, seed, "must be a whole number of at least 0, or None")
    return int(seed)


def checked_seeds(seed: Any, lanes: int) -> list[int | None]:
    """Return the seed of each of `lanes` tables: s, s + 1, ... of one number s, or one each.

    Raises
    ------
    ParameterError
        If it is neither a whole number, nor one for each table, nor None.
    """
    if seed is None:
        return [None] * lanes
    if not isinstance(seed, list | tuple | np.ndarray) or np.ndim(seed) == 0:
        first = checked_seed(seed)
        return [None if first is None else first + lane for lane in range(lanes)]
    if len(seed) != lanes:
        raise ParameterError("seed", seed, f"give one number, or one for each of {lanes} lanes")
    return [checked_seed(each, f"seed[{lane}]") for lane, each in enumerate(seed)]


def checked_options(options: Any, known: tuple[str, ...]) -> dict[str, Any]:
    """Return reset's options as a new dictionary.

    Raises
    ------
    ScenarioError
        If they are no mapping, or name something that is not `known`.
    """
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise ScenarioError("reset options", options, f"must be a dict with {', '.join(known)}, or None")
    for name in options:
        if name not in known:
            raise ScenarioError("reset option", name, f"known: {', '.join(known)}")
    return dict(options)
